"""Ask whether static measures of forces predict holding, and write the page about it.

Examples:
    python scripts/predict_holding.py --grasps 200 --seed 0 --json runs/holding.json
    python scripts/predict_holding.py --from-json runs/holding.json
"""

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from scripts._cli import ObjectOptions, ResultFiles, command_line, run_cli, write_study

if TYPE_CHECKING:
    from rich.progress import Progress

    from training.studies.holding.survival.study import Study


@dataclass(frozen=True)
class PredictHoldingSettings(ResultFiles, ObjectOptions):
    """Ask whether static measures of forces predict holding, and write the page about it."""

    split: str | None = None
    """Split of `random_urdfs`: train, test or all. Default: test; a folder has none."""
    grasps: int = 200
    """How many grasps to acquire."""
    seed: int = 0
    """Seed of acquisition, masses, friction and gravity."""
    workers: int = os.cpu_count() or 1
    """Processes."""
    page: Path = Path("docs/holding.md")
    """The page; its picture is written beside it."""


def main(settings: PredictHoldingSettings) -> None:
    """Shake or read, analyse, write, say where."""
    from gfo_env.objects import RANDOM_URDFS
    from training.studies.holding.survival.page import write_page
    from training.studies.holding.survival.study import Study, SurvivalPlan, make_study

    split = settings.split or ("test" if settings.objects == RANDOM_URDFS else "all")

    def measured(progress: "Progress") -> "Study":
        plan = SurvivalPlan(settings.open(split), settings.grasps, settings.seed)
        return make_study(plan, workers=settings.workers, progress=progress)

    always = ("objects", "split", "grasps", "seed")
    names = ("objects", "pattern", "scale", "target_size", *always[1:])
    command = command_line("predict_holding", replace(settings, split=split), *names, always=always)
    write_study(settings, Study, measured, write_page, command)


if __name__ == "__main__":
    run_cli(PredictHoldingSettings, main)
