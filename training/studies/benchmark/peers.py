"""Other people's solvers behind one interface: convert, solve, read the answer.

A peer is timed in three parts: `prepare` builds what the solver takes, `run` is the construction of
its object and its solve call, `answer` reads forces and multipliers. Each runs with its own default
tolerances unless its class says otherwise; that is the fastest that its authors recommend.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from importlib.metadata import version
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from solvers import GraspForceProblem
from solvers.arrays import Array
from solvers.solution import Candidate

from .conic import ConicBatch, conic_batches, csc, scatter

RawAnswer = tuple[Array, Array]


@dataclass(frozen=True, eq=False)
class Prepared:
    """Converted problems, in parts with as many contacts each, and what a peer made of each part.

    Args:
        parts: the problems as dense conic programs.
        programs: what the peer takes, one entry a part.
    """

    parts: list[ConicBatch]
    programs: list[Any]


class Peer(ABC):
    """Base of the adapters; see the module."""

    title: str
    package: str
    settings: str
    batched = False
    """Whether one call takes many problems."""
    feasible_only = False
    """Whether an infeasible problem makes it raise."""

    @classmethod
    def installed(cls) -> bool:
        """Whether its package is."""
        return find_spec(cls.package) is not None

    @classmethod
    def version(cls) -> str:
        """Version of its package."""
        return version(cls.package)

    def prepare(self, problem: GraspForceProblem) -> Prepared:
        """What the solver takes, from a batch of numpy problems."""
        parts = conic_batches(problem)
        return Prepared(parts, [self.convert(part) for part in parts])

    def run(self, prepared: Prepared) -> list[Any]:
        """Construct and solve; one entry a part."""
        return [self.solve_part(program) for program in prepared.programs]

    def answer(self, problem: GraspForceProblem, prepared: Prepared, raw: list[Any]) -> Candidate:
        """Forces and multipliers of the whole batch; NaN forces where it found none."""
        read = [self.read(part, each) for part, each in zip(prepared.parts, raw, strict=True)]
        forces, multipliers = scatter(problem, prepared.parts, read)
        message = np.full(len(problem), "", dtype=np.str_)
        return Candidate(forces=forces, multipliers=multipliers, message=message)

    @abstractmethod
    def convert(self, part: ConicBatch) -> Any:
        """What the solver takes of one part."""

    @abstractmethod
    def solve_part(self, program: Any) -> Any:
        """The solver's own answers to one part."""

    @abstractmethod
    def read(self, part: ConicBatch, raw: Any) -> RawAnswer:
        """(B, 3k) variables, NaN if infeasible, and (B, m) dual variables of the part's rows."""


def quadratic(part: ConicBatch) -> tuple[Any, Array]:
    """P and q of 1/2 x'x."""
    size = part.n_variables
    return sparse.identity(size, format="csc"), np.zeros(size)


def needed(part: ConicBatch, problem: int) -> tuple[Any, Array, NDArray[np.bool_]]:
    """A, b without the rows of absent limits and without zeros, and the (m,) rows that are left."""
    rows = part.rows_of(problem)
    matrix = part.matrix[problem, rows]
    return csc(matrix, matrix != 0.0), part.bound[problem, rows], rows


def without_answers(x: Array, none: list[bool]) -> Array:
    """The variables (B, 3k), NaN where the solver says that there are none."""
    return np.where(np.array(none)[:, None], np.nan, x)


def spread_duals(rows: list[NDArray[np.bool_]], duals: list[Any]) -> Array:
    """(B, m) dual variables, zero in the rows that the solver was not told."""
    spread = np.zeros((len(rows), len(rows[0])))
    for line, mask, dual in zip(spread, rows, duals, strict=True):
        line[mask] = np.asarray(dual)
    return spread
