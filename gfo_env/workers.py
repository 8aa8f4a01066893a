"""Processes that share work, each on one core."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager

from joblib import Parallel, parallel_config


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
