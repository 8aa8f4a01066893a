"""Processes that share work, each on one core, and bars that tell how far they are."""

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

from joblib import Parallel, parallel_config
from rich.progress import Progress


@contextmanager
def worker_pool(workers: int) -> Iterator[Parallel]:
    """A pool whose calls return generators of results, in the order of the jobs.

    Args:
        workers: processes.
    """
    with (
        warnings.catch_warnings(),
        parallel_config(backend="loky", inner_max_num_threads=1),
        Parallel(n_jobs=workers, return_as="generator") as pool,
    ):
        # loky replaces workers whose memory has grown; nothing is lost by it
        warnings.filterwarnings("ignore", "A worker stopped while some jobs", UserWarning)
        yield pool


def bar(progress: Progress | None, title: str, total: int) -> Callable[..., None]:
    """What moves a new bar on by one, or by so many; it does nothing without a progress."""
    if progress is None:
        return lambda count=1: None
    return partial(progress.advance, progress.add_task(title, total=total))
