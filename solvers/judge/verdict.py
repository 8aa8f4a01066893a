"""The independent judge: float64 verdicts on any answer to a problem, whoever gave it."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from solvers.duality import FORCE_HORIZON
from solvers.problem import OBJECTIVES, GraspForceProblem, Multipliers

EQUILIBRIUM_TOLERANCE = 1e-12
"""Largest equilibrium residual, relative to the size of the forces, in a feasible answer."""

LOAD_SHARE = 1e-6
"""And the largest relative to the force scale, what the data asks for: forces that squeeze without
carrying must not buy tolerance by their size."""

NEGLIGIBLE = 1e-8
"""Share of the forces' size below which an objective counts as zero."""

GAP_TOLERANCE = 1e-6
"""Largest relative gap between objective and dual bound in an optimal answer."""

FARKAS_TOLERANCE = 1e-9
"""Least relative Farkas value that counts as a proof: far above float64 rounding."""

LARGEST_NUMBER = 1e100
"""N and so on: nothing physical is larger, and its square must not overflow."""


class Status(StrEnum):
    """What is known about an answer."""

    OPTIMAL = "optimal"
    """All constraints hold and the dual bound proves the objective best, within tolerances."""
    FEASIBLE = "feasible"
    """All constraints hold; the gap says how far from the best the objective can be."""
    INFEASIBLE = "infeasible"
    """No forces satisfy the constraints; the multipliers are a Farkas certificate of that. Where a
    contact has no cap: none below `solvers.duality.FORCE_HORIZON` times the problem's scale."""
    FAILED = "failed"
    """Neither feasible forces nor a proof that there are none; the message says why."""


@dataclass(frozen=True, eq=False)
class Verdict:
    """The judge's measurements of one answer or of a batch of them, float64; all arrays are (...,).

    Args:
        status: strings, the values of `Status`.
        equilibrium_residual: N, see `solvers.problem.residuals`.
        friction_violation: N.
        normal_violation: N.
        torque_violation: N·m.
        objective: objective at the forces; NaN unless they are feasible.
        dual_bound: lower bound on the optimum from the multipliers.
        gap: (objective - dual_bound) / |objective|; NaN unless the forces are feasible. Negative by
            rounding; far below zero is not optimal.
        farkas_value: > `FARKAS_TOLERANCE` proves infeasibility.
        size: N, of the forces or of what the data asks for, whichever is larger: what tolerances
            are relative to.
        quality_lower, quality_upper: N, the interval that q_lrw of the forces lies in; None for the
            convex objectives, NaN unless the forces are feasible.
    """

    status: np.ndarray
    equilibrium_residual: np.ndarray
    friction_violation: np.ndarray
    normal_violation: np.ndarray
    torque_violation: np.ndarray
    objective: np.ndarray
    dual_bound: np.ndarray
    gap: np.ndarray
    farkas_value: np.ndarray
    size: np.ndarray
    quality_lower: np.ndarray | None = None
    quality_upper: np.ndarray | None = None

    def reshaped(self, shape: tuple[int, ...]) -> "Verdict":
        """The same measurements in other batch dimensions."""
        if self.status.shape == shape:
            return self
        arrays = {name: array for name, array in vars(self).items() if array is not None}
        return Verdict(**{name: array.reshape(shape) for name, array in arrays.items()})


_STATUSES = np.array([status.value for status in Status])


def judge(problem: GraspForceProblem, forces: np.ndarray, multipliers: Multipliers) -> Verdict:
    """Measure forces and multipliers against the problem, trusting nothing that a solver said.

    Inequalities must hold with no tolerance but the rounding of their own evaluation, a few units
    in the last place of their terms, and equilibrium to `EQUILIBRIUM_TOLERANCE`. Torque limits that
    coincide are an equation, judged like equilibrium relative to the largest torque that a force of
    the problem's size causes through its Jacobian. Forces or multipliers that are NaN or beyond
    `LARGEST_NUMBER` are no answer and prove nothing; forces at padding contacts count as zero.

    Args:
        problem: numpy float64 problem(s).
        forces: (..., 3n) N.
        multipliers: nu and lambda, as in `solvers.duality.bounds`.
    """
    verdict = judge_flat(problem.flat(), forces, multipliers)
    return verdict.reshaped(problem.batch_shape)


def judge_flat(problem: GraspForceProblem, forces: np.ndarray, multipliers: Multipliers) -> Verdict:
    """The same for a problem that is flat already, see `GraspForceProblem.flat`."""
    # compiled at the first call, once a machine
    from solvers.compiled.judge.measure import COLUMNS, Tolerances, measure

    count = len(problem)
    table = np.empty((count, len(COLUMNS)))
    code = np.empty(count, dtype=np.int64)
    measure(
        problem.arrays(),
        OBJECTIVES.index(problem.objective),
        tuple(
            np.array(answer, dtype=np.float64, order="C").reshape(count, answer.shape[-1])
            for answer in (forces, multipliers.equilibrium, multipliers.torque)
        ),
        Tolerances(
            EQUILIBRIUM_TOLERANCE,
            GAP_TOLERANCE,
            FARKAS_TOLERANCE,
            NEGLIGIBLE,
            LARGEST_NUMBER,
            FORCE_HORIZON,
        ),
        (table, code),
    )
    balance, friction, normal, torque, value, bound, farkas, size, _, _, gap = table.T
    return Verdict(
        _STATUSES[code], balance, friction, normal, torque, value, bound, gap, farkas, size
    )
