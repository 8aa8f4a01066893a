"""The page's picture: what each measure tells of survival, and survival against effort."""

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Picture
from matplotlib.lines import Line2D

from training.reports.figures import BLACK, BLUE, CYCLE, GREEN, GREY, STYLE, VERMILION, new_figure

from .analysis import FITS, Analysis, Skill
from .measures import FORCES, GRASP, JOINTS, MEASURES, WRENCHES
from .methods import LABELS

KIND_LABELS = {
    WRENCHES: "wrenches that contacts can apply",
    FORCES: "forces and effort",
    GRASP: "grasp and object",
    JOINTS: "what the joints let happen",
}
_COLOURS = {WRENCHES: BLUE, FORCES: GREEN, GRASP: GREY, JOINTS: VERMILION}
_MARKERS = "os^vDP"

_ASIDE = 0.25
"""N."""


@rc_context(STYLE)
def survival_figure(analysis: Analysis) -> Picture:
    """ROC areas with their intervals, a row a measure, beside hold rates against effort."""
    figure = new_figure(11.0, 0.21 * len(analysis.skills) + 1.9)
    left, right = figure.subplots(1, 2, width_ratios=[1.0, 0.95])
    _areas(left, analysis)
    _rates(right, analysis)
    kinds = [Line2D([], [], ls="", marker="o", color=c, ms=5) for c in _COLOURS.values()]
    figure.legend(
        kinds, [KIND_LABELS[kind] for kind in _COLOURS], loc="outside lower left", ncols=4
    )
    return figure


def _areas(axes: Axes, analysis: Analysis) -> None:
    ranked = sorted(analysis.skills, key=lambda skill: skill.pooled.value)
    fits = list(reversed(analysis.fits))
    labels: list[str] = []
    for skill in fits:
        _dot(axes, len(labels), skill, BLACK, "D")
        labels.append(f"fit: {FITS[skill.name]}")
    axes.axhline(len(labels) - 0.5, color=GREY, lw=0.8)
    for skill in ranked:
        _dot(axes, len(labels), skill, _COLOURS[MEASURES[skill.name].kind], "o")
        labels.append(MEASURES[skill.name].label)
    axes.axvline(0.5, color=BLACK, lw=0.8, ls=(0, (4, 3)))
    axes.set_yticks(range(len(labels)), labels)
    axes.set_ylim(-0.6, len(labels) - 0.4)
    axes.set_xlabel("ROC area against survival, all shakes")


def _dot(axes: Axes, row: int, skill: Skill, colour: str, marker: str) -> None:
    area = skill.pooled
    axes.plot([area.low, area.high], [row, row], color=colour, lw=1.4, solid_capstyle="butt")
    axes.plot([area.value], [row], marker, color=colour, ms=5)


def _rates(axes: Axes, analysis: Analysis) -> None:
    for k, (method, label) in enumerate(LABELS.items()):
        mine = [rate for rate in analysis.rates if rate.method == method]
        if not mine:
            continue
        # side by side where efforts are equal
        effort = [rate.effort + _ASIDE * (k - 0.5 * len(LABELS)) for rate in mine]
        held = [rate.held.value for rate in mine]
        low = [rate.held.value - rate.held.low for rate in mine]
        high = [rate.held.high - rate.held.value for rate in mine]
        axes.errorbar(
            effort,
            held,
            yerr=[low, high],
            color=CYCLE[k],
            marker=_MARKERS[k],
            ms=5,
            lw=1.4,
            elinewidth=0.8,
            capsize=2,
            label=label,
        )
    axes.set_ylim(0.0, 1.0)
    axes.set_xlim(left=0.0)
    axes.set(xlabel="effort, N (median sum of normal forces)", ylabel="share held")
    axes.legend(loc="upper left", fontsize=8)
