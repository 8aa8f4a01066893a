"""Measure every solver, and its peers, on grasps of held-out objects, and write a report.

Example: python scripts/benchmark.py --output docs/benchmark.md --seed 0
"""

import os
from dataclasses import dataclass
from pathlib import Path

from scripts._cli import expect_file, run_cli, write_json


@dataclass(frozen=True)
class BenchmarkSettings:
    """Measure every solver, and its peers, on grasps of held-out objects, and write a report."""

    output: Path = Path("docs/benchmark.md")
    """The report; its pictures are written beside it."""
    grasps: int = 512
    """Problems of the mix; all other counts follow from it."""
    table: Path | None = None
    """Grasps of held-out objects, from scripts/collect.py. Default: collected first."""
    train_table: Path | None = None
    """Grasps of training objects, for the network's ratio. Default: collected first."""
    seed: int = 0
    """Seed of everything that is drawn."""
    workers: int = os.cpu_count() or 1
    """Processes that collect grasps; nothing else uses them."""
    json: Path | None = None
    """Write every figure here, a row each."""


def main(settings: BenchmarkSettings) -> None:
    """Measure, write, say where."""
    from rich.console import Console
    from rich.progress import MofNCompleteColumn, Progress, TimeElapsedColumn

    from training.studies.benchmark.report import write_report
    from training.studies.benchmark.rows import rows
    from training.studies.benchmark.run import BenchmarkPlan, run_benchmark
    from training.studies.benchmark.sentences import summary

    plan = BenchmarkPlan(
        settings.grasps, settings.seed, settings.table, settings.train_table, settings.workers
    )
    expect_file(settings.output)
    console = Console()
    with Progress(
        *Progress.get_default_columns()[:2],
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        console=console,
    ) as progress:
        result = run_benchmark(plan, progress)
    command = f"python scripts/benchmark.py --grasps {plan.grasps} --seed {plan.seed}"
    for option, path in (("--table", plan.table), ("--train-table", plan.train_table)):
        command += f" {option} {path.name}" if path is not None else ""
    write_report(result, settings.output, command)
    write_json(settings.json, rows(result))
    console.print(summary(result), markup=False, highlight=False)
    console.print(f"Report: {settings.output}")


if __name__ == "__main__":
    run_cli(BenchmarkSettings, main)
