"""Episodes for the tests of the environment: actions, playing to the end, comparing to the bit."""

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np

from gfo_env.env import GraspForceEnv
from gfo_env.mdp.episode import Episode
from gfo_env.mdp.reward import TERMS
from gfo_env.policy import SolverPolicy
from tests.support.seeds import reseeded, seeded

Act = Callable[[dict[str, Any]], np.ndarray]
Step = tuple[dict[str, Any], float, bool, bool, dict[str, Any]]

IDS = (
    "GraspForce-v0",
    "GraspForceUnannounced-v0",
    "GraspForceStatic-v0",
    "GraspForceFingertips-v0",
    "GraspForceFixedObject-v0",
)
FIELDS = (
    "grasp_map",
    "hand_jacobian",
    "friction",
    "torque_min",
    "torque_max",
    "external_torque",
    "external_wrench",
    "normal_min",
    "normal_max",
    "contact_mask",
)
INFO = {
    "is_success",
    "force_closure",
    "q_lrw",
    "wrench_residual",
    "friction_violation",
    "torque_violation",
    "object_id",
    "effort",
    "resistance",
    "grasp",
} | {f"reward_{name}" for name in TERMS}

ORACLE = SolverPolicy("dual_newton")


def zeros(observation: dict[str, Any]) -> np.ndarray:
    return np.zeros(3 * len(observation["friction"]), np.float32)


def random_actions(seed: int) -> Act:
    rng = seeded(seed)
    return lambda observation: rng.uniform(-1, 1, 3 * len(observation["friction"]))


def oracle(observation: dict[str, Any]) -> np.ndarray:
    return ORACLE.predict(observation)[0]


def episode_of(env: GraspForceEnv) -> Episode:
    """The episode that is being played."""
    assert env._episode is not None
    return env._episode


def play(env: gym.Env[Any, Any], seed: int, act: Act) -> list[Step]:
    """An episode from reset, in the form of a step without a reward, to its end."""
    observation, info = env.reset(seed=reseeded(seed))
    steps: list[Step] = [(observation, 0.0, False, False, info)]
    while not (steps[-1][2] or steps[-1][3]):
        steps.append(env.step(act(steps[-1][0])))
    return steps


def assert_same(one: list[Step], other: list[Step]) -> None:
    assert len(one) == len(other)
    for a, b in zip(one, other, strict=True):
        assert a[1:] == b[1:]
        assert a[0].keys() == b[0].keys()
        for name in a[0]:
            np.testing.assert_array_equal(a[0][name], b[0][name])
