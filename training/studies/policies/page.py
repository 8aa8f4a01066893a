"""The page about policies: tables of the rows, and learning curves beside them."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import matplotlib
import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from training.reports import pages
from training.reports.aggregate import curve_band
from training.reports.intervals import Interval
from training.reports.results import Run
from training.reports.tables import table
from training.rl.evaluation import GAIN, METRICS, Row
from training.rl.runs import learning_curve, run_groups
from training.rl.settings import RlSettings, key_values

_FORMS = {
    "hold_rate": ".3f", "reward": ".3f", GAIN: "+.3f", "effort": ".1f", "q_lrw": ".2f",
}  # fmt: skip
_HEADINGS = {"hold_rate": "held", "reward": "return", "effort": "effort, N", "q_lrw": "q_lrw, N"}
_SPLITS = {"test": "Held-out objects", "train": "Objects of the training"}

_MARKERS = "s^vD<>P"


@dataclass(frozen=True)
class Configuration:
    """Runs that differ in their seeds alone.

    Args:
        name: as in the rows.
        env: that they were trained in.
        env_kwargs: its arguments.
        seeds: of the runs.
        command: of the first.
        curves: of each run, steps and mean returns on held-out objects.
    """

    name: str
    env: str
    env_kwargs: tuple[str, ...]
    seeds: tuple[int, ...]
    command: str
    curves: tuple[tuple[tuple[int, ...], tuple[float, ...]], ...]

    @classmethod
    def of(cls, name: str, folders: Sequence[Path]) -> Self:
        """From the folders of the runs."""
        settings = [RlSettings.load(folder) for folder in folders]
        first = settings[0]
        seeds = tuple(one.seed for one in settings)
        curves = [learning_curve(folder) for folder in folders]
        plain = tuple((tuple(steps.tolist()), tuple(values.tolist())) for steps, values in curves)
        return cls(name, first.env, tuple(first.env_kwargs), seeds, first.command(), plain)


@dataclass(frozen=True)
class PolicyStudy:
    """Everything that the page is made of.

    Args:
        rows: of `training.rl.evaluation.evaluate_policies`, of one or several environments.
        configurations: of the agents; no picture without any.
    """

    rows: list[Row]
    configurations: tuple[Configuration, ...]

    @classmethod
    def of(cls, rows: list[Row], runs: Sequence[Path]) -> Self:
        """With the runs whose agents are among the policies."""
        trained = {run: RlSettings.load(run).env for run in runs}
        groups = [
            item
            for env in dict.fromkeys(trained.values())
            for item in run_groups([run for run in runs if trained[run] == env]).items()
        ]
        return cls(rows, tuple(Configuration.of(name, folders) for name, folders in groups))


def write_page(run: Run[PolicyStudy], path: Path) -> str:
    """Write the page, and the learning curves as a picture of the same name beside it.

    Args:
        run: what it is about.
        path: of the page (.md).
    """
    study = run.results
    tables: dict[tuple[str, str], list[Row]] = {}
    for row in study.rows:
        name = " ".join([row["env"], *row["env_kwargs"]])
        tables.setdefault((name, row["split"]), []).append(row)
    shown = [
        rows[0] | {"env": env, "heading": _SPLITS.get(split, split), "table": markdown_table(rows)}
        for (env, split), rows in tables.items()
    ]
    fields = {
        "command": run.command,
        "tables": shown,
        "configurations": study.configurations,
        "pays_for_quality": _pay_for_quality(study.rows),
        "tells_quality": any("q_lrw" in shown_metrics(rows) for rows in tables.values()),
        "against": study.rows[0].get("against") if study.rows else None,
    }
    figures = {"": curves_figure(study)} if study.configurations else {}
    pages.write_page(path, __package__, fields, figures)
    return f"{len(study.rows)} rows"


def markdown_table(rows: list[Row]) -> str:
    """The rows as a Markdown table."""
    headings = ["policy", "runs", "training steps", "minutes"]
    metrics = shown_metrics(rows)
    gain = {GAIN: f"gain over {rows[0].get('against')}"}
    headings += [(_HEADINGS | gain)[metric] for metric in metrics]
    lines = []
    for row in rows:
        steps = row.get("training_steps")
        cells = [row["policy"], "", "", ""]
        if steps:
            cells[1:] = [str(row["runs"]), f"{steps:,}", f"{row['training_minutes']:.0f}"]
        cells += [interval_text(row, metric) for metric in metrics]
        lines.append(cells)
    return table(headings, lines)


def shown_metrics(rows: list[Row]) -> tuple[str, ...]:
    """What tables tell of rows of one environment: of q_lrw, if a weight of the reward names it."""
    shown = [one for one in METRICS if one != "q_lrw" or _pay_for_quality(rows)]
    if GAIN in rows[0]:
        shown.insert(shown.index("reward") + 1, GAIN)
    return tuple(shown)


def interval_text(row: Row, metric: str) -> str:
    """A metric of a row with its interval in brackets; a dash where it was not measured."""
    value, interval = row[metric], row[f"{metric}_ci"]
    if value is None:
        return "-"
    return format(Interval(value, *interval), _FORMS[metric])


@rc_context(matplotlib.rcParamsDefault)
def curves_figure(study: PolicyStudy) -> Figure:
    """Two panels an environment, held-out objects: return against steps, and against effort.

    Against effort it is the share held, or q_lrw where the reward pays for that. Runs of one
    configuration are one curve with a band, policies without training horizontal lines.
    """
    envs = list(dict.fromkeys(each.env for each in study.configurations))
    figure = Figure(figsize=(10.0, 3.8 * len(envs)), layout="constrained")
    panels = figure.subplots(len(envs), 2, squeeze=False)
    for (left, right), env in zip(panels, envs, strict=True):
        chosen = [each for each in study.configurations if each.env == env]
        held_out = [row for row in study.rows if row["env"] == env and row["split"] == "test"]
        _draw_learning(left, chosen, held_out)
        _draw_effort(right, held_out)
        figure.align_ylabels([left, right])
        left.set_title(env, fontsize=9)
        for axes in (left, right):
            axes.spines[["top", "right"]].set_visible(False)
    return figure


def _draw_learning(axes: Any, configurations: list[Configuration], rows: list[Row]) -> None:
    """The curves of one environment's runs; names at the right end of the lines."""
    ends = []
    for colour, each in zip(_colours(), configurations, strict=False):
        weights = _weights(each.env_kwargs)
        if any(weights != _weights(row["env_kwargs"]) for row in rows):
            continue
        shared = min(len(steps) for steps, _ in each.curves)
        steps = np.array(each.curves[0][0][:shared])
        middle, low, high = curve_band(np.array([values[:shared] for _, values in each.curves]))
        # other episodes are easier or harder for all
        shift = next((row["reward"] for row in rows if row["policy"] == each.name), middle[-1])
        middle, low, high = (values + shift - middle[-1] for values in (middle, low, high))
        axes.plot(steps, middle, color=colour)
        axes.fill_between(steps, low, high, color=colour, alpha=0.2, linewidth=0)
        ends.append((float(middle[-1]), f"{each.name} ({len(each.curves)} runs)", colour))
    for row in rows:
        if "training_steps" not in row:
            axes.axhline(row["reward"], color="0.6", linewidth=0.9, linestyle="--")
            ends.append((row["reward"], row["policy"], "0.35"))
    _name_ends(axes, ends)
    axes.locator_params(axis="x", nbins=5)
    axes.set_xlabel("steps of the environment")
    axes.set_ylabel("mean return on held-out objects")


