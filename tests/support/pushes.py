"""Grasp force problems without preload and cap, and the disturbances to resist, for tests."""

from typing import Any

import numpy as np

from solvers import GraspForceProblem, solve
from tests.support.problems import random_problem
from tests.support.seeds import seeded

LENGTH = 0.04
"""m, that torques are scaled with."""

UNLOADED = {"normal_min": 0.0, "normal_max": np.inf}


def posed(seed: int, contacts: int = 5, **fields: Any) -> tuple[GraspForceProblem, np.ndarray]:
    """A random problem without preload and cap, and its least-norm forces for half the friction."""
    rng = seeded(seed)
    while True:
        problem = random_problem(rng, contacts, **(UNLOADED | fields))
        solution = solve(problem.replace(friction=0.5 * problem.friction))
        if solution.status == "optimal":
            return problem, np.asarray(solution.forces)


def sides(force: float = 1.0, torque: float = 0.02) -> np.ndarray:
    """(12, 6) forces and torques from all sides."""
    ways = np.vstack([np.eye(6), -np.eye(6)])
    return ways * np.repeat([force, torque], 3)


def palm_only(load: list[float]) -> GraspForceProblem:
    """Three contacts under an object that no joint moves, normals along z."""
    grasp_map = np.zeros((6, 9))
    for k, arm in enumerate([(0.03, 0, 0), (-0.015, 0.026, 0), (-0.015, -0.026, 0)]):
        grasp_map[:3, 3 * k : 3 * k + 3] = np.eye(3)
        grasp_map[3:, 3 * k : 3 * k + 3] = np.cross(arm, np.eye(3)).T
    return GraspForceProblem(
        grasp_map=grasp_map,
        hand_jacobian=np.zeros((9, 2)),
        friction=[0.5] * 3,
        torque_min=[-1.0] * 2,
        torque_max=[1.0] * 2,
        external_wrench=load,
    )
