"""ROC areas with intervals over objects, all resamples at once.

The area of a resample of objects needs no sorting: of every two objects it is known how many
survivors of the one score above losses of the other, and a resample only says how often each
object counts.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from solvers.arrays import Array, Mask
from training.reports.intervals import LEVEL, RESAMPLES, Interval


class ObjectAreas:
    """ROC areas of shakes, and of resamples of their objects.

    Args:
        owners: (m,) object of each shake.
        seed: of the resamples, which are those of `training.reports.intervals.object_interval`.
    """

    def __init__(self, owners: NDArray[np.str_], seed: int = 0) -> None:
        names, self._member = np.unique(owners, return_inverse=True)
        count = len(names)
        rng = np.random.default_rng(seed)
        drawn = [rng.integers(count, size=count) for _ in range(RESAMPLES)] if count else []
        times = [np.bincount(objects, minlength=count) for objects in drawn]
        # the first is the sample itself
        self._times = np.array([np.ones(count), *times])

    def area(self, score: Array, held: Mask) -> Interval:
        """The area of a score (m,) against outcomes (m,)."""
        return _interval(self._areas(score, held))

    def difference(self, score: Array, held: Mask, other: Mask) -> Interval:
        """The area against the outcomes `other` (m,) less that against `held` (m,)."""
        return _interval(self._areas(score, other) - self._areas(score, held))

    def mean_area(self, score: Array, held: Mask, parts: Sequence[Mask]) -> Interval:
        """The mean of the areas within parts (m,) of the shakes; those without one do not count."""
        areas = np.array([self._areas(score, held, part) for part in parts])
        counted = np.isfinite(areas)
        total = np.where(counted, areas, 0.0).sum(axis=0)
        number = counted.sum(axis=0)
        return _interval(np.where(number > 0, total / np.maximum(number, 1), np.nan))

    def _areas(self, score: Array, held: Mask, part: Mask | None = None) -> Array:
        """(resamples + 1,) areas; NaN where all are held, or none."""
        chosen = np.ones(len(held), dtype=np.bool_) if part is None else part
        good, bad = np.flatnonzero(chosen & held), np.flatnonzero(chosen & ~held)
        count = self._times.shape[1]
        above = 0.5 + 0.5 * np.sign(score[good][:, None] - score[bad][None])
        rows = np.zeros((count, len(bad)))
        np.add.at(rows, self._member[good], above)
        wins = np.zeros((count, count))
        np.add.at(wins.T, self._member[bad], rows.T)
        survivors = self._times @ np.bincount(self._member[good], minlength=count)
        losses = self._times @ np.bincount(self._member[bad], minlength=count)
        pairs = survivors * losses
        won = ((self._times @ wins) * self._times).sum(axis=1)
        return np.where(pairs > 0, won / np.maximum(pairs, 1), np.nan)


def _interval(resampled: Array) -> Interval:
    """The first value, and the percentiles of the others that exist."""
    others = resampled[1:][np.isfinite(resampled[1:])]
    if not np.isfinite(resampled[0]) or not len(others):
        return Interval(float(resampled[0]), float("nan"), float("nan"))
    tail = 100 * (1 - LEVEL) / 2
    low, high = np.percentile(others, [tail, 100 - tail])
    return Interval(float(resampled[0]), float(low), float(high))
