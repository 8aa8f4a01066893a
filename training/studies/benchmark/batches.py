"""The same mix in batches of one to many: what a call costs, and what a problem costs in it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from gfo_env.grasps import GraspTable
from solvers.arrays import Array

from .entrants import Entrant
from .measure import timed
from .problem_sets import ProblemSet, draw

SIZES = (1, 64, 4096, 65536)

LONGEST = 10.0
"""s, predicted from the next smaller batch, above which the largest batch is left out."""

_SPENT = 2.0
"""s, in the runs of one solver at one size, after which it is not run again."""

_SINGLES = 30
_REPEATS = {64: 9, 4096: 5, 65536: 3}


@dataclass(frozen=True, eq=False)
class BatchTimes:
    """Times of one entrant at one batch size, s per problem, one a repeat; see `entrants`.

    Args:
        alone: (repeats,).
        converted: (repeats,).
        judged: (repeats,).
        subset: how many problems were really timed, where it takes them one by one.
    """

    alone: Array
    converted: Array
    judged: Array
    subset: int | None


BatchResults = dict[str, dict[int, BatchTimes]]
"""By entrant's key, then by batch size."""


def batch_times(
    entrants: Sequence[Entrant],
    mix: ProblemSet,
    table: GraspTable,
    sizes: Sequence[int],
    rng: np.random.Generator,
    advance: Callable[[], None] = lambda: None,
) -> BatchResults:
    """Time batches of the mix, interleaved.

    Single problems come from `mix`, whose truth is known; entrants that take problems one by one
    are timed on the first 64 of a batch, those that must not see infeasible problems on the
    feasible ones of `mix`.

    Args:
        entrants: who.
        mix: problems with their truth.
        table: grasps to draw larger batches from.
        sizes: of `SIZES`.
        rng: of the draws.
        advance: called after every repeat.
    """
    results: BatchResults = {}
    feasible = mix.problems[np.flatnonzero(mix.feasible)]
    for size in sizes:
        times: dict[str, list[tuple[float, float, float]]] = {}
        subset: dict[str, int | None] = {}
        spent: dict[str, float] = {}
        repeats = repetitions(size, len(mix))
        for repeat in range(repeats):
            drawn = draw(table, size, rng) if size > 1 else mix.problems[[repeat]]
            for turn in range(len(entrants)):
                entrant = entrants[(turn + repeat) % len(entrants)]
                if _left_out(results, entrant, size) or spent.get(entrant.key, 0.0) > _SPENT:
                    continue
                problems = drawn
                if entrant.feasible_only:
                    if not len(feasible):
                        continue
                    start = repeat % len(feasible) if size == 1 else 0
                    problems = feasible[np.arange(start, min(start + min(size, 64), len(feasible)))]
                elif not entrant.batched:
                    problems = drawn[:64]
                run = timed(entrant, problems)
                spent[entrant.key] = spent.get(entrant.key, 0.0) + run.judged
                count = len(problems)
                subset[entrant.key] = count if count < size else None
                times.setdefault(entrant.key, []).append(
                    (run.alone / count, run.converted / count, run.judged / count)
                )
            advance()
        for key, rows in times.items():
            alone, converted, judged = np.array(rows).T
            results.setdefault(key, {})[size] = BatchTimes(alone, converted, judged, subset[key])
    return results


def repetitions(size: int, singles: int) -> int:
    """How often `batch_times` draws batches of a size, where it has so many single problems."""
    return min(_SINGLES, singles) if size == 1 else _REPEATS[size]


def _left_out(results: BatchResults, entrant: Entrant, size: int) -> bool:
    """Whether the largest batch would take too long; a subset does not grow."""
    if not entrant.batched or entrant.feasible_only or size < SIZES[-1]:
        return False
    before = results.get(entrant.key, {}).get(SIZES[-2])
    return before is not None and float(np.median(before.judged)) * size > LONGEST
