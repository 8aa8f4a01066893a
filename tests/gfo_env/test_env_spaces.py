"""Observations lie in a space that depends on shapes alone, whatever the loads."""

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv

from gfo_env.env import GraspForceEnv
from gfo_env.policy import SolverPolicy
from tests.support.episodes import play, random_actions
from tests.support.seeds import reseeded
from training.rl.actions import ConeActions

LOADS: list[dict[str, Any]] = [
    {"twist": 0.2},
    {"push": 3.0},
    {"turn": 0.1},
    {"mass_range": (0.1, 0.6)},
    {"friction_range": (0.3, 1.1)},
    {"mass_change": (0.5, 2.5)},
    {"friction_change": (0.5, 1.5)},
    {"torque_scale_range": (0.5, 1.5)},
    {"max_force": 25.0},
    {"preload": 1.0},
]
"""Settings that change what an agent sees, and not how it sees it."""


def static(**arguments: Any) -> GraspForceEnv:
    return GraspForceEnv(split="test", mode="static", **arguments)


@pytest.mark.parametrize("announced", [True, False])
def test_no_load_changes_the_spaces(announced: bool) -> None:
    plain = static(announced=announced)
    for load in LOADS:
        other = static(announced=announced, **load)
        assert other.observation_space == plain.observation_space
        assert other.action_space == plain.action_space
    assert static(max_contacts=5).observation_space != plain.observation_space
    assert static(announced=not announced).observation_space != plain.observation_space


def test_an_agent_goes_on_under_other_loads(tmp_path: Path) -> None:
    def vector(**load: Any) -> DummyVecEnv:
        return DummyVecEnv([lambda: ConeActions(static(**load))])

    agent = PPO("MultiInputPolicy", vector(), n_steps=8, batch_size=8, n_epochs=1, seed=0)
    agent.save(tmp_path / "agent.zip")
    for load in LOADS:
        loaded = PPO.load(tmp_path / "agent.zip", env=vector(**load))
    loaded.learn(8)
    seen = vector(**LOADS[-1]).reset()
    assert loaded.predict(seen)[0].shape == (1, 24)


EXTREMES = st.sampled_from([1e-6, 1e-3, 1.0, 1e3, 1e6])
RANGES = st.tuples(EXTREMES, EXTREMES).map(sorted)
SIZES = st.one_of(st.just(0.0), EXTREMES)


@given(
    load=st.fixed_dictionaries(
        {
            "mode": st.sampled_from(["dynamic", "static"]),
            "mass_range": RANGES,
            "friction_range": RANGES,
            "push": SIZES,
            "twist": SIZES,
            "turn": SIZES,
            "mass_change": RANGES,
            "friction_change": RANGES,
            "torque_scale_range": RANGES,
            "max_force": EXTREMES,
            "max_contacts": st.integers(3, 9),
        }
    ),
    seed=st.integers(0, 3),
    options=st.fixed_dictionaries(
        {}, optional={"mass": EXTREMES, "friction": EXTREMES, "gravity": st.just([0, 1e6, -1e6])}
    ),
)
@settings(max_examples=60)
def test_no_setting_leads_out_of_the_space(
    load: dict[str, Any], seed: int, options: dict[str, Any]
) -> None:
    horizon = 1 if load["mode"] == "static" else 12
    env = GraspForceEnv(split="test", announced=False, preload=0.0, horizon=horizon, **load)
    shakes = random_actions(seed)
    policy = SolverPolicy("dual_newton")
    for act in (shakes, lambda observation: policy.predict(observation)[0]):
        observation, info = env.reset(seed=reseeded(seed), options=options)
        over = False
        while not over:
            assert observation in env.observation_space
            assert all(np.isfinite(array).all() for array in observation.values())
            observation, reward, terminated, truncated, info = env.step(act(observation))
            assert np.isfinite([reward, *(v for v in info.values() if isinstance(v, float))]).all()
            over = terminated or truncated
        assert observation in env.observation_space
    env.close()


def test_bounds_are_those_of_the_table() -> None:
    """The spec sheet has a row for each key; its empty cells are no bounds."""
    assert GraspForceEnv.__doc__ is not None
    rows = [
        [cell.strip() for cell in line.split("|")[1:-1]]
        for line in GraspForceEnv.__doc__.splitlines()
        if line.strip().startswith("|")
    ]
    space = GraspForceEnv(split="test", announced=False).observation_space
    assert isinstance(space, gym.spaces.Dict)
    stated = {row[0]: row[2:4] for row in rows if row[0] in space.spaces}
    assert stated.keys() == space.spaces.keys()
    for name, (low, high) in stated.items():
        box = space[name]
        assert isinstance(box, gym.spaces.Box)
        assert set(box.low) == {float(low or -np.inf)}
        assert set(box.high) == {float(high or np.inf)}


def test_play_is_still_in_the_space_without_padding() -> None:
    env = GraspForceEnv(split="test", max_contacts=3, horizon=6)
    for seed in range(3):
        for observation, *_ in play(env, seed, random_actions(seed)):
            assert observation in env.observation_space
    env.close()
