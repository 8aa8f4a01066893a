"""The benchmark's report: a text with gaps, the numbers that fill them, figures."""

from importlib.resources import files
from pathlib import Path

import numpy as np

from training.measuring.timing import SHIFT
from training.reports.figures import save
from training.reports.numbers import listed

from . import tables
from .conic import BenchmarkError
from .figures import batch_figure, edge_figure, gap_figure, polygon_figure
from .load_factor import ACCURACY
from .measure import ENOUGH, FAILURE_SECONDS
from .network_figures import CERTIFIED
from .problem_sets import MIX
from .rows import micro
from .run import BLOCK, Benchmark
from .sentences import edge_text, geometric_text, network_text, polygon_text, summary

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


def write_report(benchmark: Benchmark, path: Path, command: str) -> None:
    """Write the report, and its pictures beside it as benchmark_*.png.

    Args:
        benchmark: what it is about.
        path: of the Markdown file.
        command: that makes it, for the reader.

    Raises:
        BenchmarkError: if the grasps allow no problem set at all.
    """
    if not benchmark.results[MIX]:
        raise BenchmarkError("no solver could be measured: give more grasps")
    template = files(__package__).joinpath("template.md").read_text(encoding="utf-8")
    path.write_text(template.format_map(_fields(benchmark, command)), encoding="utf-8")
    _draw(benchmark, path.parent)


def _fields(benchmark: Benchmark, command: str) -> dict[str, str]:
    picky = [each.title for each in benchmark.entrants if each.feasible_only]
    missing = benchmark.absent
    scaled = {name: name for name in tables.scaled_names(benchmark)}
    fields = {
        "command": command,
        "absent": f"Not installed here, and absent below: {listed(missing)}." if missing else "",
        "summary": summary(benchmark),
        "grasps": f"{len(benchmark.table):,}",
        "objects": str(len(set(benchmark.table.object_id.tolist()))),
        "edge_accuracy": f"{ACCURACY:.0e}",
        "edge_tried": str(benchmark.edge_tried),
        "edge_kept": str(benchmark.edge_kept),
        "feasible_only": (
            f" † {listed(picky)} raises at an infeasible problem, and is given feasible ones only."
            if picky
            else ""
        ),
        "block": str(BLOCK),
        "subset": str(BLOCK),
        "shift": f"{1e6 * SHIFT:.0f}",
        "failure": f"{1e6 * FAILURE_SECONDS:,.0f}",
        "enough": f"{ENOUGH:g}",
        "geometric_text": geometric_text(benchmark),
        "edge_text": edge_text(benchmark),
        "network_text": network_text(benchmark),
        "polygon_text": polygon_text(benchmark),
        "scaled_table": tables.settled_table(benchmark, scaled),
        "scaled_times": tables.converted_table(benchmark, scaled),
        "device_text": (
            f"{benchmark.device[0].device}, tensors already on it.\n\n"
            f"{tables.device_table(benchmark)}"
            if benchmark.device
            else "There was no GPU in this run, so there are no figures for one."
        ),
        "machine_table": tables.machine_table(),
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


def _draw(benchmark: Benchmark, folder: Path) -> None:
    sizes = benchmark.plan.batch_sizes
    by_size = {
        each.title: np.array(
            [
                micro(found.converted)
                if (found := benchmark.batches.get((each.key, size))) is not None
                else np.nan
                for size in sizes
            ]
        )
        for each in benchmark.entrants
        if each.key in _SHOWN_BY_SIZE
    }
    save(batch_figure(sizes, by_size), folder / "benchmark_batches.png")
    mix = benchmark.sets[MIX]
    gaps = {}
    for each, measured in tables.ran(benchmark, MIX):
        mine = measured.gap[mix.feasible[measured.rows]]
        if each.threads == 1:
            gaps[each.title] = np.where(np.isfinite(mine), mine, np.inf)
    save(gap_figure(gaps, CERTIFIED), folder / "benchmark_gaps.png")
    loads = tables.load_sets(benchmark)
    if loads:
        _draw_edge(benchmark, loads, folder / "benchmark_edge.png")
        audited = {f: benchmark.polygons[n] for f, n in tables.polygon_loads(benchmark).items()}
        save(polygon_figure(audited), folder / "benchmark_polygons.png")


def _draw_edge(benchmark: Benchmark, loads: dict[float, str], path: Path) -> None:
    shown = [each for each in benchmark.entrants if each.key in _SHOWN_AT_THE_EDGE]
    time, settled = {}, {}
    for each in shown:
        found = [benchmark.results[name].get(each.key) for name in loads.values()]
        time[each.title] = np.array([micro(m.converted) if m else np.nan for m in found])
        settled[each.title] = np.array([tables.settled(m) if m else np.nan for m in found])
    save(edge_figure(list(loads), time, settled), path)
