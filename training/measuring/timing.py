"""Timing on chosen cores, interleaved, and the means that are made of it."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from solvers.arrays import Array

SHIFT = 1e-5
"""s, shift of the geometric mean: times far below it count as equal."""


def usable_cores() -> list[int]:
    """The cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


@contextmanager
def pinned(count: int) -> Iterator[None]:
    """Keep every thread of the process on the first `count` of its cores.

    Threads of a pool keep the cores that they were born with, so that pinning the calling thread
    alone would leave them where they are. Does nothing where the system has no such call.
    """
    cores = usable_cores()
    _confine(cores[:count])
    try:
        yield
    finally:
        _confine(cores)


def _confine(cores: list[int]) -> None:
    if not hasattr(os, "sched_setaffinity"):
        return
    for task in Path("/proc/self/task").iterdir():
        with suppress(ProcessLookupError):  # a thread may end meanwhile
            os.sched_setaffinity(int(task.name), cores)


def shifted_geometric_mean(values: Array, shift: float) -> float:
    """exp(mean(log(values + shift))) - shift, as in Mittelmann's benchmarks and qpbenchmark."""
    return float(np.exp(np.mean(np.log(np.asarray(values) + shift))) - shift)
