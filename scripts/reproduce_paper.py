"""Reproduce every number, table and figure of the paper, and write a report with a verdict on each.

Example: python scripts/reproduce_paper.py --output docs/paper.md
"""

import os
from dataclasses import dataclass
from pathlib import Path

from scripts._cli import expect_file, run_cli, write_json


@dataclass(frozen=True)
class ReproduceSettings:
    """Reproduce every number, table and figure of the paper, and write a report."""

    output: Path = Path("docs/paper.md")
    """The report; its figures are written beside it."""
    grasps: int = 50
    """Real grasp problems on which the formulations must agree."""
    objects: int = 30
    """Held-out objects on which contacts are synthesised."""
    seed: int = 0
    """Seed of everything."""
    workers: int = os.cpu_count() or 1
    """Processes."""
    json: Path | None = None
    """Write the figures of the report here."""


def main(settings: ReproduceSettings) -> None:
    """Reproduce, draw, write."""
    from rich.console import Console
    from rich.progress import MofNCompleteColumn, Progress, TimeElapsedColumn

    from training.studies.paper.report import write_report
    from training.studies.paper.reproduction import ReproductionPlan, reproduce

    plan = ReproductionPlan(settings.grasps, settings.objects, settings.seed)
    expect_file(settings.output)
    console = Console()
    with Progress(
        *Progress.get_default_columns()[:2],
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        console=console,
    ) as progress:
        result = reproduce(plan, workers=settings.workers, progress=progress)
    with console.status("drawing and writing"):
        command = f"python scripts/reproduce_paper.py --grasps {plan.grasps}"
        command += f" --objects {plan.objects} --seed {plan.seed}"
        summary = write_report(result, settings.output, command)
    write_json(settings.json, summary)
    solved, gain = summary["synthesis_solved"], summary["synthesis_gain_median"]
    text = f"Contact synthesis: {solved:.0%} of {summary['synthesis_objects']} objects at rank one"
    console.print(text if gain is None else f"{text}, median gain of q_lrw {gain:+.0%}")
    console.print(f"Report: {settings.output}")


if __name__ == "__main__":
    run_cli(ReproduceSettings, main)
