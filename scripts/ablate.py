"""Train small variants of the conditioned network, compare them, and write docs/network.md.

Examples:
    python scripts/ablate.py --grasps train.npz --held-out test.npz --output runs/ablation
    python scripts/ablate.py --from-json runs/ablation.json
"""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from scripts._cli import ResultFiles, run_cli, write_study

if TYPE_CHECKING:
    from rich.progress import Progress

    from training.reports.results import Run
    from training.studies.ablation.stages import AblationStudy


@dataclass(frozen=True)
class AblateSettings(ResultFiles):
    """Train small variants of the conditioned network and compare them; goes on after a stop."""

    grasps: Path | None = None
    """Table of grasps (.npz) from scripts/collect.py; needed unless --from-json is given."""
    output: Path = Path("runs/ablation")
    """Folder for the runs; those that are there are not done again."""
    page: Path = Path("docs/network.md")
    """The page to write; its picture is written beside it."""
    held_out: Path | None = None
    """Table of grasps of other objects, to measure the shipped weights on."""
    steps: int = 200
    """Gradient steps of each training."""
    batch: int = 256
    """Problems in a batch."""
    repeats: int = 2
    """Trainings of the default variant: their differences are chance."""
    seed: int = 0
    """Seed of everything."""


def main(settings: AblateSettings) -> None:
    """Train, measure, write."""
    from training.measuring.machine import machine
    from training.networks.settings import TrainingError
    from training.reports.results import Run
    from training.studies.ablation.page import write_page
    from training.studies.ablation.run import AblationPlan, run_ablation
    from training.studies.ablation.stages import AblationStudy, shipped_stages

    def measured(progress: "Progress") -> "Run[AblationStudy]":
        if settings.grasps is None:
            raise TrainingError("no grasps to train on: name a table with --grasps")
        plan = AblationPlan(
            settings.grasps,
            settings.output,
            settings.steps,
            settings.batch,
            settings.repeats,
            settings.seed,
        )
        stages = shipped_stages(plan, settings.held_out, progress=progress)
        study = AblationStudy(run_ablation(plan, progress=progress), stages)
        command = f"python scripts/ablate.py {plan.arguments(settings.held_out)}"
        return Run(command, machine(), study)

    write_study(settings, AblationStudy, measured, write_page)


if __name__ == "__main__":
    run_cli(AblateSettings, main)
