"""Measure every solver, and its peers, on grasps of held-out objects, and write a page.

Examples:
    python scripts/benchmark.py --seed 0
    python scripts/benchmark.py --from-json runs/benchmark.json
"""

import os
from dataclasses import dataclass
from pathlib import Path

from scripts._cli import ResultFiles, command_line, run_cli, write_study


@dataclass(frozen=True)
class BenchmarkSettings(ResultFiles):
    """Measure every solver, and its peers, on grasps of held-out objects, and write a page."""

    page: Path = Path("docs/benchmark.md")
    """The page; its pictures are written beside it."""
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


def main(settings: BenchmarkSettings) -> None:
    """Measure, write, say where."""
    from training.measuring.machine import gpu, machine
    from training.studies.benchmark.report import write_page
    from training.studies.benchmark.run import PACKAGES, Benchmark, BenchmarkPlan, run_benchmark

    plan = BenchmarkPlan(
        settings.grasps, settings.seed, settings.table, settings.train_table, settings.workers
    )
    names = ("grasps", "seed", "table", "train_table")
    write_study(
        settings,
        Benchmark,
        lambda progress: run_benchmark(plan, progress),
        write_page,
        command_line("benchmark", settings, *names, always=("grasps", "seed")),
        lambda: machine(PACKAGES) | {"GPU": gpu()},
    )


if __name__ == "__main__":
    run_cli(BenchmarkSettings, main)
