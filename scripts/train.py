"""Train the conditioned network on a table of grasps.

Example: python scripts/train.py --grasps train.npz --output runs/conditioned --seed 0
"""

import shlex
import sys
from dataclasses import dataclass
from pathlib import Path

from scripts._cli import bars, run_cli, write_json
from training.networks.settings import TrainingSettings


@dataclass(frozen=True)
class TrainSettings(TrainingSettings):
    """Train the conditioned network on grasps; a run that was stopped goes on where it was."""

    json: Path | None = None
    """Write the metrics of the last validation here."""


def main(settings: TrainSettings) -> None:
    """Train, report."""
    from rich.console import Console

    from training.networks.conditioned import train

    command = shlex.join(["python", *sys.argv])
    with bars() as progress:
        summary = train(settings, command=command, progress=progress)
    metrics = summary.metrics
    write_json(settings.json, {"steps": summary.steps, **metrics})
    Console().print(
        f"{summary.steps} steps; relative dual gap on held-out objects: "
        f"median {metrics['gap_median']:.1e}, p90 {metrics['gap_p90']:.1e}, "
        f"p99 {metrics['gap_p99']:.1e}; weights in {summary.weights}"
    )


if __name__ == "__main__":
    run_cli(TrainSettings, main)
