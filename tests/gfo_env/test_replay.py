"""A seed and actions give the same bits in any process, and resets leave nothing behind."""

import gc
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pybullet as p
import pytest

from gfo_env.env import GraspForceEnv
from tests.support.episodes import Step, random_actions
from tests.support.seeds import reseeded

ROOT = Path(__file__).resolve().parents[2]
VARIANTS: dict[str, dict[str, Any]] = {
    "announced": {},
    "unannounced": {"announced": False, "exact_quality": True},
    "static": {"mode": "static", "torque_scale_range": (0.5, 1.5)},
}
SEED = 1

REPLAY = """
import sys
from tests.gfo_env.test_replay import VARIANTS, replay, save
save(replay(VARIANTS[sys.argv[1]]), sys.argv[2])
"""


def shaky(seed: int) -> Any:
    """Halfway between a grip and random forces, so that objects slip but are not lost at once."""
    noise = random_actions(seed)

    def act(observation: dict[str, Any]) -> np.ndarray:
        return 0.1 * noise(observation) + np.tile([0.0, 0.0, 0.25], 8)

    return act


def episode(env: Any, steps: int) -> list[Step]:
    """A given number of steps from reset on, whatever becomes of the object."""
    act = shaky(3)
    observation, info = env.reset(seed=reseeded(SEED))
    played: list[Step] = [(observation, 0.0, False, False, info)]
    for _ in range(steps):
        played.append(env.step(act(played[-1][0])))
    return played


def replay(arguments: dict[str, Any]) -> list[Step]:
    env = GraspForceEnv(split="test", **arguments)
    played = episode(env, 1 if arguments.get("mode") == "static" else 12)
    env.close()
    return played


def as_arrays(steps: list[Step]) -> dict[str, np.ndarray]:
    """Everything in an episode by name, to the last bit."""
    arrays = {}
    for number, (observation, reward, terminated, truncated, info) in enumerate(steps):
        arrays[f"{number}_outcome"] = np.array([reward, terminated, truncated])
        arrays[f"{number}_info"] = np.array([str(value) for value in info.values()])
        for name, array in observation.items():
            arrays[f"{number}_{name}"] = array
    return arrays


def save(steps: list[Step], path: str) -> None:
    np.savez(path, **as_arrays(steps))  # type: ignore[arg-type]


def assert_same_bits(steps: list[Step], path: Path) -> None:
    here = as_arrays(steps)
    with np.load(path) as there:
        assert set(there.files) == set(here)
        for name, array in here.items():
            assert array.dtype == there[name].dtype
            assert array.tobytes() == there[name].tobytes(), name


@pytest.mark.parametrize("variant", VARIANTS)
def test_another_process_replays_to_the_bit(
    variant: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With an empty cache, which it fills, and with the cache then warm.

    The user's cache may hold grasps that were made with other kernels, here too it is left alone.
    """
    cache = tmp_path / "cache"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "here"))
    here = replay(VARIANTS[variant])
    environment = os.environ | {"XDG_CACHE_HOME": str(cache)}
    for number in range(2):
        assert cache.exists() is (number == 1)
        path = tmp_path / f"{number}.npz"
        subprocess.run(
            [sys.executable, "-c", REPLAY, variant, str(path)],
            cwd=ROOT,
            env=environment,
            check=True,
        )
        assert_same_bits(here, path)
        assert list(cache.rglob("*"))


@pytest.mark.parametrize("warm", [False, True])
def test_a_worker_replays_to_the_bit(
    warm: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    arguments = VARIANTS["unannounced"]
    if warm:
        replay(arguments)
    envs = gym.make_vec(
        "GraspForceUnannounced-v0",
        num_envs=2,
        vectorization_mode="async",
        vector_kwargs={"context": "fork", "shared_memory": False},
        split="test",
        **arguments,
    )
    act = shaky(3)
    observations, infos = envs.reset(seed=[reseeded(SEED) + 1, reseeded(SEED)])
    steps = [first_of(observations, 0.0, False, False, infos)]
    for _ in range(3):
        actions = np.stack([act(steps[-1][0])] * 2)
        steps.append(first_of(*envs.step(actions.astype(np.float64))))
    envs.close()
    alone = replay(arguments)[:4]
    for (seen, reward, *_), (expected, own, *_) in zip(steps, alone, strict=True):
        assert reward == own
        for name, array in expected.items():
            assert array.tobytes() == seen[name].tobytes()


def first_of(
    observations: dict[str, np.ndarray], rewards: Any, terminated: Any, truncated: Any, infos: Any
) -> Step:
    """What the second environment of a vector says."""
    del infos
    reward, *ends = (
        value if np.ndim(value) == 0 else value[1] for value in (rewards, terminated, truncated)
    )
    observation = {name: array[1] for name, array in observations.items()}
    return observation, float(reward), bool(ends[0]), bool(ends[1]), {}


def test_an_episode_does_not_depend_on_those_before() -> None:
    env = GraspForceEnv(split="test")
    first = as_arrays(episode(env, 12))
    for seed in (7, 8):
        env.reset(seed=reseeded(seed))
        env.step(np.ones(24))
    env.reset(seed=reseeded(9), options={"mass": 2.0, "friction": 0.2, "gravity": [0.0, 30.0, 0.0]})
    env.step(np.ones(24))
    again = as_arrays(episode(env, 12))
    assert first.keys() == again.keys()
    for name, array in first.items():
        assert array.tobytes() == again[name].tobytes(), name
    env.close()


def resident_bytes() -> int:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def open_files() -> int:
    return len(os.listdir("/proc/self/fd"))


def connected_clients() -> int:
    return sum(p.isConnected(client) for client in range(64))


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="needs /proc")
def test_a_thousand_resets_leave_nothing_behind() -> None:
    env = GraspForceEnv(split="test")
    slots: dict[str, int] = {}
    seed = 0
    while len(slots) < 50:
        _, info = env.reset(seed=reseeded(seed))
        slots[info["object_id"]] = info["grasp"]
        seed += 1
    numbers = list(slots.values())

    def reset(count: int) -> None:
        for index in range(count):
            env.reset(seed=index % 50, options={"grasp": numbers[index % len(numbers)]})
            env.step(np.full(24, 0.2))

    # all grasps are known and all objects loaded, and what allocators keep has grown
    reset(300)
    gc.collect()  # what earlier tests of this process left is not closed in between
    before = resident_bytes(), open_files(), connected_clients()
    reset(1000)
    gc.collect()
    after = resident_bytes(), open_files(), connected_clients()
    assert after[1] <= before[1]
    assert after[2] == before[2]
    assert after[0] - before[0] < 5e6
    env.close()
