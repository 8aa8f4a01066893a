"""The benchmark's pictures: arrays in, a matplotlib figure out."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from solvers.arrays import Array
from training.reports.figures import CYCLE, STYLE, new_figure

from .polygons import INNER, PolygonErrors

_DASHES = ("solid", (0, (5, 1.5)))
_MARKERS = ("o", "s", "^", "D", "v", "P", "X")


@rc_context(STYLE)
def edge_figure(
    factors: Sequence[float], times: Mapping[str, Array], settled: Mapping[str, Array]
) -> Figure:
    """Time and share settled against the load, over the largest load that the grasp can carry.

    Args:
        factors: (L,) of the load.
        times: (L,) us a problem, by title; NaN where not measured.
        settled: (L,) share, by title.
    """
    figure = new_figure(8.4, 5.6)
    upper = figure.add_subplot(2, 1, 1)
    lower = figure.add_subplot(2, 1, 2, sharex=upper)
    places = np.arange(len(factors))
    for index, title in enumerate(times):
        look = _look(index)
        upper.semilogy(places, times[title], label=title, **look)
        lower.plot(places, 100 * settled[title], **look)
    edge = float(np.searchsorted(factors, 1.0)) - 0.5
    for axes in (upper, lower):
        axes.axvline(edge, color="#333333", lw=1.0)
    upper.annotate(
        "no forces exist", (edge, 1.0), (4, 3), xycoords=("data", "axes fraction"),
        textcoords="offset points", va="bottom", fontsize=9,
    )  # fmt: skip
    upper.set_ylabel("µs per problem")
    upper.tick_params(labelbottom=False)
    lower.set(ylim=(-4, 104), ylabel="settled, %")
    lower.set_xticks(places, [f"{factor:g}" for factor in factors], rotation=30)
    lower.set_xlabel("load over the largest that the grasp can carry")
    figure.legend(loc="outside right upper")
    return figure


@rc_context(STYLE)
def gap_figure(gaps: Mapping[str, Array], goal: float, least: float = 1e-16) -> Figure:
    """The share of feasible problems with a certified gap below each value.

    Args:
        gaps: by title, one a problem that has an answer; infinite where there is none.
        goal: marked.
        least: smaller gaps are drawn here.
    """
    figure = new_figure(7.6, 3.9)
    axes = figure.add_subplot()
    for index, (title, gap) in enumerate(gaps.items()):
        shown = np.sort(np.maximum(np.abs(gap), least))
        shown = shown[np.isfinite(shown)]
        share = 100 * np.arange(1, len(shown) + 1) / len(gap)
        look = {key: value for key, value in _look(index).items() if key not in ("marker", "ms")}
        axes.step(shown, share, where="post", label=title, **look)
    axes.axvline(goal, color="#333333", lw=1.0)
    axes.set_xscale("log")
    axes.set(xlim=(least, 1.0), ylim=(0, 102))
    axes.set(xlabel="certified gap, relative", ylabel="feasible problems, %")
    figure.legend(loc="outside right upper")
    return figure


@rc_context(STYLE)
def batch_figure(sizes: Sequence[int], times: Mapping[str, Array]) -> Figure:
    """Time a problem against the size of the batch, both logarithmic.

    Args:
        sizes: (S,) of the batches.
        times: (S,) us a problem, by title; NaN where not measured.
    """
    figure = new_figure(7.6, 3.9)
    axes = figure.add_subplot()
    for index, (title, time) in enumerate(times.items()):
        known = np.isfinite(time)
        axes.loglog(np.array(sizes)[known], time[known], label=title, **_look(index))
    axes.set_xticks(list(sizes), [f"{size:,}" for size in sizes])
    axes.minorticks_off()
    axes.set(xlabel="problems in one call", ylabel="µs per problem")
    figure.legend(loc="outside right upper")
    return figure


@rc_context(STYLE)
def polygon_figure(audits: Mapping[float, Sequence[PolygonErrors]]) -> Figure:
    """The share of wrong answers about feasibility, polygon by polygon, against the load.

    Args:
        audits: by load over the largest that the grasp can carry.
    """
    figure = new_figure(7.6, 3.6)
    axes = figure.add_subplot()
    factors = sorted(audits)
    kinds = [(each.kind, each.sides) for each in audits[factors[0]]]
    sides = sorted({count for _, count in kinds})
    for kind, count in kinds:
        shares = []
        for factor in factors:
            (found,) = [a for a in audits[factor] if (a.kind, a.sides) == (kind, count)]
            shares.append(found.falsely_infeasible if kind == INNER else found.falsely_feasible)
        wrong = "called infeasible" if kind == INNER else "called feasible"
        axes.plot(
            np.arange(len(factors)),
            100 * np.array(shares),
            color=CYCLE[sides.index(count)],
            ls=_DASHES[kind != INNER],
            marker=_MARKERS[sides.index(count)],
            ms=5,
            label=f"{kind}, {count} sides: {wrong}",
        )
    axes.axvline(np.searchsorted(factors, 1.0) - 0.5, color="#333333", lw=1.0)
    axes.set_xticks(np.arange(len(factors)), [f"{factor:g}" for factor in factors])
    axes.set(ylim=(-4, 104), ylabel="wrong answers, %")
    axes.set_xlabel("load over the largest that the grasp can carry")
    figure.legend(loc="outside right upper")
    return figure


def _look(index: int) -> dict[str, Any]:
    """Colour, dashes and marker of the index-th line; no two of the first fourteen are alike."""
    return {
        "color": CYCLE[index % len(CYCLE)],
        "ls": _DASHES[(index // len(CYCLE)) % 2],
        "marker": _MARKERS[index % len(_MARKERS)],
        "ms": 4,
        "lw": 1.4,
    }
