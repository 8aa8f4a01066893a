"""The figures of a benchmark as rows for a JSON file: plain numbers, None where there is none."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .measure import Measured
from .network_figures import CERTIFIED, NetworkFigures
from .run import Benchmark

Array = NDArray[np.float64]
Row = dict[str, Any]


def rows(benchmark: Benchmark) -> list[Row]:
    """Every figure; `part` says which table a row belongs to."""
    table: list[Row] = []
    for name, results in benchmark.results.items():
        for key, measured in results.items():
            table.append({"part": "set", "set": name, "solver": key, **_measured(measured)})
    for (key, size), times in benchmark.batches.items():
        row = {"part": "batch", "size": size, "solver": key, "timed_subset": times.subset}
        for stage in ("alone", "converted", "judged"):
            row[f"{stage}_us"] = micro(getattr(times, stage))
        table.append(row)
    if benchmark.network is not None:
        table.append({"part": "network", **network_row(benchmark.network)})
    for name, audits in benchmark.polygons.items():
        for audit in audits:
            table.append(
                {
                    "part": "polygon",
                    "set": name,
                    "kind": audit.kind,
                    "sides": audit.sides,
                    "extra_effort_median": percentile(audit.extra_effort, 50),
                    "extra_effort_p90": percentile(audit.extra_effort, 90),
                    "slip_max": percentile(audit.slip, 100),
                    "falsely_infeasible": number(audit.falsely_infeasible),
                    "falsely_feasible": number(audit.falsely_feasible),
                    "undecided": audit.undecided,
                }
            )
    for figures in benchmark.device:
        table.append(
            {
                "part": "device",
                "device": figures.device,
                "solver": figures.title,
                "size": figures.size,
                "us": 1e6 * figures.seconds / figures.size,
                "certified": figures.certified,
                "certified_per_second": figures.per_second,
            }
        )
    return table


def network_row(network: NetworkFigures) -> Row:
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


def _measured(measured: Measured) -> Row:
    row: Row = {"problems": len(measured.rows)}
    for stage in ("alone", "converted", "judged"):
        row[f"{stage}_us"] = micro(getattr(measured, stage))
    for status in ("optimal", "feasible", "infeasible", "failed"):
        row[status] = measured.share(status)
    row["settled"] = float(np.mean(measured.settled))
    row["wrong"] = int(measured.wrong.sum())
    row["fallen_back"] = float(np.mean(measured.fallen_back))
    row["certified"] = float(np.mean(np.abs(measured.gap) <= CERTIFIED))
    for name in ("gap", "balance", "violation"):
        for which in (50, 90, 99):
            row[f"{name}_p{which}"] = percentile(getattr(measured, name), which)
    return row
