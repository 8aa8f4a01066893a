"""The page about policies: tables of the rows, and learning curves beside them."""

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

matplotlib.use("Agg")
from matplotlib import pyplot as plt

from .aggregate import curve_band
from .evaluation import METRICS, Row
from .runs import learning_curve, run_groups
from .settings import RlSettings

_FORMS = {"hold_rate": "{:.3f}", "reward": "{:.3f}", "effort": "{:.1f}"}
_HEADINGS = {"hold_rate": "held", "reward": "return", "effort": "effort, N"}
_SPLITS = {"test": "Held-out objects", "train": "Objects of the training"}

_LIMITATIONS = """## How to read it

Every policy plays the same episodes: the same grasps under the same loads. *Held* is the share of
episodes that end in success, *return* the sum of an episode's rewards, *effort* the mean 2-norm of
the commanded forces. Where a row stands for several runs, which differ in their seed alone, it is
the interquartile mean over runs. Brackets hold 95 % bootstrap intervals over objects, and over runs
where there are several. Agents are judged by their last model, not by their best.
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
        parts += ["## Learning curves\n", f"![Return against steps]({picture.name})\n"]
    parts.append(_LIMITATIONS)
    path.write_text("\n".join(parts))


def markdown_table(rows: list[Row]) -> str:
    """The rows as a Markdown table."""
    headings = ["policy", "runs", "training steps", *(_HEADINGS[metric] for metric in METRICS)]
    lines = ["| " + " | ".join(headings) + " |", "| --- |" + " ---: |" * (len(headings) - 1)]
    for row in rows:
        steps = row.get("training_steps")
        cells = [row["policy"], str(row["runs"]) if steps else "", f"{steps:,}" if steps else ""]
        cells += [interval_text(row, metric) for metric in METRICS]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def interval_text(row: Row, metric: str) -> str:
    """A metric of a row with its interval in brackets; a dash where it was not measured."""
    value, interval = row[metric], row[f"{metric}_ci"]
    if value is None:
        return "-"
    form = _FORMS[metric]
    return f"{form.format(value)} [{form.format(interval[0])}, {form.format(interval[1])}]"


def draw_curves(runs: tuple[Path, ...], rows: list[Row], path: Path) -> None:
    """Mean return on held-out objects against steps, and that of the other policies as lines.

    Args:
        runs: folders of runs; those of one configuration are one curve with a band.
        rows: whose policies without training become horizontal lines.
        path: of the picture.
    """
    envs = list(dict.fromkeys(RlSettings.load(run).env for run in runs))
    figure, panels = plt.subplots(
        1, len(envs), figsize=(2.0 + 4.6 * len(envs), 4.0), layout="constrained", squeeze=False
    )
    for axes, env in zip(panels[0], envs, strict=True):
        chosen = tuple(run for run in runs if RlSettings.load(run).env == env)
        _draw_panel(axes, chosen, [row for row in rows if row["env"] == env])
        axes.set_title(env, fontsize=9)
    figure.savefig(path, dpi=120)
    plt.close(figure)


def _draw_panel(axes: Any, runs: tuple[Path, ...], rows: list[Row]) -> None:
    """The curves of one environment's runs."""
    colours: Any = plt.rcParams["axes.prop_cycle"].by_key()["color"]
    for index, (name, folders) in enumerate(run_groups(runs).items()):
        curves = [learning_curve(folder) for folder in folders]
        shared = min(len(steps) for steps, _ in curves)
        steps = curves[0][0][:shared]
        middle, low, high = curve_band(np.stack([values[:shared] for _, values in curves]))
        colour = colours[index % len(colours)]
        axes.plot(steps, middle, color=colour, label=f"{name} ({len(folders)} runs)")
        axes.fill_between(steps, low, high, color=colour, alpha=0.2, linewidth=0)
    fixed = [row for row in rows if row["split"] == "test" and "training_steps" not in row]
    for style, row in zip(["--", ":", "-."] * len(fixed), fixed, strict=False):
        axes.axhline(
            row["reward"], color="0.5", linewidth=0.9, linestyle=style, label=row["policy"]
        )
    axes.set_xlabel("steps of the environment")
    axes.set_ylabel("mean return on held-out objects")
    axes.legend(fontsize=7, frameon=False, loc="center right")
    axes.spines[["top", "right"]].set_visible(False)
