"""Plain numbers from arrays; None where there is none."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .network_accuracy import NetworkAccuracy

Array = NDArray[np.float64]
Row = dict[str, Any]


def network_row(network: NetworkAccuracy) -> Row:
    """The network's accuracy in numbers."""
    return {
        "dual_gap_median": percentile(network.dual_gap, 50),
        "dual_gap_p90": percentile(network.dual_gap, 90),
        "dual_gap_p99": percentile(network.dual_gap, 99),
        "feasible_share": network.feasible_share,
        "gap_median": percentile(network.gap, 50),
        "gap_p90": percentile(network.gap, 90),
        "polished_share": network.polished_share,
        "polished_gap_median": percentile(network.polished_gap, 50),
        "polished_gap_p90": percentile(network.polished_gap, 90),
        "settled_with_fallback": network.settled,
        "train_ratio": network.train_ratio,
        "newton_steps_mean": number(np.mean(network.steps)) if len(network.steps) else None,
        "cold_steps_mean": number(np.mean(network.cold_steps)) if len(network.steps) else None,
        "problems": len(network.dual_gap),
    }


def number(value: Any) -> float | None:
    """A float, or None where it is no finite number."""
    return float(value) if np.isfinite(value) else None


def percentile(values: Array, which: float) -> float | None:
    """A percentile of the numbers among some values; None if there are none."""
    found = np.asarray(values, dtype=np.float64)
    found = found[np.isfinite(found)]
    return float(np.percentile(found, which)) if len(found) else None


def micro(seconds: Array) -> float:
    """Median in us."""
    return 1e6 * float(np.median(seconds))
