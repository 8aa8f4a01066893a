"""Cone programs for Clarabel: the one place that calls it, and rows that small programs share."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import clarabel
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from solvers.exceptions import SolverError
from solvers.problem import GraspForceProblem

ZERO = clarabel.ZeroConeT
POSITIVE = clarabel.NonnegativeConeT
SECOND_ORDER = clarabel.SecondOrderConeT
SEMIDEFINITE = clarabel.PSDTriangleConeT
"""Kinds of cones, each called with its size."""

_TOLERANCE = 1e-9

JOINT_SCALE = 0.05
"""N·m; programs work in multiples of it."""

Array = NDArray[np.float64]


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
    """
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    if tolerance is not None:
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    if infeasible is not None:
        settings.tol_infeas_abs = settings.tol_infeas_rel = infeasible
    size = len(cost)
    curvature = sparse.csc_matrix((size, size) if quadratic is None else quadratic)
    answer = clarabel.DefaultSolver(
        sparse.triu(curvature, format="csc"),
        cost,
        sparse.csc_matrix(matrix),
        ends,
        list(cones),
        settings,
    ).solve()
    return ConicOutcome(str(answer.status), np.array(answer.x), np.array(answer.z))


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
    cone = [ZERO(len(zero.constant))] if len(zero.constant) else []
    outcome = solve(
        curvature,
        -gain,
        -np.vstack([zero.matrix, positive.matrix, cones.matrix]),
        np.concatenate([zero.constant, positive.constant, cones.constant]),
        [*cone, POSITIVE(len(positive.constant))] + [SECOND_ORDER(3)] * (len(cones.constant) // 3),
        tolerance=_TOLERANCE,
    )
    if outcome.solved:
        return outcome.x
    if outcome.infeasible:
        return None
    raise SolverError(f"Clarabel ended with {outcome.status}")


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
