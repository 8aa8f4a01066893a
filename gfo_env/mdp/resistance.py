"""Passive resistance of commanded forces, as the reward counts it."""

import numpy as np

from gfo_env.conditions import JOINT_FRICTION
from solvers import GraspForceProblem, SolverError
from solvers.arrays import Array
from solvers.passive_resistance import passive_resistance


def disturbances_of(push: float, twist: float) -> Array:
    """(12, 6) N, N·m: forces along ± each axis, then torques about it; those of size 0 left out."""
    sizes = np.repeat([push, twist], 3)
    wrenches = np.diag(sizes)[sizes > 0.0]
    return np.stack([wrenches, -wrenches], axis=1).reshape(-1, 6)


def least_resistance(
    problem: GraspForceProblem | None, forces: Array, disturbances: Array, length: float
) -> float:
    """The least passive resistance of forces over disturbances, in multiples of their size.

    0 where the contacts cannot balance every load, where no joint torques carry the load, and where
    the cone programs end without an answer.

    Args:
        problem: of the step, with the true friction, its load beside the disturbances; None if the
            contacts cannot balance every load.
        forces: (3n,) N, as commanded.
        disturbances: (k, 6) N and N·m, object frame.
        length: m, that torques are scaled with.
    """
    if problem is None:
        return 0.0
    try:
        found = passive_resistance(
            problem, forces, disturbances, length, joint_friction=JOINT_FRICTION
        )
    except SolverError:
        return 0.0
    return float(found.multiples.min())
