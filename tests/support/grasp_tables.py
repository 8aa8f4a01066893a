"""Tables of made-up grasps, for tests that need the format and not the simulator."""

import numpy as np

from gfo_env.grasps import GraspTable
from tests.support.problems import N_JOINTS, random_problem, random_rotation

WIDTH = 8


def random_table(rng: np.random.Generator, count: int, objects: int = 20) -> GraspTable:
    """A table of `count` random grasps with 3 to 8 contacts of `objects` objects."""
    problems = [random_problem(rng, int(n)) for n in rng.integers(3, 9, count)]
    padded = [problem.pad(WIDTH) for problem in problems]
    return GraspTable(
        object_set="made up",
        split="train",
        seed=0,
        max_torque=np.full(N_JOINTS, 2.0),
        object_id=np.array([f"{index % objects:03d}" for index in range(count)]),
        attempt=np.arange(count),
        object_radius=rng.uniform(0.03, 0.06, count),
        object_mass=rng.uniform(0.1, 0.5, count),
        object_position=rng.normal(0.0, 0.1, (count, 3)),
        object_rotation=np.stack([random_rotation(rng) for _ in range(count)]),
        joint_angles=rng.uniform(0.0, 1.0, (count, N_JOINTS)),
        positions=rng.normal(0.0, 0.03, (count, WIDTH, 3)),
        frames=np.broadcast_to(np.eye(3), (count, WIDTH, 3, 3)).copy(),
        links=np.zeros((count, WIDTH), dtype=np.int64),
        normal_forces=rng.uniform(0.1, 5.0, (count, WIDTH)),
        contact_mask=np.stack([problem.contact_mask for problem in padded]),
        grasp_map=np.stack([problem.grasp_map for problem in padded]),
        hand_jacobian=np.stack([problem.hand_jacobian for problem in padded]),
        gravity_map=rng.normal(0.0, 0.005, (count, N_JOINTS, 3)),
    )
