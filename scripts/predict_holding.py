"""Ask whether static measures of forces predict holding, and write the page about it.

Examples:
    python scripts/predict_holding.py --grasps 200 --seed 0 --page docs/holding.md
    python scripts/predict_holding.py --from-json runs/holding.json --page docs/holding.md
"""

import os
from dataclasses import dataclass
from pathlib import Path

from scripts._cli import expect_file, run_cli, write_json


@dataclass(frozen=True)
class PredictHoldingSettings:
    """Ask whether static measures of forces predict holding, and write the page about it."""

    objects: str = "random_urdfs"
    """`random_urdfs`, or a folder of meshes."""
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
    from_json: Path | None = None
    """Draw the page anew from what --json wrote; nothing is simulated."""
    json: Path | None = None
    """Write every shake here, with its measures."""


def main(settings: PredictHoldingSettings) -> None:
    """Shake or read, analyse, write, say where."""
    from rich.console import Console
    from rich.progress import MofNCompleteColumn, Progress, TimeElapsedColumn

    from gfo_env.objects import RANDOM_URDFS, ObjectSet
    from training.studies.holding.survival.page import summary, write_page
    from training.studies.holding.survival.study import SurvivalPlan, load_study, make_study

    expect_file(settings.page)
    console = Console()
    if settings.from_json is not None:
        study = load_study(settings.from_json)
    else:
        split = settings.split or ("test" if settings.objects == RANDOM_URDFS else "all")
        plan = SurvivalPlan(ObjectSet(settings.objects, split), settings.grasps, settings.seed)
        with Progress(
            *Progress.get_default_columns()[:2],
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            console=console,
        ) as progress:
            study = make_study(plan, workers=settings.workers, progress=progress)
    write_json(settings.json, study.to_json())
    analysis = write_page(study, settings.page)
    console.print(summary(study, analysis), markup=False, highlight=False)
    console.print(f"Page: {settings.page}")


if __name__ == "__main__":
    run_cli(PredictHoldingSettings, main)
