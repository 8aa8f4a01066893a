"""Confidence intervals that treat objects, not grasps, as the independent samples."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from solvers.arrays import Array

from .numbers import NONE

RESAMPLES = 1000
LEVEL = 0.95


@dataclass(frozen=True)
class Interval:
    """A number with its 95 % interval over objects; NaN where there is none.

    Formatted, as in f"{interval:+.1%}", all three numbers get the form; by default three decimals.
    """

    value: float
    low: float
    high: float

    @classmethod
    def of(
        cls,
        values: Array,
        object_ids: NDArray[np.str_],
        statistic: Callable[[Array], Any] = np.mean,
        *,
        seed: int = 0,
    ) -> Self:
        """A statistic of values (k,) with its `object_interval`; NaN if there are no values."""
        low, high = object_interval(values, object_ids, statistic, seed=seed)
        return cls(float(statistic(values)) if len(values) else float("nan"), low, high)

    @property
    def ends(self) -> list[float]:
        """Lower and upper end, for rows of JSON."""
        return [self.low, self.high]

    def __format__(self, form: str) -> str:
        if not np.isfinite(self.value):
            return NONE
        form = form or ".3f"
        return f"{self.value:{form}} [{self.low:{form}}, {self.high:{form}}]"

    def __str__(self) -> str:
        return format(self)


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
