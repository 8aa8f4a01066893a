"""Train small variants of the conditioned network, compare them, and write docs/network.md.

Example: python scripts/ablate.py --grasps train.npz --held-out test.npz --output runs/ablation
"""

from dataclasses import dataclass
from pathlib import Path

from scripts._cli import expect_file, run_cli, write_json


@dataclass(frozen=True)
class AblateSettings:
    """Train small variants of the conditioned network and compare them; goes on after a stop."""

    grasps: Path
    """Table of grasps (.npz) from scripts/collect.py."""
    output: Path
    """Folder for the runs; those that are there are not done again."""
    document: Path = Path("docs/network.md")
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
    json: Path | None = None
    """Write all measurements here."""


def main(settings: AblateSettings) -> None:
    """Train, measure, write."""
    from rich.console import Console
    from rich.progress import MofNCompleteColumn, Progress, TimeElapsedColumn

    from training.studies.ablation.page import as_json, write_page
    from training.studies.ablation.run import AblationPlan, run_ablation
    from training.studies.ablation.stages import shipped_stages

    expect_file(settings.document)
    plan = AblationPlan(
        settings.grasps,
        settings.output,
        settings.steps,
        settings.batch,
        settings.repeats,
        settings.seed,
    )
    console = Console()
    with Progress(
        *Progress.get_default_columns()[:2],
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        console=console,
    ) as progress:
        stages = shipped_stages(plan, settings.held_out, progress=progress)
        ablation = run_ablation(plan, progress=progress)
    command = f"python scripts/ablate.py {plan.arguments(settings.held_out)}"
    write_page(ablation, stages, settings.document, command)
    write_json(settings.json, as_json(ablation, stages))
    console.print(f"{len(ablation.rows)} variants; page: {settings.document}")


if __name__ == "__main__":
    run_cli(AblateSettings, main)
