"""How accurate forces are as a numerical solver gave them, before anybody finishes them.

The judge's statuses are stricter: they allow no violation of an inequality at all.
"""

import numpy as np
from numpy.typing import NDArray

from solvers import GraspForceProblem
from solvers.arrays import Array
from solvers.problem import force_scale, residuals

ACCURACY = 1e-6
"""Relative violation, imbalance and gap of an answer that counts as accurate."""

_ABSURD = 1e50
"""N: a force beyond it is none."""


def is_accurate(problem: GraspForceProblem, forces: Array, bound: Array) -> NDArray[np.bool_]:
    """(B,) whether forces (B, 3n) meet `ACCURACY`, the gap measured to a dual bound (B,)."""
    balance, violation = relative_residuals(problem, forces)
    usable = np.where(np.isfinite(balance)[:, None], forces, np.nan)
    value = residuals.objective_value(problem, usable)
    close: NDArray[np.bool_] = np.abs(value - bound) <= ACCURACY * value
    return close & (balance <= ACCURACY) & (violation <= ACCURACY)


def relative_residuals(problem: GraspForceProblem, forces: Array) -> tuple[Array, Array]:
    """(B,) twice: equilibrium residual and largest violation, relative; NaN without forces."""
    usable = np.all(np.abs(forces) < _ABSURD, axis=-1, keepdims=True)
    forces = np.where(usable, forces, np.nan)
    scale = force_scale(problem)
    lever = np.max(np.linalg.norm(problem.hand_jacobian, axis=-2), axis=-1, initial=1e-12)
    balance = residuals.equilibrium_residual(problem, forces) / scale
    violation = np.maximum.reduce(
        [
            residuals.friction_violation(problem, forces) / scale,
            residuals.normal_violation(problem, forces) / scale,
            residuals.torque_violation(problem, forces) / (scale * lever),
        ]
    )
    return balance, np.where(np.isfinite(balance), violation, np.nan)
