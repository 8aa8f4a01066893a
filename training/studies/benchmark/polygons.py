"""What linear friction cones cost: inner and outer polygons in the place of circles.

With K sides the polygon inside the circle gives forces that are always allowed, for more effort and
for fewer loads; the polygon around it gives forces that slip, and loads that no force carries. One
side is perpendicular to the first tangent.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solvers import GraspForceProblem
from solvers.arrays import Array
from solvers.conic import POSITIVE, ZERO, solve
from solvers.problem import residuals

from .conic import EQUALITIES, ConicBatch, conic_batches
from .problem_sets import ProblemSet

SIDES = (4, 8, 16)
INNER, OUTER = "inner", "outer"

_TOLERANCE = 1e-10


@dataclass(frozen=True, eq=False)
class PolygonSolutions:
    """Linearised problems, solved.

    Args:
        forces: (B, 3n) N; NaN unless solved.
        objective: (B,) N^2; NaN unless solved.
        infeasible: (B,) whether Clarabel found a proof that the linear constraints have no
            solution.
    """

    forces: Array
    objective: Array
    infeasible: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class PolygonErrors:
    """One polygon on the problems of a set.

    Args:
        kind: `inner` or `outer`.
        sides: of the polygon.
        extra_effort: (S,) objective over the true optimum, less one, where both are known.
        slip: (S,) largest excess of a tangential force over the true friction limit, relative to
            that limit, of its answers.
        falsely_infeasible: of the problems known to be feasible, the share that it calls
            infeasible.
        falsely_feasible: of the problems known to be infeasible, the share that it solves.
        undecided: share of all problems on which Clarabel ended neither way.
    """

    kind: str
    sides: int
    extra_effort: Array
    slip: Array
    falsely_infeasible: float
    falsely_feasible: float
    undecided: float


def audit(problem_set: ProblemSet, sides: Sequence[int] = SIDES) -> list[PolygonErrors]:
    """Solve a set with each polygon and compare with what is known."""
    return [
        _figures(problem_set, kind, count, solve_linear(problem_set.problems, kind, count))
        for kind in (INNER, OUTER)
        for count in sides
    ]


def solve_linear(problem: GraspForceProblem, kind: str, sides: int) -> PolygonSolutions:
    """The problems of a batch with polygons for cones, as quadratic programs for Clarabel."""
    forces = np.full((len(problem), problem.n_contacts, 3), np.nan)
    infeasible = np.zeros(len(problem), dtype=np.bool_)
    for part in conic_batches(problem):
        for row, places, (data, scale) in zip(
            part.index, part.contacts, _programs(part, kind, sides), strict=True
        ):
            outcome = solve(*data, tolerance=_TOLERANCE)
            if outcome.solved:
                forces[row] = 0.0
                forces[row, places] = scale * outcome.x.reshape(-1, 3)
            infeasible[row] = outcome.infeasible
    flat = forces.reshape(len(problem), -1)
    return PolygonSolutions(flat, residuals.objective_value(problem, flat), infeasible)


def apothem(kind: str, sides: int) -> float:
    """Distance of the sides from the centre, for a circle of radius one."""
    return float(np.cos(np.pi / sides)) if kind == INNER else 1.0


def _programs(part: ConicBatch, kind: str, sides: int) -> list[tuple[tuple[Any, ...], float]]:
    size = part.n_variables
    angles = 2.0 * np.pi * np.arange(sides) / sides
    directions = np.column_stack([np.cos(angles), np.sin(angles)])  # (K, 2)
    contact = np.arange(part.n_contacts)
    friction = -part.matrix[:, -size::3, 2::3][:, contact, contact]  # (B, k)
    programs = []
    for problem in range(len(part)):
        sides_rows = np.zeros((part.n_contacts, sides, part.n_contacts, 3))
        sides_rows[contact, :, contact, :2] = directions
        sides_rows[contact, :, contact, 2] = -apothem(kind, sides) * friction[problem, :, None]
        rows = part.rows_of(problem).copy()
        rows[-size:] = False
        matrix = np.vstack([part.matrix[problem, rows], sides_rows.reshape(-1, size)])
        bound = np.append(part.bound[problem, rows], np.zeros(sides * part.n_contacts))
        cones = [ZERO(EQUALITIES), POSITIVE(len(matrix) - EQUALITIES)]
        data = (np.eye(size), np.zeros(size), matrix, bound, cones)
        programs.append((data, float(part.scale[problem])))
    return programs


def _figures(
    problem_set: ProblemSet, kind: str, sides: int, answers: PolygonSolutions
) -> PolygonErrors:
    feasible = problem_set.known & problem_set.feasible
    infeasible = problem_set.known & ~problem_set.feasible
    solved = np.isfinite(answers.objective)
    both = solved & np.isfinite(problem_set.optimum)
    return PolygonErrors(
        kind=kind,
        sides=sides,
        extra_effort=answers.objective[both] / problem_set.optimum[both] - 1.0,
        slip=_slip(problem_set.problems[solved], answers.forces[solved]),
        falsely_infeasible=_share(answers.infeasible, feasible),
        falsely_feasible=_share(solved, infeasible),
        undecided=float(np.mean(~solved & ~answers.infeasible)),
    )


def _slip(problem: GraspForceProblem, forces: Array) -> Array:
    """(S,) the largest (|f_t| - mu f_n) / (mu f_n) of contacts that carry something."""
    force = residuals.per_contact(forces)
    limit = problem.friction * force[..., 2]
    size = np.linalg.norm(force[..., :2], axis=-1)
    least = 1e-6 * np.linalg.norm(forces, axis=-1, keepdims=True)
    carries = problem.contact_mask & (limit > least)
    excess = np.where(carries, size / np.where(carries, limit, 1.0) - 1.0, 0.0)
    return np.maximum(excess.max(axis=-1, initial=0.0), 0.0)


def _share(what: NDArray[np.bool_], among: NDArray[np.bool_]) -> float:
    """Share of `among` that is `what`; NaN if there are none."""
    return float(np.mean(what[among])) if among.any() else float("nan")
