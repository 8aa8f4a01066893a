"""The page docs/benchmark.md: a text with gaps, the numbers that fill them, pictures."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from training.measuring.timing import SHIFT
from training.reports import pages
from training.reports.results import Run
from training.reports.tables import table

from . import tables
from .conic import BenchmarkError
from .figures import batch_figure, edge_figure, gap_figure, polygon_figure
from .load_factor import ACCURACY
from .measure import ENOUGH, FAILURE_SECONDS
from .network_accuracy import CERTIFIED
from .problem_sets import MIX
from .rows import micro
from .run import BLOCK, Benchmark
from .sentences import best_exact, summary

_SHOWN_BY_SIZE = (
    "clarabel",
    "moreau",
    "dual_newton",
    "dual_newton_2",
    "interior_point",
    "dual_newton_torch",
    "network_polished",
)
_SHOWN_AT_THE_EDGE = (
    "clarabel",
    "moreau",
    "ecos",
    "scs",
    "dual_newton",
    "interior_point",
    "network_fallback",
)


def write_page(run: Run[Benchmark], path: Path) -> str:
    """Write the page, and its pictures beside it; its summary.

    Args:
        run: what it is about.
        path: of the Markdown file.

    Raises:
        BenchmarkError: if the grasps allow no problem set at all.
    """
    benchmark = run.results
    if not benchmark.results[MIX]:
        raise BenchmarkError("no solver could be measured: give more grasps")
    fields = _fields(benchmark) | {
        "command": run.command,
        "machine_table": table(("part", "here"), list(run.machine.items()), "l"),
    }
    pages.write_page(path, __package__, fields, _figures(benchmark))
    return str(fields["summary"])


def _fields(benchmark: Benchmark) -> dict[str, Any]:
    scaled = {name: name for name in tables.scaled_names(benchmark)}
    device = benchmark.device
    fields = {
        "absent": benchmark.absent,
        "summary": summary(benchmark),
        "grasps": f"{benchmark.grasps:,}",
        "objects": benchmark.objects,
        "edge_accuracy": f"{ACCURACY:.0e}",
        "edge_tried": benchmark.edge_tried,
        "edge_kept": benchmark.edge_kept,
        "feasible_only": [each.title for each in benchmark.entrants if each.feasible_only],
        "block": BLOCK,
        "shift": f"{1e6 * SHIFT:.0f}",
        "failure": f"{1e6 * FAILURE_SECONDS:,.0f}",
        "enough": f"{ENOUGH:g}",
        "blocks": sum(len(next(iter(one.values())).alone) for one in benchmark.results.values()),
        "sets": len(benchmark.results),
        "edge": _edge(benchmark),
        "worth": _worth(benchmark),
        "polygon_loads": tables.polygon_loads(benchmark) and tables.polygon_load_table(benchmark),
        "scaled_table": tables.settled_table(benchmark, scaled),
        "scaled_times": tables.converted_table(benchmark, scaled),
        "device": device[0].device if device else "",
        "device_table": tables.device_table(benchmark) if device else "",
    }
    for name in (
        "sets_table",
        "solvers_table",
        "time_table",
        "batch_table",
        "geometric_table",
        "answers_table",
        "network_table",
        "polygon_table",
    ):
        fields[name] = getattr(tables, name)(benchmark)
    return fields


def _edge(benchmark: Benchmark) -> dict[str, Any] | None:
    """Tables near the edge, and who settled every problem there; None without such problems."""
    loads = tables.load_sets(benchmark)
    if not loads:
        return None
    names = {name: f"{load:g}" for load, name in loads.items()}
    near = [name for load, name in loads.items() if 0.99 < load < 1.01]
    weak: list[str] = []
    firm: list[str] = []
    for each in benchmark.entrants:
        if each.feasible_only:
            continue
        found = [benchmark.results[name].get(each.key) for name in near]
        shares = [tables.settled(measured) for measured in found if measured is not None]
        (firm if min(shares, default=0.0) == 1.0 else weak).append(each.title)
    return {
        "settled": tables.settled_table(benchmark, names),
        "converted": tables.converted_table(benchmark, names),
        "weak": weak,
        "firm": firm,
    }


def _worth(benchmark: Benchmark) -> dict[str, Any] | None:
    """Whether the network is worth it on this machine; None without a solver to compare with."""
    results = benchmark.results[MIX]
    own = best_exact(benchmark)
    polished = results.get("network_polished")
    time = tables.throughput(benchmark, "network_polished")
    network = benchmark.network
    if network is None or polished is None or own is None or time is None:
        return None
    exact, cold = own[0], float(np.mean(network.cold_steps))
    return {
        "exact": exact.title,
        "longer": time / own[1],
        "saved": cold - float(np.mean(network.steps)) if len(network.steps) else 0.0,
        "cold": cold,
        "settled": tables.settled(polished),
        "exact_settled": tables.settled(results[exact.key]),
    }


def _figures(benchmark: Benchmark) -> dict[str, Figure]:
    sizes = benchmark.plan.batch_sizes
    by_size = {
        each.title: np.array(
            [
                micro(found.converted)
                if (found := benchmark.batch(each.key, size)) is not None
                else np.nan
                for size in sizes
            ]
        )
        for each in benchmark.entrants
        if each.key in _SHOWN_BY_SIZE
    }
    mix = benchmark.sets[MIX]
    gaps = {}
    for each, measured in tables.ran(benchmark, MIX):
        mine = measured.gap[mix.feasible[measured.rows]]
        if each.threads == 1:
            gaps[each.title] = np.where(np.isfinite(mine), mine, np.inf)
    figures = {"batches": batch_figure(sizes, by_size), "gaps": gap_figure(gaps, CERTIFIED)}
    loads = tables.load_sets(benchmark)
    if loads:
        audited = {f: benchmark.polygons[n] for f, n in tables.polygon_loads(benchmark).items()}
        figures |= {"edge": _edge_figure(benchmark, loads), "polygons": polygon_figure(audited)}
    return figures


def _edge_figure(benchmark: Benchmark, loads: dict[float, str]) -> Figure:
    shown = [each for each in benchmark.entrants if each.key in _SHOWN_AT_THE_EDGE]
    time, settled = {}, {}
    for each in shown:
        found = [benchmark.results[name].get(each.key) for name in loads.values()]
        time[each.title] = np.array([micro(m.converted) if m else np.nan for m in found])
        settled[each.title] = np.array([tables.settled(m) if m else np.nan for m in found])
    return edge_figure(list(loads), time, settled)
