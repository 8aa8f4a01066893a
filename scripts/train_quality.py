"""Train the network for quality on a table of grasps.

Example: python scripts/train_quality.py --grasps train.npz --output runs/quality --seed 0
"""

import shlex
import sys
from dataclasses import dataclass
from pathlib import Path

from scripts._cli import bars, run_cli, write_json
from training.networks.quality_settings import QualityTrainingSettings


@dataclass(frozen=True)
class TrainQualitySettings(QualityTrainingSettings):
    """Train the network for quality on grasps; a run that was stopped goes on where it was."""

    json: Path | None = None
    """Write the metrics of the last validation here."""


def main(settings: TrainQualitySettings) -> None:
    """Train, report."""
    from rich.console import Console

    from training.networks.quality import train_quality

    command = shlex.join(["python", *sys.argv])
    with bars() as progress:
        summary = train_quality(settings, command=command, progress=progress)
    metrics = summary.metrics
    write_json(settings.json, {"steps": summary.steps, **metrics})
    Console().print(
        f"{summary.steps} steps; estimated q_lrw over that of the even preload on held-out "
        f"objects: +{metrics['gain_median']:.1%} (median), +{metrics['gain_p10']:.1%} (p10), "
        f"+{metrics['gain_p90']:.1%} (p90); weights in {summary.weights}"
    )


if __name__ == "__main__":
    run_cli(TrainQualitySettings, main)
