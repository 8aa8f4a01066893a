"""Reproduce every number, table and figure of the paper, and write a page with a verdict on each.

Examples:
    python scripts/reproduce_paper.py --json runs/paper.json
    python scripts/reproduce_paper.py --from-json runs/paper.json
"""

import os
from dataclasses import dataclass
from pathlib import Path

from scripts._cli import ResultFiles, command_line, run_cli, write_study


@dataclass(frozen=True)
class ReproduceSettings(ResultFiles):
    """Reproduce every number, table and figure of the paper, and write a page."""

    page: Path = Path("docs/paper.md")
    """The page; its pictures are written beside it."""
    grasps: int = 50
    """Real grasp problems on which the formulations must agree."""
    objects: int = 30
    """Held-out objects on which contacts are synthesised."""
    seed: int = 0
    """Seed of everything."""
    workers: int = os.cpu_count() or 1
    """Processes."""


def main(settings: ReproduceSettings) -> None:
    """Reproduce, draw, write."""
    from training.studies.paper.report import PaperStudy, write_page
    from training.studies.paper.reproduction import ReproductionPlan, reproduce

    plan = ReproductionPlan(settings.grasps, settings.objects, settings.seed)
    names = ("grasps", "objects", "seed")
    write_study(
        settings,
        PaperStudy,
        lambda bars: PaperStudy.of(reproduce(plan, workers=settings.workers, progress=bars)),
        write_page,
        command_line("reproduce_paper", settings, *names, always=names),
    )


if __name__ == "__main__":
    run_cli(ReproduceSettings, main)
