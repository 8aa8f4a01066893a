"""One loop over processes, with a bar, for every experiment of the reproduction."""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from joblib import delayed
from rich.progress import Progress

from gfo_env.workers import bar, worker_pool

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
    step = bar(progress, title, len(arguments))
    results: list[Result] = []
    with worker_pool(workers) as pool:
        for result in pool(delayed(function)(*one) for one in arguments):
            results.append(result)
            step()
    return results
