"""Collecting grasps: many seeded attempts over an object set, in parallel, resumable after a kill.

Grasps go to a table, or fill the cache of a `GraspSource`. They depend neither on the number of
workers nor on interruptions.
"""

import math
import shutil
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from joblib import delayed
from rich.progress import Progress

from gfo_env.hand import BARRETT_BH8_280, HandDescription
from gfo_env.objects import RESCALE, ObjectSet
from gfo_env.workers import Pool, bar, worker_pool
from solvers import GraspForceError

from .acquisition import Outcome
from .attempts import CHUNK, Attempts, Chunk, ChunkStore, make_chunk
from .source import GraspSource
from .table import GraspTable, GraspTableError

_CHUNKS_AT_ONCE = 20

_LEAST_YIELD = 0.05
_LEAST_ATTEMPTS = 200
"""A set whose yield is less after so many attempts is not collected from any further."""


class CollectionError(GraspForceError, ValueError):
    """What is to be collected, or how, makes no sense."""


@dataclass(frozen=True, eq=False)
class CollectionReport:
    """How a collection went.

    Args:
        grasps: collected.
        attempts: made for them.
        outcomes: attempts by outcome, the values of `gfo_env.grasps.acquisition.Outcome`.
        objects_tried: distinct objects among the attempts.
        objects_grasped: of these, with one grasp at least.
        attempt_ms: time on its worker of each attempt that was made now and not found from before,
            loading the object excluded.
        seconds: wall time of the whole collection.
    """

    grasps: int
    attempts: int
    outcomes: dict[str, int]
    objects_tried: int
    objects_grasped: int
    attempt_ms: np.ndarray
    seconds: float

    def summary(self) -> dict[str, float | int | dict[str, int] | None]:
        """The figures of the report, as JSON has them; None where no attempt was made to time."""
        timed = len(self.attempt_ms) > 0
        mean = float(self.attempt_ms.mean()) if timed else None
        return {
            "grasps": self.grasps,
            "attempts": self.attempts,
            "yield": self.outcomes.get(Outcome.GRASP.value, 0) / self.attempts,
            "outcomes": self.outcomes,
            "objects_tried": self.objects_tried,
            "objects_grasped": self.objects_grasped,
            "object_yield": self.objects_grasped / self.objects_tried,
            "attempt_ms_median": float(np.median(self.attempt_ms)) if timed else None,
            "attempt_ms_p95": float(np.percentile(self.attempt_ms, 95)) if timed else None,
            "ms_per_grasp_one_core": mean and mean * self.attempts / max(self.grasps, 1),
            "seconds": self.seconds,
            "grasps_per_second": self.grasps / self.seconds,
        }


@dataclass(frozen=True)
class CollectionPlan:
    """What to collect; it determines the grasps to the last bit.

    Args:
        objects: where the objects come from.
        grasps: how many.
        seed: of all random choices.
        hand: that grasps.
        fingertips: whether only fingertips may touch.

    Raises:
        CollectionError: the number is not positive, or the seed negative.
    """

    objects: ObjectSet
    grasps: int
    seed: int
    hand: HandDescription = BARRETT_BH8_280
    fingertips: bool = False

    def __post_init__(self) -> None:
        if self.grasps < 1:
            raise CollectionError(f"grasps is {self.grasps}; it must be 1 or more")
        if self.seed < 0:
            raise CollectionError(f"seed is {self.seed}; it must be 0 or more")

    def attempts(self) -> Attempts:
        """The attempts that yield the grasps, the first ones of them."""
        return Attempts(self.objects, self.seed, self.hand, self.fingertips)


