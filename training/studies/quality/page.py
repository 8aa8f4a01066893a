"""The page docs/quality.md: a text with gaps, the numbers that fill them, one picture."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from solvers.arrays import Array
from training.reports import pages
from training.reports.intervals import Interval
from training.reports.numbers import share
from training.reports.results import Run
from training.reports.tables import table

from .figures import pareto_figure
from .measures import Measures, QualityStudy
from .plan import QualityStudyPlan
from .results import Results, median, tenth
from .run import EVEN, FLOW, METHODS, NETWORK, PRICED, REFERENCE

Owners = NDArray[np.str_]

_SAYS = {
    "least_norm": "least-norm forces, of less effort",
    "nearest_squeeze": "nearest feasible forces to an equal squeeze",
    "uniform_preload": "least norm with a uniform preload",
    "untrained": "the network's steps, untrained",
    "quality": "the network",
    "quality_search": "the reference",
}


def write_page(run: Run[QualityStudy], path: Path) -> str:
    """Write the page, and its picture beside it under the same name; its summary.

    Args:
        run: what it is about.
        path: of the Markdown file.
    """
    study = run.results
    results = Results(study.rows)
    fields = _fields(study, results) | {
        "command": run.command,
        "processor": run.machine["processor"],
    }
    pages.write_page(path, __package__, fields, {"": _figure(study.plan, results)})
    return str(fields["summary"])


def summary(study: QualityStudy, results: Results) -> str:
    """The result in five lines."""
    plan, measures = study.plan, study.measures
    shares, owners = _pooled(plan, results, 0, NETWORK)
    known, _ = _pooled(plan, results, len(plan.sets) - 1, NETWORK)
    plain, plain_owners = _pooled(plan, results, 0, FLOW)
    gain, gain_owners = _pooled_gain(plan, results, 0, REFERENCE)
    rows_of = [row for row in study.rows if row["method"] == NETWORK]
    feasible = sum(row["feasible"] for row in rows_of)
    ratio = np.median(shares) / np.median(known)
    return "\n".join(
        [
            f"- On held-out objects the network reaches {median(shares, owners)} of the "
            f"reference's q_lrw (median), {Interval.of(shares, owners, tenth)} at the 10th "
            f"percentile; {np.median(known):.3f} on objects of the training, a ratio of "
            f"{ratio:.3f}.",
            f"- Its steps before any training, the flow and chance around it, reach "
            f"{median(plain, plain_owners)} and {Interval.of(plain, plain_owners, tenth)}: what "
            "training adds is the difference.",
            f"- {feasible:,} of its {len(rows_of):,} answers are feasible, by the judge.",
            f"- The reference is {median(gain, gain_owners):.1%} above the uniform preload of the "
            "same effort.",
            f"- In batches of {measures.batch:,} the network takes "
            f"{1e3 * measures.seconds[NETWORK]:.2f} ms a problem, {measures.ratio:,.0f} times less "
            "than the reference.",
        ]
    )


def _fields(study: QualityStudy, results: Results) -> dict[str, object]:
    plan, measures = study.plan, study.measures
    return {
        "summary": summary(study, results),
        "training_command": study.training["command"],
        "training_grasps": study.training["grasps"],
        "training_steps": study.training["steps"],
        "rounds": plan.rounds,
        "proposals": study.proposals,
        "points": f"{study.steps} steps make {study.steps * study.proposals + 1}",
        "rgb_objects": "rgb_objects" in {folder.name for folder in plan.folders},
        "sets_table": _sets_table(plan, results),
        "shares_tables": "\n".join(_shares_table(plan, results, i) for i in range(len(plan.sets))),
        "gains_table": _gains_table(plan, results),
        "prices_table": _prices_table(plan, results),
        "most": f"{max(plan.times):g}",
        "batch": f"{measures.batch:,}",
        "timed": plan.timed,
        "times_table": _times_table(measures),
        "judged": measures.judged,
        "errors_table": _errors_table(measures),
    }


def _title(plan: QualityStudyPlan, number: int) -> str:
    name, split = plan.sets[number]
    if number == len(plan.sets) - 1:
        return "objects of the training"
    return f"{name}, {split}" if name == "random_urdfs" else Path(name).name


def _sets_table(plan: QualityStudyPlan, results: Results) -> str:
    lines = []
    for number in range(len(plan.sets)):
        answers = results.answers(number, REFERENCE, max(plan.times))
        closed = results.compared(number, max(plan.times)).sum()
        counts = (len(answers.owners), closed, len(np.unique(answers.owners)))
        lines.append([_title(plan, number), *map(str, counts)])
    return table(("set", "problems", "with force closure", "objects"), lines)


def _shares_table(plan: QualityStudyPlan, results: Results, number: int) -> str:
    """q_lrw over the reference's: medians by budget, and the 10th percentile over all."""
    budgets = [f"{times:g}x" for times in plan.times]
    headings = ["forces", *budgets, "10th percentile, all budgets", "feasible"]
    lines = []
    for method in METHODS:
        cells = [str(median(*results.shares(number, method, times))) for times in plan.times]
        worst = Interval.of(*_pooled(plan, results, number, method), tenth)
        feasible = np.concatenate(
            [results.answers(number, method, times).feasible for times in plan.times]
        )
        lines.append([_SAYS[method], *cells, str(worst), share(feasible.mean())])
    title = _title(plan, number)
    return f"\n**{title}**\n\n{table(headings, lines, 'l' * (len(headings) - 1) + 'r')}"


