"""Plain numbers from arrays; None where there is none."""

import numpy as np

from solvers.arrays import Array


def percentile(values: Array, which: float) -> float | None:
    """A percentile of the numbers among some values; None if there are none."""
    found = np.asarray(values, dtype=np.float64)
    found = found[np.isfinite(found)]
    return float(np.percentile(found, which)) if len(found) else None


def micro(seconds: Array) -> float:
    """Median in us."""
    return 1e6 * float(np.median(seconds))
