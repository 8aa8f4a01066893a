"""Play policies on the same episodes: solvers, heuristics, and agents of scripts/train_rl.py.

Example: python scripts/evaluate_policies.py --runs runs/ppo_0 runs/ppo_1 --episodes 200
"""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from scripts._cli import ResultFiles, bars, run_cli

if TYPE_CHECKING:
    from training.reports.results import Run
    from training.studies.policies.page import PolicyStudy


@dataclass(frozen=True)
class EvaluatePoliciesSettings(ResultFiles):
    """Play policies on the same episodes: the same grasps under the same loads."""

    env: tuple[str, ...] = ("GraspForce-v0",)
    """Registered environments."""
    env_kwargs: tuple[str, ...] = ()
    """Arguments of the environment as key:value, such as push:3.0."""
    policies: tuple[str, ...] = (
        "dual_newton",
        "conditioned",
        "clarabel",
        "equal_squeeze",
        "pseudoinverse",
        "random",
        "reactive",
    )
    """Names of solvers, alone or with newtons of preload more (dual_newton+2); `random`: uniform
    actions; `reactive`: a solver for the load that is felt in the contact forces."""
    runs: tuple[Path, ...] = ()
    """Folders of scripts/train_rl.py, each for the environment it was trained in; seeds of one
    configuration share a row."""
    splits: tuple[str, ...] = ("test",)
    """Splits of the objects: test is held out, train is not."""
    episodes: int = 200
    """Episodes in each split."""
    seed: int = 0
    """Seed of the first episode; each next one adds 1."""
    against: str | None = None
    """One of the policies: rows tell by how much rewards differ from its, episode by episode."""
    workers: int = os.cpu_count() or 1
    """Processes."""
    page: Path | None = None
    """Write a Markdown page with the tables here, and a picture of the learning curves beside."""


def main(settings: EvaluatePoliciesSettings) -> None:
    """Play, print the table, write rows and page."""
    from rich.console import Console
    from rich.table import Table

    from training.reports.results import load_run, save_run
    from training.rl.evaluation import Row
    from training.studies.policies.page import (
        PolicyStudy,
        interval_text,
        shown_metrics,
        write_page,
    )

    run = (
        _play(settings) if settings.from_json is None else load_run(settings.from_json, PolicyStudy)
    )
    if settings.json is not None:
        save_run(run, settings.json)
    if settings.page is not None:
        write_page(run, settings.page)
    rows = run.results.rows
    tables: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        tables.setdefault((row["env"], row["split"]), []).append(row)
    for (env, split), chosen in tables.items():
        first = chosen[0]
        title = f"{env} ({split}): {first['episodes']} episodes, {first['objects']} objects"
        table = Table(title=title, caption="in brackets 95 % intervals over objects and runs")
        table.add_column("policy")
        metrics = shown_metrics(chosen)
        for metric in ("runs", *metrics):
            table.add_column(metric.replace("_", " "), justify="right")
        for row in chosen:
            cells = (interval_text(row, metric) for metric in metrics)
            table.add_row(row["policy"], str(row["runs"]), *cells)
        Console(width=None if os.isatty(1) else 120).print(table)


def _play(settings: EvaluatePoliciesSettings) -> "Run[PolicyStudy]":
    import shlex
    import sys

    from training.measuring.machine import machine
    from training.networks.settings import TrainingError
    from training.reports.results import Run
    from training.rl.evaluation import PolicyPlan, evaluate_policies
    from training.rl.settings import RlSettings
    from training.studies.policies.page import PolicyStudy

    trained_in = {run: RlSettings.load(run).env for run in settings.runs}
    strangers = sorted(set(trained_in.values()) - set(settings.env))
    if strangers:
        raise TrainingError(f"runs were trained in {', '.join(strangers)}: name it with --env")
    rows = []
    with bars() as progress:
        for env in settings.env:
            plan = PolicyPlan(
                env,
                settings.env_kwargs,
                settings.policies,
                tuple(run for run in settings.runs if trained_in[run] == env),
                settings.splits,
                settings.episodes,
                settings.seed,
                settings.against,
            )
            rows += evaluate_policies(plan, workers=settings.workers, progress=progress)
    words = ["python", *sys.argv]
    if "--json" in words:  # where the rows are kept makes no difference
        place = words.index("--json")
        del words[place : place + 2]
    return Run(shlex.join(words), machine(), PolicyStudy.of(rows, settings.runs))


if __name__ == "__main__":
    run_cli(EvaluatePoliciesSettings, main)