def _name_ends(axes: Any, ends: list[tuple[float, str, str]]) -> None:
    """Names right of the panel, at the heights of their lines or as near as they do not overlap."""
    low, high = axes.get_ylim()
    least = 0.06 * (high - low)
    ends = sorted(ends)
    heights = [height for height, *_ in ends]
    for k in range(1, len(heights)):
        heights[k] = max(heights[k], heights[k - 1] + least)
    for k in reversed(range(len(heights))):
        heights[k] = min(heights[k], high - (len(heights) - 1 - k) * least)
    for at, (height, name, colour) in zip(heights, ends, strict=True):
        place = {"xytext": (1.02, at), "textcoords": axes.get_yaxis_transform()}
        axes.annotate(
            name, (1.0, height), xycoords=axes.get_yaxis_transform(), **place,
            fontsize=7, color=colour, va="center", annotation_clip=False,
            arrowprops={"arrowstyle": "-", "color": "0.8", "linewidth": 0.5, "relpos": (0, 0.5)},
        )  # fmt: skip


def _draw_effort(axes: Any, rows: list[Row]) -> None:
    """What a policy holds, or resists, at what effort; a solver with more preload is one line."""
    metric = "q_lrw" if _pay_for_quality(rows) else "hold_rate"
    colours = iter(_colours())
    families: dict[str, list[Row]] = {}
    for row in rows:
        if row["effort"] is not None:
            families.setdefault(row["policy"].partition("+")[0], []).append(row)
    for name, members in families.items():
        trained = "training_steps" in members[0]
        members = sorted(members, key=lambda row: row["effort"])
        reached = np.array([row[metric] for row in members])
        interval = np.array([row[f"{metric}_ci"] for row in members]).T
        axes.errorbar(
            [row["effort"] for row in members], reached, np.abs(interval - reached),
            color=next(colours) if trained else "0.35", label=name, linewidth=0.9,
            marker="o" if trained else _MARKERS[list(families).index(name) % len(_MARKERS)],
            markersize=5, capsize=2,
        )  # fmt: skip
    axes.set_xlabel("effort, N")
    if metric == "hold_rate":
        axes.set_ylabel("held, share of episodes")
        axes.set_ylim(-0.02, 1.0)
    else:
        axes.set_ylabel("q_lrw, N")
    axes.legend(fontsize=7, frameon=False, loc="lower right")


def _weights(env_kwargs: Sequence[str]) -> dict[str, Any]:
    """Weights of the reward that arguments of an environment name."""
    return key_values(env_kwargs).get("reward_weights") or {}


def _pay_for_quality(rows: list[Row]) -> bool:
    """Whether rewards have a weight of q_lrw that is not the default one."""
    return any("q_lrw" in _weights(row["env_kwargs"]) for row in rows)


def _colours() -> list[str]:
    return matplotlib.rcParams["axes.prop_cycle"].by_key()["color"]
