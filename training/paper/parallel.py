"""One loop over processes, with a bar, for every experiment of the reproduction."""

import warnings
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from joblib import Parallel, delayed, parallel_config
from rich.progress import Progress

Result = TypeVar("Result")


def run_all(
    function: Callable[..., Result],
    arguments: Sequence[tuple[Any, ...]],
    *,
    title: str,
    workers: int,
    progress: Progress | None,
) -> list[Result]:
    """`function` of each tuple of arguments, in their order, in `workers` processes.

    Args:
        function: at the top level of a module, so that a process can find it.
        arguments: one tuple a call.
        title: of the bar.
        workers: processes.
        progress: a bar is added to it.
    """
    bar = progress.add_task(title, total=len(arguments)) if progress else None
    results: list[Result] = []
    with (
        warnings.catch_warnings(),
        parallel_config(backend="loky", inner_max_num_threads=1),
        Parallel(n_jobs=workers, return_as="generator") as pool,
    ):
        # loky replaces workers whose memory has grown; nothing is lost by it
        warnings.filterwarnings("ignore", "A worker stopped while some jobs", UserWarning)
        for result in pool(delayed(function)(*one) for one in arguments):
            results.append(result)
            if progress is not None and bar is not None:
                progress.advance(bar)
    return results