def collect(
    plan: CollectionPlan,
    *,
    workers: int = 1,
    output: Path | None = None,
    progress: Progress | None = None,
) -> tuple[GraspTable, CollectionReport]:
    """Attempt grasps until the plan's number is reached.

    Args:
        plan: what to collect.
        workers: processes.
        output: where the table goes. Finished chunks are kept beside it, in a folder of its name
            with `.parts` appended, until it is written; an interrupted collection of the same plan
            goes on from there.
        progress: a bar is added to it.

    Raises:
        CollectionError: if there is no worker, or the output is a folder.
        GraspTableError: if the objects yield next to no grasps.
        MeshError: if an object of the set cannot be read.
    """
    if output is not None and output.is_dir():
        raise CollectionError(f"{output} is a folder; name a file to write the grasps to")
    started = time.perf_counter()
    attempts = plan.attempts()
    store = ChunkStore(None if output is None else Path(f"{output}.parts"), attempts)
    task = progress.add_task("grasps", total=plan.grasps) if progress else None
    chunks: list[Chunk] = []
    found = 0
    with _pool(workers) as pool:
        while found < plan.grasps:
            wanted = math.ceil((plan.grasps - found) / CHUNK)
            numbers = range(len(chunks), len(chunks) + min(wanted, _CHUNKS_AT_ONCE * workers))
            for chunk in _chunks(attempts, store, numbers, pool):
                chunks.append(chunk)
                found += len(chunk.table)
                if progress is not None and task is not None:
                    progress.update(task, completed=min(found, plan.grasps))
            tried = len(chunks) * CHUNK
            if tried >= _LEAST_ATTEMPTS and found < _LEAST_YIELD * tried:
                raise GraspTableError(
                    f"only {found} grasps in {tried} attempts on {plan.objects!r}: are the "
                    "objects of graspable size, 3 to 20 cm? "
                    + (plan.objects.advice_on_size() or RESCALE)
                )
    table = GraspTable.concatenate([chunk.table for chunk in chunks])[: plan.grasps]
    outcomes = [outcome for chunk in chunks for outcome in chunk.outcomes]
    times = [value for chunk in chunks for value in chunk.milliseconds]
    # the last chunk may have attempts beyond the last grasp that was wanted
    report = _report(attempts, outcomes[: int(table.attempt[-1]) + 1], times, started)
    if output is not None:
        table.save(output)
    if store.folder is not None:
        shutil.rmtree(store.folder, ignore_errors=True)
        with suppress(OSError):  # parts of another plan may lie beside these
            store.folder.parent.rmdir()
    return table, report


def fill_cache(
    source: GraspSource, *, workers: int = 1, progress: Progress | None = None
) -> CollectionReport:
    """Make what is missing in a source's cache.

    Args:
        source: without a table.
        workers: processes.
        progress: a bar is added to it.

    Raises:
        CollectionError: if there is no worker.
        MeshError: if an object of the set cannot be read.
        OSError: if the cache cannot be written.
    """
    started = time.perf_counter()
    count = math.ceil(len(source) / CHUNK)
    block = _CHUNKS_AT_ONCE * workers
    step = bar(progress, "chunks", count)
    outcomes: list[str] = []
    times: list[float] = []
    with _pool(workers) as pool:
        for first in range(0, count, block):
            numbers = range(first, min(first + block, count))
            for chunk in _chunks(source.attempts, source.store, numbers, pool):
                outcomes += chunk.outcomes
                times += chunk.milliseconds
                step()
    return _report(source.attempts, outcomes[: len(source)], times, started)


def _pool(workers: int) -> AbstractContextManager[Pool]:
    if workers < 1:
        raise CollectionError(f"workers is {workers}; it must be 1 or more")
    return worker_pool(workers)


def _chunks(attempts: Attempts, store: ChunkStore, numbers: range, pool: Pool) -> Iterator[Chunk]:
    """Chunks in the order of their numbers: from the store, or made and put there."""
    known = {number: store.read(number) for number in numbers}
    missing = [number for number in numbers if known[number] is None]
    made = pool(delayed(make_chunk)(attempts, n) for n in missing) if missing else iter(())
    for number in numbers:
        chunk = known.pop(number)
        if chunk is None:
            chunk = next(made)
            store.write(chunk)
        yield chunk


def _report(
    attempts: Attempts, outcomes: list[str], milliseconds: list[float], started: float
) -> CollectionReport:
    """What became of the first attempts, one for each outcome."""
    objects = [attempts.object_id(number) for number in range(len(outcomes))]
    grasped = [
        object_id
        for object_id, outcome in zip(objects, outcomes, strict=True)
        if outcome == Outcome.GRASP
    ]
    return CollectionReport(
        grasps=len(grasped),
        attempts=len(outcomes),
        outcomes=dict(Counter(outcomes).most_common()),
        objects_tried=len(set(objects)),
        objects_grasped=len(set(grasped)),
        attempt_ms=np.array(milliseconds),
        seconds=time.perf_counter() - started,
    )
