"""What grasps must carry when solvers are judged: one seeded task for each grasp."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gfo_env.acquisition import Grasp
from gfo_env.chunks import grasp_of
from gfo_env.conditions import FRICTION_FACTOR, FRICTION_RANGE, MASS_RANGE
from gfo_env.grasp_problem import problem_fields
from gfo_env.grasps import GraspTable
from gfo_env.hand import BARRETT_BH8_280
from gfo_env.holding import ShakeProtocol, random_gravity
from solvers import GraspForceProblem

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


def pose_problem(
    grasp: Grasp, task: Task, protocol: ShakeProtocol, preload: float
) -> GraspForceProblem:
    """(phases,) problems: every load of the protocol, for one grasp."""
    return GraspForceProblem(
        **problem_fields(
            grasp,
            BARRETT_BH8_280,
            protocol.loads(task.mass, task.gravity),
            task.gravity,
            friction=FRICTION_FACTOR * task.friction,
            preload=preload,
        )
    )


def make_problems(
    table: GraspTable, tasks: list[Task], protocol: ShakeProtocol, preload: float
) -> GraspForceProblem:
    """(grasps, phases) problems: every load of the protocol, for every grasp."""
    return GraspForceProblem.stack(
        [
            pose_problem(grasp_of(table, index), task, protocol, preload)
            for index, task in enumerate(tasks)
        ]
    ).pad(table.contact_mask.shape[1])
