"""Confidence intervals that treat objects, not grasps, as the independent samples."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

RESAMPLES = 1000
LEVEL = 0.95

Array = NDArray[np.float64]


def object_interval(
    values: Array,
    object_ids: NDArray[np.str_],
    statistic: Callable[[Array], Any] = np.mean,
    *,
    seed: int = 0,
) -> tuple[float, float]:
    """95 % percentile bootstrap interval of a statistic, whole objects resampled.

    Grasps of one object are alike, so resampling them one by one would make intervals too narrow.

    Args:
        values: (k, ...) one row a sample; NaN rows must be left out beforehand.
        object_ids: (k,) the object of each row.
        statistic: of the resampled rows.
        seed: of the resampling.

    Returns:
        Lower and upper end; NaN where there are no samples.
    """
    if not len(values):
        return float("nan"), float("nan")
    names, member = np.unique(object_ids, return_inverse=True)
    rows = [np.flatnonzero(member == index) for index in range(len(names))]
    rng = np.random.default_rng(seed)
    results = [
        statistic(
            values[np.concatenate([rows[i] for i in rng.integers(len(rows), size=len(rows))])]
        )
        for _ in range(RESAMPLES)
    ]
    tail = 100 * (1 - LEVEL) / 2
    low, high = np.percentile(results, [tail, 100 - tail])
    return float(low), float(high)
