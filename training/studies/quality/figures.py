"""The picture of the comparison: quality against effort, one panel a set."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from training.reports.figures import BLACK, BLUE, GREEN, GREY, ORANGE, STYLE, VERMILION, new_figure
from training.reports.intervals import Interval

LOOKS = {
    "least_norm": (GREY, "s"),
    "nearest_squeeze": (ORANGE, "v"),
    "uniform_preload": (VERMILION, "D"),
    "untrained": (GREEN, "^"),
    "quality": (BLUE, "o"),
    "quality_search": (BLACK, "*"),
}

Curves = Mapping[str, Sequence[tuple[float, Interval]]]


@rc_context(STYLE)
def pareto_figure(panels: Mapping[str, Curves]) -> Figure:
    """q_lrw over the reference's at the largest budget, against effort over the least norm's.

    Args:
        panels: by title, by method: effort and quality at each budget.
    """
    figure = new_figure(4.4 * len(panels), 4.2)
    first = None
    for index, (title, curves) in enumerate(panels.items()):
        axes = figure.add_subplot(1, len(panels), index + 1, sharey=first)
        first = first or axes
        for place, (method, points) in enumerate(curves.items()):
            colour, marker = LOOKS[method]
            # a little apart, so that intervals do not hide each other
            effort = np.array([point for point, _ in points]) + 0.012 * (place - 2)
            values = np.array([quality.value for _, quality in points])
            low = values - [quality.low for _, quality in points]
            high = np.array([quality.high for _, quality in points]) - values
            axes.errorbar(
                effort, values, yerr=np.stack([low, high]), color=colour, marker=marker, ms=5,
                lw=1.3, elinewidth=0.9, capsize=2, label=method if index == 0 else None,
            )  # fmt: skip
        axes.set(title=title, xlabel="effort over that of the least-norm forces")
        if index:
            axes.tick_params(labelleft=False)
        else:
            axes.set_ylabel("q_lrw over the reference's\nat the largest budget, median")
    figure.legend(loc="outside lower center", ncols=len(LOOKS))
    return figure
