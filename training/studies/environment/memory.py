"""Whether long training eats memory: resident pages, files and PyBullet clients over resets."""

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gfo_env.env import GraspForceEnv

from .parallel import squeeze

_MOST_CLIENTS = 1024
"""That PyBullet allows in a process."""


@dataclass(frozen=True)
class MemoryUse:
    """Before and after many resets, each followed by a step.

    Args:
        resets: how many.
        objects: that they went through, all of them loaded once before.
        resident_mib: MiB, before.
        half_mib: MiB more after half of the resets.
        growth_mib: MiB more after all.
        files: open before, and after.
        clients: of PyBullet before, and after.
    """

    resets: int
    objects: int
    resident_mib: float
    half_mib: float
    growth_mib: float
    files: tuple[int, int]
    clients: tuple[int, int]

    @property
    def kib_per_reset(self) -> float:
        """KiB that a reset adds, over the later half, in which all is warm."""
        return 1024.0 * (self.growth_mib - self.half_mib) / max(1, self.resets - self.resets // 2)


def memory(
    resets: int, objects: int, seed: int, table: Path | None, step: Callable[[], None]
) -> MemoryUse:
    """Reset over and over, after every object has been loaded once.

    Args:
        resets: how many, with a step each.
        objects: that they go through, less where the grasps are of fewer.
        seed: of the loads.
        table: grasps to begin with; None for the user's cache.
        step: called after each reset, those of the warm-up too.
    """
    env = GraspForceEnv(grasps=table)
    action = squeeze(env)
    by_object = _numbers(env, objects)
    rng = np.random.default_rng(seed)
    env.reset(seed=seed)

    def reset(numbers: list[int]) -> None:
        env.reset(options={"grasp": int(rng.choice(numbers))})
        env.step(action)
        step()

    for numbers in by_object:
        reset(numbers)
    before, files, clients = _resident(), _files(), _clients(env)
    half = before
    for k in range(resets):
        if k == resets // 2:
            half = _resident()
        reset(by_object[k % len(by_object)])
    figures = MemoryUse(
        resets=resets,
        objects=len(by_object),
        resident_mib=before,
        half_mib=half - before,
        growth_mib=_resident() - before,
        files=(files, _files()),
        clients=(clients, _clients(env)),
    )
    env.close()
    return figures


def _numbers(env: GraspForceEnv, objects: int) -> list[list[int]]:
    """Grasps by object, of so many objects, those that episodes can begin with."""
    found: dict[str, list[int]] = {}
    for number in range(len(env.grasps)):
        stored = env.grasps.grasp(number)
        if stored is not None:
            found.setdefault(stored.grasp.object_id, []).append(number)
    return list(found.values())[:objects]


def _resident() -> float:
    """MiB of the process in memory; 0 where the system does not say."""
    pages = Path("/proc/self/statm")
    if not pages.exists():
        return 0.0
    return int(pages.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


def _files() -> int:
    folder = Path("/proc/self/fd")
    return len(list(folder.iterdir())) if folder.exists() else 0


def _clients(env: GraspForceEnv) -> int:
    bullet = env.simulation.bullet
    return sum(
        bool(bullet.getConnectionInfo(client)["isConnected"]) for client in range(_MOST_CLIENTS)
    )
