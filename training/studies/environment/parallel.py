"""Environments in several processes at once: plain ones, and Gymnasium's vector of them."""

import multiprocessing
import os
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from queue import Empty
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from gfo_env.env import GraspForceEnv
from gfo_env.workers import end_with

from .plan import EnvSpeedError

DYNAMIC, STATIC = "GraspForce-v0", "GraspForceStatic-v0"
"""Environments; their steps are counted, resets included."""

SQUEEZE = 5.0
"""N, constant normal force of every contact here: a policy that costs nothing."""

_WARM_RESETS = 20
_PATIENCE = 300.0
"""s that a process may take to begin."""

Action = NDArray[np.float32]


def squeeze(env: GraspForceEnv) -> Action:
    """The action that presses with 5 N at every contact."""
    action = np.zeros(env.action_space.shape or (), np.float32)
    action[2::3] = SQUEEZE / env.settings.max_force
    return action


def plain_rate(env_id: str, workers: int, seconds: float, seed: int, table: Path | None) -> float:
    """Steps per second of so many processes with an environment each, which begin together.

    Args:
        env_id: `DYNAMIC` or `STATIC`.
        workers: processes.
        seconds: that they run.
        seed: of the first; each next one adds 1.
        table: grasps to begin with; None for the user's cache.

    Raises:
        EnvSpeedError: a process ended before its time.
    """
    context = multiprocessing.get_context("spawn")
    start, rates = context.Barrier(workers), context.Queue()
    processes = [
        context.Process(
            target=_work,
            args=(env_id, seconds, seed + k, table, start, rates, os.getpid()),
            daemon=True,
        )
        for k in range(workers)
    ]
    for process in processes:
        process.start()
    try:
        total = sum(rates.get(timeout=_PATIENCE + seconds) for _ in processes)
    except Empty:
        raise EnvSpeedError("a process with an environment did not answer") from None
    finally:
        for process in processes:
            process.terminate()
            process.join()
    return float(total)


def _work(
    env_id: str,
    seconds: float,
    seed: int,
    table: Path | None,
    start: Any,
    rates: Any,
    parent: int,
) -> None:
    end_with(parent)
    env = gymnasium.make(env_id, grasps=table).unwrapped
    assert isinstance(env, GraspForceEnv)
    action = squeeze(env)
    for k in range(_WARM_RESETS):
        env.reset(seed=seed + k)
        env.step(action)

    def step() -> None:
        _, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            env.reset()

    env.reset(seed=seed)
    start.wait(_PATIENCE)
    rates.put(_rate(step, 1, seconds))
    env.close()


def vector_rate(env_id: str, workers: int, seconds: float, seed: int, table: Path | None) -> float:
    """Steps per second of `gymnasium.make_vec(..., vectorization_mode="async")`; see above."""
    envs: Any = gymnasium.make_vec(
        env_id,
        num_envs=workers,
        vectorization_mode="async",
        vector_kwargs={"autoreset_mode": AutoresetMode.SAME_STEP},
        wrappers=[partial(_ending_with, os.getpid())],  # type: ignore[list-item]
        grasps=table,
    )
    try:
        actions = np.zeros(envs.action_space.shape, np.float32)
        actions[:, 2::3] = SQUEEZE / envs.get_attr("settings")[0].max_force
        envs.reset(seed=seed)
        for _ in range(_WARM_RESETS):
            envs.step(actions)
        return _rate(lambda: envs.step(actions), workers, seconds)
    finally:
        envs.close()


def _ending_with(parent: int, env: gymnasium.Env[Any, Any]) -> gymnasium.Env[Any, Any]:
    """The environment, in a process that ends with its parent: made there, as wrappers are."""
    if os.getpid() != parent:  # the vector makes one environment here, to know its spaces
        end_with(parent)
    return env


def _rate(step: Callable[[], Any], steps: int, seconds: float) -> float:
    """Steps per second of calls that make `steps` of them each."""
    count, begin = 0, time.perf_counter()
    while (spent := time.perf_counter() - begin) < seconds:
        step()
        count += steps
    return count / spent
