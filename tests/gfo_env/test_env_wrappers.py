"""The environment under what others put around it: vectors, wrappers, Stable-Baselines3."""

import importlib.util
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import DependencyNotInstalled
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import (
    FlattenObservation,
    RecordEpisodeStatistics,
    RecordVideo,
    RenderCollection,
    TimeLimit,
)
from stable_baselines3 import PPO
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from gfo_env.env import GraspForceEnv
from tests.support.episodes import FIELDS, ORACLE, oracle
from tests.support.seeds import reseeded


def static(**arguments: Any) -> gym.Env[Any, Any]:
    return gym.make("GraspForce-v0", split="test", mode="static", **arguments)


# -- vectors ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", ["sync", "async"])
def test_vectors_reproduce_single_environments(shared: GraspForceEnv, mode: str) -> None:
    envs = gym.make_vec("GraspForce-v0", num_envs=2, vectorization_mode=mode, split="test")
    try:
        observations, infos = envs.reset(seed=reseeded(31))
        actions, _ = ORACLE.predict(observations)
        after, rewards, _, _, _ = envs.step(actions)
        for index in range(2):
            observation, info = shared.reset(seed=reseeded(31 + index))
            assert infos["object_id"][index] == info["object_id"]
            alone = shared.step(oracle(observation))
            assert rewards[index] == pytest.approx(alone[1], abs=1e-6)
            for name in FIELDS:
                np.testing.assert_array_equal(observations[name][index], observation[name])
                np.testing.assert_allclose(after[name][index], alone[0][name], atol=1e-5)
    finally:
        envs.close()


@pytest.mark.slow
def test_spawned_workers_reproduce_forked_ones() -> None:
    starts = []
    for context in ("fork", "spawn"):
        envs = gym.make_vec(
            "gfo_env:GraspForce-v0",
            num_envs=2,
            vectorization_mode="async",
            vector_kwargs={"context": context},
            split="test",
        )
        starts.append(envs.reset(seed=reseeded(7))[0])
        envs.close()
    for name in FIELDS:
        np.testing.assert_array_equal(starts[0][name], starts[1][name])


@pytest.mark.parametrize("mode", ["sync", "async"])
@pytest.mark.parametrize("name", ["GraspForceStatic-v0", "GraspForceUnannounced-v0"])
def test_vectors_that_reset_in_the_same_step(name: str, mode: str) -> None:
    envs = gym.make_vec(
        name,
        num_envs=3,
        vectorization_mode=mode,
        vector_kwargs={"autoreset_mode": AutoresetMode.SAME_STEP},
        split="test",
        horizon=1,
    )
    try:
        observations, infos = envs.reset(seed=[1, 2, 3])
        for _ in range(3):
            actions, _ = ORACLE.predict(observations)
            before = observations
            observations, rewards, terminated, truncated, infos = envs.step(actions)
            assert (terminated | truncated).all()
            assert np.isfinite(rewards).all()
            assert set(infos["final_info"]) >= {"is_success", "grasp", "object_id"}
            for last, first in zip(infos["final_obs"], before["grasp_map"], strict=True):
                # the last observation of a static episode is still of its grasp
                if name == "GraspForceStatic-v0":
                    np.testing.assert_array_equal(last["grasp_map"], first)
            # and what is seen is already of the next one
            assert not np.array_equal(observations["external_wrench"], before["external_wrench"])
    finally:
        envs.close()


# -- wrappers of gymnasium -------------------------------------------------------------------------


def test_flattened_limited_and_counted() -> None:
    env = RecordEpisodeStatistics(
        TimeLimit(FlattenObservation(gym.make("GraspForce-v0", split="test")), max_episode_steps=2)
    )
    observation, _ = env.reset(seed=reseeded(6))
    assert observation in env.observation_space
    assert observation.shape == (6 * 24 + 24 * 8 + 3 * 8 + 6 + 4 * 8,)
    _, first, *_ = env.step(np.zeros(24, np.float32))
    _, second, _, truncated, info = env.step(np.zeros(24, np.float32))
    assert truncated
    assert info["episode"]["l"] == 2
    assert info["episode"]["r"] == pytest.approx(float(first) + float(second), abs=1e-6)
    # a limit from outside is no success: the episode had not come to its end
    assert info["is_success"] is False
    env.close()


@pytest.mark.parametrize("mode", ["dynamic", "static"])
def test_pictures_of_an_episode(mode: str) -> None:
    env = RenderCollection(
        gym.make(
            "GraspForce-v0",
            split="test",
            mode=mode,
            horizon=2 if mode == "dynamic" else None,
            render_mode="rgb_array",
        )
    )
    observation, _ = env.reset(seed=reseeded(0))
    over = False
    while not over:
        observation, _, terminated, truncated, _ = env.step(oracle(observation))
        over = terminated or truncated
    pictures = env.render()
    assert len(pictures) == (3 if mode == "dynamic" else 2)
    for picture in pictures:
        assert picture.shape == (240, 320, 3)
        assert picture.dtype == np.uint8
        assert picture.std() > 10.0
    # forces are drawn once they are commanded
    assert not np.array_equal(pictures[0], pictures[1])
    env.close()


def test_videos_are_recorded_or_the_missing_dependency_is_named(tmp_path: Path) -> None:
    env = static(render_mode="rgb_array")
    if importlib.util.find_spec("moviepy") is None:
        with pytest.raises(DependencyNotInstalled, match="moviepy"):
            RecordVideo(env, str(tmp_path))
        env.close()
        return
    recorded = RecordVideo(env, str(tmp_path))
    observation, _ = recorded.reset(seed=reseeded(0))
    recorded.step(oracle(observation))
    recorded.close()
    assert list(tmp_path.glob("*.mp4"))


# -- Stable-Baselines3 -----------------------------------------------------------------------------


def test_normalised_and_monitored(tmp_path: Path) -> None:
    monitored = [
        lambda index=index: Monitor(
            static(), str(tmp_path / f"{index}"), info_keywords=("is_success",)
        )
        for index in range(2)
    ]
    envs = VecNormalize(DummyVecEnv(monitored), norm_obs_keys=list(FIELDS))
    envs.seed(3)
    observations = envs.reset()
    returns = []
    for _ in range(20):
        actions, _ = ORACLE.predict(envs.get_original_obs())
        observations, _, dones, infos = envs.step(actions)
        assert dones.all()
        assert all(np.isfinite(array).all() for array in observations.values())
        for info, reward in zip(infos, envs.get_original_reward(), strict=True):
            assert info["episode"]["l"] == 1
            assert info["episode"]["r"] == pytest.approx(reward, abs=1e-5)
            assert info["terminal_observation"].keys() == observations.keys()
            assert info["TimeLimit.truncated"] is False
            returns.append(info["is_success"])
    assert sum(returns) > 20
    # what never changes is not blown up, and padding stays zero before it is normalised
    assert all(np.abs(array).max() <= 10.0 for array in observations.values())
    envs.close()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["GraspForceStatic-v0", "GraspForceUnannounced-v0"])
def test_ppo_learns_without_complaint(name: str) -> None:
    env = gym.make(name, split="test")
    model = PPO("MultiInputPolicy", env, n_steps=64, batch_size=32, n_epochs=1, seed=0)
    model.learn(128)
    observation, _ = env.reset(seed=reseeded(0))
    action, _ = model.predict(observation)
    assert action.shape == (24,)
    assert len(model.ep_success_buffer) > 0
    env.close()
