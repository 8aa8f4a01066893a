"""Cone programs for Clarabel: the one place that calls it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import clarabel
import numpy as np
from scipy import sparse

from solvers.arrays import Array
from solvers.exceptions import ProblemError, SolverError

ZERO = clarabel.ZeroConeT
POSITIVE = clarabel.NonnegativeConeT
SECOND_ORDER = clarabel.SecondOrderConeT
SEMIDEFINITE = clarabel.PSDTriangleConeT
"""Kinds of cones, each called with its size."""

_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class ConicOutcome:
    """How Clarabel ended.

    Args:
        status: its word.
        x: (m,) variables.
        dual: (k,) one a row.
    """

    status: str
    x: Array
    dual: Array

    @property
    def solved(self) -> bool:
        """Whether x is a solution, perhaps one of less accuracy."""
        return self.status in ("Solved", "AlmostSolved")

    @property
    def infeasible(self) -> bool:
        """Whether there is none, perhaps proven with less accuracy."""
        return self.status in ("PrimalInfeasible", "AlmostPrimalInfeasible")


def solve(
    quadratic: Any,
    cost: Array,
    matrix: Any,
    ends: Array,
    cones: Sequence[Any],
    *,
    tolerance: float | None = None,
    infeasible: float | None = None,
) -> ConicOutcome:
    """Minimise x'Px / 2 + cost'x subject to ends - matrix x in the cones, on one thread.

    Args:
        quadratic: (m, m) P, its upper triangle counts; None for none.
        cost: (m,).
        matrix: (k, m), dense or sparse.
        ends: (k,).
        cones: in the order of the rows.
        tolerance: of gap and feasibility, relative and absolute; Clarabel's own by default.
        infeasible: likewise of proofs that there is no solution.

    Raises:
        ProblemError: for arrays whose shapes do not agree.
    """
    size, rows = len(cost), len(ends)
    shapes = {
        "cost": (np.shape(cost), (size,)),
        "ends": (np.shape(ends), (rows,)),
        "matrix": (matrix.shape, (rows, size)),
        "quadratic": ((size, size) if quadratic is None else quadratic.shape, (size, size)),
    }
    for name, (shape, wanted) in shapes.items():
        if shape != wanted:
            raise ProblemError(f"{name} has shape {shape} but must have {wanted}")
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    if tolerance is not None:
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    if infeasible is not None:
        settings.tol_infeas_abs = settings.tol_infeas_rel = infeasible
    answer = clarabel.DefaultSolver(
        _upper(quadratic, len(cost)),
        cost,
        sparse.csc_matrix(matrix),
        ends,
        list(cones),
        settings,
    ).solve()
    return ConicOutcome(str(answer.status), np.array(answer.x), np.array(answer.z))


def _upper(quadratic: Any, size: int) -> Any:
    """The upper triangle, sparse; conversions take a good part of the time of small programs."""
    if quadratic is None:
        return sparse.csc_matrix((size, size))
    if sparse.issparse(quadratic):
        return sparse.triu(quadratic, format="csc")
    return sparse.csc_matrix(np.triu(quadratic))


@dataclass(frozen=True, eq=False)
class Rows:
    """Affine functions bound - matrix @ x of m unknowns x, which a cone holds.

    Args:
        matrix: (k, m).
        bound: (k,).
    """

    matrix: Array
    bound: Array

    @classmethod
    def of(cls, *blocks: "Rows") -> "Rows":
        """Blocks of rows, one below the other."""
        return cls(
            np.vstack([block.matrix for block in blocks]),
            np.concatenate([block.bound for block in blocks]),
        )

    def __len__(self) -> int:
        return len(self.bound)


def maximise(
    gain: Array, zero: Rows, positive: Rows, cones: Rows, curvature: Array | None = None
) -> Array | None:
    """The unknowns x with the largest gain'x - x'Cx / 2; None where there are none.

    Args:
        gain: (m,).
        zero: rows that are zero.
        positive: rows that are not negative.
        cones: rows in threes, the first of which is at least the norm of the other two.
        curvature: (m, m) C, positive semidefinite; None for none.

    Raises:
        SolverError: Clarabel ended without either.
    """
    rows = Rows.of(zero, positive, cones)
    outcome = solve(
        curvature,
        -gain,
        rows.matrix,
        rows.bound,
        [
            *([ZERO(len(zero))] if len(zero) else []),
            POSITIVE(len(positive)),
            *[SECOND_ORDER(3)] * (len(cones) // 3),
        ],
        tolerance=_TOLERANCE,
    )
    if outcome.solved:
        return outcome.x
    if outcome.infeasible:
        return None
    raise SolverError(f"Clarabel ended with {outcome.status}")
