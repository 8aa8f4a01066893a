"""Train small variants of the conditioned network, compare them, and write docs/network.md.

Examples:
    python scripts/ablate.py --grasps train.npz --held-out test.npz --output runs/ablation
    python scripts/ablate.py --from-json runs/ablation.json
"""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from scripts._cli import ResultFiles, command_line, run_cli, write_study

if TYPE_CHECKING:
    from rich.progress import Progress

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
    from training.networks.settings import TrainingError
    from training.studies.ablation.page import write_page
    from training.studies.ablation.run import AblationPlan, run_ablation
    from training.studies.ablation.stages import AblationStudy, shipped_stages

    numbers = ("steps", "batch", "repeats", "seed")

    def measured(progress: "Progress") -> "AblationStudy":
        if settings.grasps is None:
            raise TrainingError("no grasps to train on: name a table with --grasps")
        values = [getattr(settings, name) for name in numbers]
        plan = AblationPlan(settings.grasps, settings.output, *values)
        stages = shipped_stages(plan, settings.held_out, progress=progress)
        return AblationStudy(run_ablation(plan, progress=progress), stages)

    command = command_line("ablate", settings, "grasps", "held_out") + " --output runs/ablation"
    command += "".join(f" --{name} {getattr(settings, name)}" for name in numbers)
    write_study(settings, AblationStudy, measured, write_page, command)


if __name__ == "__main__":
    run_cli(AblateSettings, main)
