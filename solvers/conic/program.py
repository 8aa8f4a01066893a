"""Small programs over friction cones, solved by Clarabel, and the rows that they share."""

from dataclasses import dataclass

import clarabel
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from solvers.exceptions import SolverError
from solvers.problem import GraspForceProblem

_TOLERANCE = 1e-9
_FOUND = (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved)
_NONE = (
    clarabel.SolverStatus.PrimalInfeasible,
    clarabel.SolverStatus.AlmostPrimalInfeasible,
)

JOINT_SCALE = 0.05
"""N·m; programs work in multiples of it."""

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
        SolverError: Clarabel ended without either.
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
    raise SolverError(f"Clarabel ended with {solution.status}")


def friction_cones(problem: GraspForceProblem, spare: Array) -> Rows:
    """Rows (3n, 3n + 1) of the friction cones; the last unknown shrinks each by `spare` (n,)."""
    size = 3 * problem.n_contacts
    matrix = np.zeros((size, size + 1))
    first = np.arange(0, size, 3)
    matrix[first, first + 2] = problem.friction
    matrix[first, -1] = -spare
    matrix[first + 1, first] = 1.0
    matrix[first + 2, first + 1] = 1.0
    return Rows(matrix, np.zeros(size))


def force_limits(problem: GraspForceProblem, budget: float, size: int) -> Rows:
    """Torque limits, effort within `budget` (N), and preloads and caps where there are any.

    The forces are the first 3n of `size` unknowns.
    """
    count = 3 * problem.n_contacts
    torque = np.zeros((problem.n_joints, size))
    torque[:, :count] = problem.hand_jacobian.T
    effort = np.zeros((1, size))
    effort[0, 2:count:3] = -1.0
    normal = np.eye(count, size)[2::3]
    loaded, capped = problem.normal_min > 0.0, np.isfinite(problem.normal_max)
    return Rows(
        np.vstack(
            [
                -torque / JOINT_SCALE,
                torque / JOINT_SCALE,
                effort,
                normal[loaded],
                -normal[capped],
            ]
        ),
        np.concatenate(
            [
                (problem.torque_max - problem.external_torque) / JOINT_SCALE,
                (problem.external_torque - problem.torque_min) / JOINT_SCALE,
                [budget],
                -problem.normal_min[loaded],
                problem.normal_max[capped],
            ]
        ),
    )
