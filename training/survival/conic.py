"""Small programs over friction cones, solved by Clarabel."""

from dataclasses import dataclass

import clarabel
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from .exceptions import SurvivalError

_TOLERANCE = 1e-9
_FOUND = (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved)
_NONE = (
    clarabel.SolverStatus.PrimalInfeasible,
    clarabel.SolverStatus.AlmostPrimalInfeasible,
)

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Rows:
    """Affine functions matrix @ x + constant of m unknowns x.

    Args:
        matrix: (k, m).
        constant: (k,).
    """

    matrix: Array
    constant: Array


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
        SurvivalError: Clarabel ended without either.
    """
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = _TOLERANCE
    matrix = sparse.csc_matrix(-np.vstack([zero.matrix, positive.matrix, cones.matrix]))
    kinds = [clarabel.ZeroConeT(len(zero.constant))] if len(zero.constant) else []
    kinds += [clarabel.NonnegativeConeT(len(positive.constant))]
    kinds += [clarabel.SecondOrderConeT(3)] * (len(cones.constant) // 3)
    solution = clarabel.DefaultSolver(
        sparse.csc_matrix(np.triu(np.zeros(2 * gain.shape) if curvature is None else curvature)),
        -gain,
        matrix,
        np.concatenate([zero.constant, positive.constant, cones.constant]),
        kinds,
        settings,
    ).solve()
    if solution.status in _FOUND:
        return np.array(solution.x)
    if solution.status in _NONE:
        return None
    raise SurvivalError(f"Clarabel ended with {solution.status}")
