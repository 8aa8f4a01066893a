"""Processes that share work, each on one core, and bars that tell how far they are."""

import os
import signal
import time
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from threading import Thread
from typing import Any

from joblib import Parallel, parallel_config
from rich.progress import Progress

Pool = Callable[[Iterable[Any]], Iterator[Any]]
"""From jobs, made by `joblib.delayed`, to their results."""

_PATIENCE = 1.0
"""s between two looks of a worker after its parent."""


def end_with(parent: int) -> None:
    """End this process soon after its parent, however that one ends.

    A killed parent tells nobody, and a worker would finish its job and wait for another.

    Args:
        parent: the parent's number, asked there: it may have ended before this one has begun.
    """

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(_PATIENCE)
        os._exit(1)

    Thread(target=watch, daemon=True).start()


def _begin_work(parent: int) -> None:
    """What a worker does first."""
    # who interrupts a command means the command, which then ends its workers
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with(parent)


@contextmanager
def worker_pool(workers: int) -> Iterator[Pool]:
    """A pool whose calls return generators of results, in the order of the jobs.

    Jobs whose results nobody has fetched when the pool is left are given up. No worker outlives
    this process by more than a second or two.

    Args:
        workers: processes.
    """
    # one worker is this process
    first = {"initializer": _begin_work, "initargs": (os.getpid(),)} if workers > 1 else {}
    with (
        warnings.catch_warnings(),
        parallel_config(backend="loky", inner_max_num_threads=1),
        Parallel(n_jobs=workers, return_as="generator", **first) as pool,
    ):
        # loky replaces workers whose memory has grown; nothing is lost by it
        warnings.filterwarnings("ignore", "A worker stopped while some jobs", UserWarning)
        warnings.filterwarnings("ignore", "[0-9]+ tasks ", UserWarning)
        begun: list[Generator[Any, None, None]] = []

        def give_up() -> None:
            while begun:
                begun.pop().close()

        def results(jobs: Iterable[Any]) -> Iterator[Any]:
            give_up()  # a pool does one thing at a time
            begun.append(pool(jobs))
            return begun[-1]

        try:
            yield results
        finally:
            give_up()


def bar(progress: Progress | None, title: str, total: int) -> Callable[..., None]:
    """What moves a new bar on by one, or by so many; it does nothing without a progress."""
    if progress is None:
        return lambda count=1: None
    return partial(progress.advance, progress.add_task(title, total=total))
