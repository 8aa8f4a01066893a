"""Scores of several runs as one: interquartile means with bootstrap intervals.

After Agarwal et al., "Deep reinforcement learning at the edge of the statistical precipice", 2021:
means over few runs hang on the luckiest, so the mean of the middle half is reported, with an
interval that says how much the runs and the objects leave open.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.stats import bootstrap, trim_mean

from solvers.arrays import Array

from .intervals import LEVEL, RESAMPLES, Interval

_CUT = 0.25
"""Share of the runs that is left out at either end."""


def interquartile_mean(scores: Array) -> float:
    """Mean of the middle half of scores, (runs,)."""
    return float(trim_mean(scores, _CUT))


def over_runs(values: Array, object_ids: NDArray[np.str_], *, seed: int = 0) -> Interval:
    """Interquartile mean over runs of their means; the interval is over runs and objects.

    Args:
        values: (runs, episodes): the same episodes in every run.
        object_ids: (episodes,).
        seed: of the resampling.
    """
    names, member = np.unique(object_ids, return_inverse=True)
    totals = np.stack([np.bincount(member, row, len(names)) for row in values])
    counts = np.bincount(member, minlength=len(names))

    def statistic(runs: NDArray[np.intp], objects: NDArray[np.intp]) -> float:
        return interquartile_mean(totals[np.ix_(runs, objects)].sum(1) / counts[objects].sum())

    result = bootstrap(
        (np.arange(len(values)), np.arange(len(names))),
        statistic,
        vectorized=False,
        n_resamples=RESAMPLES,
        confidence_level=LEVEL,
        method="percentile",
        rng=np.random.default_rng(seed),
    )
    low, high = result.confidence_interval
    return Interval(interquartile_mean(values.mean(axis=1)), float(low), float(high))


def curve_band(curves: Array, *, seed: int = 0) -> tuple[Array, Array, Array]:
    """Interquartile mean of learning curves, (runs, points), and its 95 % interval over runs."""
    middle = trim_mean(curves, _CUT, axis=0)
    rng = np.random.default_rng(seed)
    picks = rng.integers(len(curves), size=(RESAMPLES, len(curves)))
    resampled = trim_mean(curves[picks], _CUT, axis=1)
    tail = 100 * (1 - LEVEL) / 2
    low, high = np.percentile(resampled, [tail, 100 - tail], axis=0)
    return middle, low, high
