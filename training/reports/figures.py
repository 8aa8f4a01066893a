"""Style, colours and saving of every figure, and those of the paper: arrays in, a figure out.

Figures are made and saved without pyplot, so there is no state between them and no display.
Colours are those of Okabe and Ito, Color Universal Design (2008), which the colour-blind can tell
apart; where lines share a colour they differ in their dashes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from PIL import Image

from solvers.arrays import Array

BLACK = "#000000"
ORANGE = "#E69F00"
SKY = "#56B4E9"
GREEN = "#009E73"
BLUE = "#0072B2"
VERMILION = "#D55E00"
PURPLE = "#CC79A7"
GREY = "#8C8C8C"
CYCLE = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BLACK)

DPI = 110
COLOURS = 256
"""Palette of a saved picture."""

STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 10,
    "axes.titlesize": 11,
    "axes.labelsize": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.8,
    "axes.grid": True,
    "grid.color": "#E4E4E4",
    "grid.linewidth": 0.7,
    "axes.axisbelow": True,
    "legend.frameon": False,
    "legend.fontsize": 9,
    "xtick.labelsize": 9,
    "ytick.labelsize": 9,
    "figure.facecolor": "white",
    "figure.constrained_layout.h_pad": 0.07,
    "figure.constrained_layout.w_pad": 0.07,
}
_DASHES = ("solid", (0, (5, 1.5)), (0, (1.2, 1.2)))
_SYMBOLS: tuple[dict[str, Any], ...] = (
    {"color": VERMILION, "marker": "o", "ms": 6.5, "mec": "white", "mew": 0.6},
    {"color": BLUE, "marker": "o", "ms": 10, "mfc": "none", "mew": 1.5},
    {"color": GREEN, "marker": "x", "ms": 8, "mew": 1.8},
)
INK = "#333333"
_NEARLY_WHITE = 250


@dataclass(frozen=True, eq=False)
class Mark:
    """A point that is put on a path of `path_figure`.

    Args:
        label: for the legend.
        time: where on the path.
        point: (m,) its coordinates.
        value: of the constraint there.
    """

    label: str
    time: float
    point: Array
    value: float


@rc_context(STYLE)
def loss_figure(losses: dict[str, Array], title: str = "") -> Figure:
    """Loss against iteration, on a logarithmic axis (the paper's Figs. 1 and 3).

    Args:
        losses: by name, (iterations,) each; the first is that of iteration 1.
        title: of the figure.
    """
    figure = new_figure(5.6, 3.5)
    axes = figure.add_subplot()
    for (name, loss), colour in zip(losses.items(), _cycle(len(losses)), strict=True):
        axes.semilogy(np.arange(1, len(loss) + 1), loss, color=colour, lw=1.3, label=name)
    axes.set_xlim(1, max(len(loss) for loss in losses.values()))
    axes.set(xlabel="iteration", ylabel="loss $E(w)$", title=title)
    if len(losses) > 1:
        axes.legend()
    return figure


@rc_context(STYLE)
def residual_figure(times: Array, residuals: Array, errors: Array | None = None) -> Figure:
    """How far the paper's ODE is from a KKT point, over its time: all grasps, and their median.

    Args:
        times: (T,) of the ODE, which has no unit; times of 0 are not drawn.
        residuals: (T, B) size of the ODE's right-hand side.
        errors: (T, B) relative distance from the optimum, or None for no such panel.
    """
    panels = [(residuals, "residual of the KKT conditions")]
    if errors is not None:
        panels.append((errors, "distance from the exact forces, relative"))
    figure = new_figure(4.6 * len(panels) + 0.4, 3.6)
    shown = times > 0
    for column, (values, label) in enumerate(panels):
        axes = figure.add_subplot(1, len(panels), column + 1)
        positive = np.where(values > 0, values, np.nan)[shown]
        axes.loglog(times[shown], positive, color=GREY, lw=0.6, alpha=0.35)
        middle = np.median(values, axis=1)[shown]
        axes.loglog(times[shown], np.where(middle > 0, middle, np.nan), color=BLUE, lw=2.4)
        axes.set_xlim(times[shown][0], times[shown][-1])
        axes.set(xlabel="time $t$ of the ODE", ylabel=label)
        if column == 0:
            handles = [Line2D([], [], color=GREY, lw=0.9), Line2D([], [], color=BLUE, lw=2.4)]
            axes.legend(handles, [f"each of {values.shape[1]} grasps", "median"])
    return figure


@rc_context(STYLE)
def path_figure(
    times: Array,
    path: Array,
    values: Array,
    marks: Sequence[Mark] = (),
    *,
    names: Sequence[str] | None = None,
) -> Figure:
    """The paper's ODE on its unbounded LP: to the wall, and along it, with points put on the path.

    Args:
        times: (T,) of the ODE.
        path: (T, m) the coordinates x.
        values: (T,) the constraint's value, >= 0 where x is allowed.
        marks: at most three points; each is shown at its time, and coordinate by coordinate.
        names: (m,) of the coordinates, in mathtext; x_1 to x_m if None. More than seven share
            colours by threes, as the joints of a finger do.
    """
    count = path.shape[1]
    names = names or [f"$x_{{{i + 1}}}$" for i in range(count)]
    figure = new_figure(9.4, 4.8)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.25, 1.0), height_ratios=(1.4, 1.0))
    coordinates = figure.add_subplot(grid[0, 0])
    constraint = figure.add_subplot(grid[1, 0], sharex=coordinates)
    comparison = figure.add_subplot(grid[:, 1])

    by_threes = count > len(CYCLE)
    for i in range(count):
        colour = CYCLE[i // 3 if by_threes else i]
        dashes = _DASHES[i % 3] if by_threes else "solid"
        coordinates.plot(times, path[:, i], color=colour, ls=dashes, lw=1.3, label=names[i])
    coordinates.legend(ncol=3 if by_threes else 2, columnspacing=1.0)
    coordinates.tick_params(labelbottom=False)
    coordinates.set(ylabel="coordinates of $x(t)$")

    constraint.plot(times, values, color=INK, lw=1.6)
    bottom = min(float(np.min(values)), -0.2 * float(np.max(values)))
    constraint.axhspan(bottom, 0, color=ORANGE, alpha=0.18, lw=0)
    constraint.text(times[0], bottom / 2, "  not allowed", color=INK, fontsize=9, va="center")
    constraint.set(ylim=(bottom, None), xlim=(times[0], times[-1]))
    constraint.set(xlabel="time $t$ of the ODE", ylabel="constraint")
    figure.align_ylabels([coordinates, constraint])

    places = np.arange(count)
    for mark, symbol in zip(marks, _SYMBOLS[: len(marks)], strict=True):
        on_path = [float(np.interp(mark.time, times, path[:, i])) for i in range(count)]
        for axes in (coordinates, constraint):
            axes.axvline(mark.time, color=symbol["color"], lw=1.0, ls=(0, (3, 2)), zorder=1)
        constraint.plot(mark.time, mark.value, ls="none", clip_on=False, zorder=5, **symbol)
        comparison.plot(places, mark.point, ls="none", zorder=5, label=mark.label, **symbol)
        comparison.hlines(
            on_path,
            places - 0.4,
            places + 0.4,
            color=symbol["color"],
            lw=1.6,
            label=f"$x(t)$ at $t$ = {mark.time:.1f}",
        )
    comparison.axhline(0, color=INK, lw=0.6)
    comparison.set_xticks(places, names)
    comparison.grid(axis="x", visible=False)
    comparison.set(xlabel="coordinate", ylabel="value", xlim=(-0.7, count - 0.3))
    if marks:
        comparison.legend(loc="upper right")
    return figure


@rc_context(STYLE)
def synthesis_figure(before: Array, after: Array, solved: NDArray[np.bool_]) -> Figure:
    """What moving the contacts does to q_lrw: after against before, and the gain of each grasp.

    Args:
        before: (B,) q_lrw of the grasps as acquired, with normal forces of 1.
        after: (B,) q_lrw after their contacts were moved.
        solved: (B,) which of them the synthesis succeeded on; the others are drawn hollow and
            count as unchanged among the gains.
    """
    figure = new_figure(8.2, 3.8)
    left, right = figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2)
    top = 1.05 * float(max(before.max(), after.max()))
    left.plot([0, top], [0, top], color=GREY, lw=1.0, ls=(0, (4, 2)), label="no change")
    left.scatter(before[solved], after[solved], s=20, c=BLUE, alpha=0.75, lw=0, label="solved")
    if not solved.all():
        failed = ~solved
        left.scatter(
            before[failed], after[failed], s=20, fc="none", ec=VERMILION, lw=1.0, label="unsolved"
        )
    left.set_aspect("equal")
    left.set(xlim=(0, top), ylim=(0, top))
    left.set(xlabel="$q_{lrw}$ of the acquired grasp", ylabel="$q_{lrw}$ after moving contacts")
    left.legend(loc="lower right")

    closed = before > 0
    if not closed.any():
        right.set_axis_off()
        right.text(0.5, 0.5, "no grasp was in force closure before", ha="center", color=INK)
        return figure
    gain = np.where(solved, after - before, 0.0)[closed] / before[closed]
    gain = 100 * np.sort(gain)[::-1]
    right.fill_between(np.arange(1, len(gain) + 1), gain, step="mid", color=SKY, alpha=0.55, lw=0)
    right.step(np.arange(1, len(gain) + 1), gain, where="mid", color=BLUE, lw=1.4)
    middle = float(np.median(gain))
    right.axhline(middle, color=VERMILION, lw=1.2, ls=(0, (4, 2)))
    right.text(
        len(gain), middle, f"median {middle:+.0f} %", color=VERMILION, ha="right", va="bottom"
    )
    right.axhline(0, color=INK, lw=0.8)
    right.set_xlim(0.5, len(gain) + 0.5)
    right.xaxis.set_major_locator(MaxNLocator(integer=True))
    if gain[0] > 20 * max(middle, 1.0):
        right.set_yscale("symlog", linthresh=100)
    if gain[-1] >= 0:
        right.set_ylim(bottom=0)
    right.set(xlabel="grasps, best first", ylabel="gain of $q_{lrw}$ [%]")
    if not closed.all():
        left_out = int(np.sum(~closed))
        right.set_title(f"{left_out} without closure before left out", fontsize=9, color=INK)
    return figure


def save(figure: Figure, path: Path, *, dpi: int = DPI) -> None:
    """Write a PNG with a palette and no metadata: small, and the same bytes for the same data.

    Args:
        figure: to write.
        path: of the file.
        dpi: pixels per inch.
    """
    with rc_context(STYLE):
        figure.set_dpi(dpi)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    few = picture.quantize(COLOURS, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    palette = np.array(few.getpalette() or [], dtype=np.int64).reshape(-1, 3)
    # the method rounds white to a grey, which would show on a white page
    palette[(palette >= _NEARLY_WHITE).all(axis=1)] = 255
    few.putpalette(palette.ravel().tolist())
    few.save(path, format="PNG", optimize=True)


def new_figure(width: float, height: float) -> Figure:
    """An empty figure of a size in inches."""
    figure = Figure(figsize=(width, height), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _cycle(count: int) -> list[str]:
    return [CYCLE[i % len(CYCLE)] for i in range(count)]
