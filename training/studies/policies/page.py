"""The page about policies: tables of the rows, and learning curves beside them."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

matplotlib.use("Agg")
from matplotlib import pyplot as plt

from training.reports.aggregate import curve_band
from training.reports.intervals import Interval
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

_LIMITATIONS = """## How to read it

Every policy plays the same episodes: the same grasps under the same loads. *Held* is the share of
episodes that end in success, *return* the sum of an episode's rewards, *effort* the mean 2-norm of
the commanded forces. Where a row stands for several runs, which differ in their seed alone, it is
the interquartile mean over runs. Brackets hold 95 % bootstrap intervals over objects, and over runs
where there are several. *Minutes* is the mean time of a run on one core, which others shared, with
its evaluations. Agents are judged by their last model, not by their best. A name with a
number, as in `dual_newton+2`, is a solver with that many newtons of preload more than the problem
asks for: what effort alone buys; a solver of `max_quality` answers several efforts, and the one
that the reward pays most for is commanded. Learning curves are of the evaluations during training,
on other and fewer episodes; each is shifted as a whole to end at the return of the table. Agents
that were trained with other weights of the reward (`reward_weights`) than those of the tables have
none, because their returns do not compare.
"""

_QUALITY = """*q_lrw* is the mean lowest resisted wrench of the commanded normal forces, as the
environment estimates it; a weight of the reward pays for it here.
"""

_GAIN = """*Gain* is the return less that of `{against}` on the same episodes, paired one by one,
so that what episodes give to both is no part of its interval.
"""


def write_page(
    rows: list[Row], runs: tuple[Path, ...], path: Path, *, command: str, title: str = "Policies"
) -> None:
    """Write the page, and the learning curves as a picture of the same name beside it.

    Args:
        rows: of `training.rl.evaluation.evaluate_policies`, of one or several environments.
        runs: folders whose learning curves are drawn; no picture without any.
        path: of the page (.md).
        command: that made the rows.
        title: of the page.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    parts = [f"# {title}\n", f"Made by `{command}`.\n"]
    tables: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        name = " ".join([row["env"], *row["env_kwargs"]])
        tables.setdefault((name, row["split"]), []).append(row)
    for (env, split), chosen in tables.items():
        first = chosen[0]
        heading = _SPLITS.get(split, split)
        counts = f"{first['episodes']} episodes, {first['objects']} objects"
        parts += [f"## {heading}: `{env}`\n", f"{counts}.\n", markdown_table(chosen)]
    if runs:
        picture = path.with_suffix(".png")
        draw_curves(runs, rows, picture)
        what = "q_lrw" if _pay_for_quality(rows) else "share held"
        alternative = f"Return against steps, and {what} against effort"
        parts += ["## Learning curves and effort\n", f"![{alternative}]({picture.name})\n"]
        parts += ["## How the agents were trained\n", _training(runs)]
    parts.append(_LIMITATIONS)
    if any("q_lrw" in shown_metrics(chosen) for chosen in tables.values()):
        parts.append(_QUALITY)
    if rows and "against" in rows[0]:
        parts.append(_GAIN.format(against=rows[0]["against"]))
    path.write_text("\n".join(parts))


def _training(runs: tuple[Path, ...]) -> str:
    """The command of the first run of each configuration, and the seeds of all."""
    lines = ["```sh"]
    for name, folders in run_groups(runs).items():
        settings = [RlSettings.load(folder) for folder in folders]
        seeds = ", ".join(str(one.seed) for one in settings)
        lines += [f"# {name}; seeds {seeds}", settings[0].command()]
    return "\n".join([*lines, "```\n"])


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
    return table(headings, lines) + "\n"


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


def draw_curves(runs: tuple[Path, ...], rows: list[Row], path: Path) -> None:
    """Two panels an environment, held-out objects: return against steps, and against effort.

    Against effort it is the share held, or q_lrw where the reward pays for that.

    Args:
        runs: folders of runs; those of one configuration are one curve with a band.
        rows: their rows, and those of policies without training, which are horizontal lines.
        path: of the picture.
    """
    envs = list(dict.fromkeys(RlSettings.load(run).env for run in runs))
    figure, panels = plt.subplots(
        len(envs), 2, figsize=(10.0, 3.8 * len(envs)), layout="constrained", squeeze=False
    )
    for (left, right), env in zip(panels, envs, strict=True):
        chosen = tuple(run for run in runs if RlSettings.load(run).env == env)
        held_out = [row for row in rows if row["env"] == env and row["split"] == "test"]
        _draw_learning(left, chosen, held_out)
        _draw_effort(right, held_out)
        figure.align_ylabels([left, right])
        left.set_title(env, fontsize=9)
        for axes in (left, right):
            axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _draw_learning(axes: Any, runs: tuple[Path, ...], rows: list[Row]) -> None:
    """The curves of one environment's runs; names at the right end of the lines."""
    ends = []
    for colour, (name, folders) in zip(_colours(), run_groups(runs).items(), strict=False):
        weights = _weights(RlSettings.load(folders[0]).env_kwargs)
        if any(weights != _weights(row["env_kwargs"]) for row in rows):
            continue
        curves = [learning_curve(folder) for folder in folders]
        shared = min(len(steps) for steps, _ in curves)
        steps = curves[0][0][:shared]
        middle, low, high = curve_band(np.stack([values[:shared] for _, values in curves]))
        # other episodes are easier or harder for all
        shift = next((row["reward"] for row in rows if row["policy"] == name), middle[-1])
        middle, low, high = (values + shift - middle[-1] for values in (middle, low, high))
        axes.plot(steps, middle, color=colour)
        axes.fill_between(steps, low, high, color=colour, alpha=0.2, linewidth=0)
        ends.append((float(middle[-1]), f"{name} ({len(folders)} runs)", colour))
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
    colours: list[str] = plt.rcParams["axes.prop_cycle"].by_key()["color"]
    return colours
