"""What grasps must carry when solvers are judged: one seeded task for each grasp."""

from dataclasses import dataclass

import numpy as np

from gfo_env.conditions import FRICTION_FACTOR, FRICTION_RANGE, MASS_RANGE
from gfo_env.grasps import GraspTable
from gfo_env.grasps.acquisition import Grasp
from gfo_env.grasps.attempts import grasp_of
from gfo_env.grasps.problem import problem_fields
from gfo_env.hand import BARRETT_BH8_280, HandDescription
from gfo_env.holding import ShakeProtocol, random_gravity
from solvers import GraspForceProblem
from solvers.arrays import Array


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
    grasp: Grasp,
    task: Task,
    protocol: ShakeProtocol,
    preload: float,
    *,
    radius: float = 0.0,
    friction_factor: float = FRICTION_FACTOR,
    hand: HandDescription = BARRETT_BH8_280,
) -> GraspForceProblem:
    """(phases,) problems: every load of the protocol, for one grasp.

    Args:
        grasp: to hold with.
        task: what to carry.
        protocol: of the shake.
        preload: N, least normal force of every contact.
        radius: m, of the object; what protocols with torques need to know.
        friction_factor: share of the true friction that forces are planned with.
        hand: that holds.
    """
    return GraspForceProblem(
        **problem_fields(
            grasp,
            hand,
            protocol.loads(task.mass, task.gravity, radius),
            task.gravity,
            friction=friction_factor * task.friction,
            preload=preload,
        )
    )


def make_problems(
    table: GraspTable,
    tasks: list[Task],
    protocol: ShakeProtocol,
    preload: float,
    *,
    friction_factor: float = FRICTION_FACTOR,
    hand: HandDescription = BARRETT_BH8_280,
) -> GraspForceProblem:
    """(grasps, phases) problems: `pose_problem` for every grasp of a table."""
    return GraspForceProblem.stack(
        [
            pose_problem(
                grasp_of(table, index),
                task,
                protocol,
                preload,
                radius=float(table.object_radius[index]),
                friction_factor=friction_factor,
                hand=hand,
            )
            for index, task in enumerate(tasks)
        ]
    ).pad(table.contact_mask.shape[1])
