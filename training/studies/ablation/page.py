"""The page about the conditioned network: a text with gaps, and the measurements that fill them."""

from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure

from training.reports import pages
from training.reports.figures import BLUE, GREY, STYLE, VERMILION, new_figure
from training.reports.numbers import scientific
from training.reports.results import Run
from training.reports.tables import table

from .run import BASE, MOST_NEWTON_STEPS, SOLVED, Ablation, AblationRow
from .stages import AblationStudy, Stages


def write_page(run: Run[AblationStudy], path: Path) -> str:
    """Write the page, and its picture beside it; a word on it.

    Args:
        run: what it is about.
        path: of the Markdown file.
    """
    ablation = run.results.ablation
    plan, base = ablation.plan, ablation.rows[0]
    shipped = [_stages(name, each) for name, each in run.results.stages.items()]
    fields = {
        "command": run.command,
        "ablation": _variants(ablation),
        "stages": "\n\n".join(shipped),
        "objects": str(ablation.objects),
        "problems": f"{ablation.problems:,}",
        "feasible": f"{ablation.feasible:,}",
        "training_steps": str(plan.steps),
        "batch": str(plan.batch),
        "repeats": str(plan.repeats),
        "weights": f"{base.weights:,}",
        "cold": f"{ablation.cold_newton_steps:.1f}",
        "solved": scientific(SOLVED),
        "most": str(MOST_NEWTON_STEPS),
    }
    pages.write_page(path, __package__, fields, {"ablation": _figure(ablation)})
    return f"{len(ablation.rows)} variants"


def _variants(ablation: Ablation) -> str:
    headings = (
        "what is changed",
        "to",
        "gap median",
        "p90",
        "p99",
        "feasible",
        "Newton steps",
        "weights",
        "us a problem",
    )
    return table(headings, [_variant(row) for row in ablation.rows], "llr")


def _variant(row: AblationRow) -> list[str]:
    base = row.group == BASE.group
    return [
        "nothing" if base else row.group,
        row.name,
        *(_range(values, scientific) for values in (row.gap_median, row.gap_p90, row.gap_p99)),
        _range(row.feasible, lambda value: f"{value:.1%}"),
        _range(row.steps_to_gap, lambda value: f"{value:.2f}"),
        f"{row.weights:,}",
        f"{row.microseconds:.0f}",
    ]


def _range(values: list[float], form: Any) -> str:
    """One value, or the least and the largest of several where they look different."""
    low, high = form(min(values)), form(max(values))
    return low if low == high else f"{low} to {high}"


def _stages(name: str, stages: Stages) -> str:
    headings = ("start", "Newton steps", "dual gap", "feasible", "certified gap", "proven")
    rows = [
        [
            stage.start,
            str(stage.polish_steps),
            _three(stage.gap),
            f"{stage.feasible:.1%}",
            _three(stage.certified_gap),
            f"{stage.proven:.1%}",
        ]
        for stage in stages.rows
    ]
    counts = stages.steps_to_gap
    return "\n\n".join(
        [
            f"**{name}** ({stages.problems:,} problems, {stages.feasible:,} of them feasible; "
            f"Newton steps to a relative gap of {scientific(SOLVED)}: {counts['network']:.2f} "
            f"from the network, {counts['cold']:.2f} from cold)",
            table(headings, rows, "lr"),
        ]
    )


def _three(values: list[float]) -> str:
    return " / ".join(scientific(max(value, 0.0)) for value in values)


@rc_context(STYLE)
def _figure(ablation: Ablation) -> Figure:
    """Median, 90th and 99th percentile of the gap, a line a variant."""
    rows = ablation.rows[::-1]
    figure = new_figure(7.2, 0.9 + 0.28 * len(rows))
    axes = figure.add_subplot()
    for place, row in enumerate(rows):
        gaps = [sorted(values) for values in (row.gap_median, row.gap_p90, row.gap_p99)]
        middle = [values[len(values) // 2] for values in gaps]
        axes.plot([middle[0], middle[2]], [place, place], color=GREY, lw=1.0, zorder=1)
        for values, colour, marker in zip(gaps, (BLUE, BLUE, VERMILION), "|oo", strict=True):
            axes.plot(values, [place] * len(values), marker, color=colour, ms=6, mew=1.5, ls="")
    axes.set_xscale("log")
    labels = [row.name if row.group == BASE.group else f"{row.group}: {row.name}" for row in rows]
    axes.set_yticks(range(len(rows)), labels)
    axes.set_xlabel("relative dual gap: median (bar), 90 % (blue), 99 % (red)")
    return figure