def _gains_table(plan: QualityStudyPlan, results: Results) -> str:
    headings = ("set", "budget", "reference", "the most that is possible", "network")
    lines = []
    for number in range(len(plan.sets)):
        for times in plan.times:
            even = results.answers(number, EVEN, times)
            kept = results.compared(number, times) & (even.lower > 0.0)
            bound = results.answers(number, REFERENCE, times).bound
            most = bound[kept] / even.lower[kept] - 1.0
            cells = [
                f"{median(*results.gains(number, REFERENCE, EVEN, times)):.1%}",
                f"{median(most, even.owners[kept]):.1%}",
                f"{median(*results.gains(number, NETWORK, EVEN, times)):.1%}",
            ]
            lines.append([_title(plan, number), f"{times:g}x", *cells])
    return table(headings, lines, "lrl")


def _prices_table(plan: QualityStudyPlan, results: Results) -> str:
    lines = []
    times = max(plan.times)
    for number in range(len(plan.sets)):
        kept = results.compared(number, times)
        for price in plan.prices:
            cells = []
            for method in PRICED:
                answers = results.answers(number, method, times, price)
                worth = answers.worth[kept] / answers.scale[kept]
                effort = np.median(answers.effort[kept])
                cells.append(f"{Interval.of(worth, answers.owners[kept])}, {effort:.2f}x")
            lines.append([_title(plan, number), f"{price:g}", *cells])
    names = [f"{_SAYS[name]}: worth, effort" for name in PRICED]
    return table(("set", "price", *names), lines, "lrl")


def _times_table(measures: Measures) -> str:
    seconds = {_SAYS[method]: each for method, each in measures.seconds.items()}
    judged = measures.seconds[NETWORK] + measures.judge
    seconds["the network, and the judge's verdict with the interval of q_lrw"] = judged
    reference = measures.seconds[REFERENCE]
    lines = [
        [name, f"{1e3 * each:,.2f}", f"{reference / each:,.0f} times as long"]
        for name, each in seconds.items()
    ]
    return table(("forces", "ms a problem", "reference takes"), lines)


def _errors_table(measures: Measures) -> str:
    lines = [[name, *(f"{value:.1%}" for value in each)] for name, each in measures.errors.items()]
    return table(("estimate, forces", "median", "p90", "largest"), lines)


def _pooled(
    plan: QualityStudyPlan, results: Results, number: int, method: str
) -> tuple[Array, Owners]:
    """Shares of the reference's quality at all budgets, and their objects."""
    parts = [results.shares(number, method, times) for times in plan.times]
    return np.concatenate([p for p, _ in parts]), np.concatenate([o for _, o in parts])


def _pooled_gain(
    plan: QualityStudyPlan, results: Results, number: int, method: str
) -> tuple[Array, Owners]:
    parts = [results.gains(number, method, EVEN, times) for times in plan.times]
    return np.concatenate([p for p, _ in parts]), np.concatenate([o for _, o in parts])


def _figure(plan: QualityStudyPlan, results: Results) -> Figure:
    panels = {}
    most = max(plan.times)
    for number in range(len(plan.sets)):
        kept = results.compared(number, most)
        top = results.answers(number, REFERENCE, most).lower[kept]
        curves: dict[str, list[tuple[float, Interval]]] = {}
        for method in METHODS:
            for times in plan.times if method != METHODS[0] else plan.times[:1]:
                answers = results.answers(number, method, times)
                quality = median(answers.lower[kept] / top, answers.owners[kept])
                effort = float(np.median(answers.effort[kept]))
                curves.setdefault(method, []).append((effort, quality))
        panels[_title(plan, number)] = curves
    return pareto_figure(panels)
