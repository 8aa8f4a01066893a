"""What grasps must carry when solvers are judged: one seeded task for each grasp."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gfo_env.grasp_problem import grasp_force_problem
from gfo_env.hand import BARRETT_BH8_280
from gfo_env.holding import ShakeProtocol, random_gravity
from solvers import GraspForceProblem

from .collection import grasp_of
from .grasps import GraspTable

MASS_RANGE = (0.1, 0.5)
"""kg; objects are given a mass from it, because a mesh says nothing of density."""

FRICTION_RANGE = (0.4, 1.0)

FRICTION_FACTOR = 0.8
"""Forces are planned with this share of the true friction."""

PRELOAD = 2.0
"""N, least normal force of every contact."""

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Task:
    """What a grasp must carry.

    Args:
        mass: kg.
        friction: the true coefficient.
        gravity: (3,) m/s2, hand frame.
    """

    mass: float
    friction: float
    gravity: Array


def make_task(seed: int, number: int) -> Task:
    """The task of the grasp that attempt `number` acquired."""
    rng = np.random.default_rng([seed, number, 2])
    return Task(rng.uniform(*MASS_RANGE), rng.uniform(*FRICTION_RANGE), random_gravity(rng))


def make_problems(
    table: GraspTable, tasks: list[Task], protocol: ShakeProtocol, preload: float
) -> GraspForceProblem:
    """(grasps, phases) problems: every load of the protocol, for every grasp."""
    return GraspForceProblem.stack(
        [
            grasp_force_problem(
                grasp_of(table, index),
                BARRETT_BH8_280,
                protocol.loads(task.mass, task.gravity),
                task.gravity,
                friction=FRICTION_FACTOR * task.friction,
                preload=preload,
            )
            for index, task in enumerate(tasks)
        ]
    ).pad(table.contact_mask.shape[1])
