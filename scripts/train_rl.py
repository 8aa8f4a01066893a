"""Train an agent of stable-baselines3 on the environment, from scratch or behind a solver.

Example: python scripts/train_rl.py --algo ppo --policy residual --output runs/residual --seed 0
"""

from dataclasses import dataclass
from pathlib import Path

from scripts._cli import run_cli, write_json
from training.rl.settings import RlSettings


@dataclass(frozen=True)
class TrainRlSettings(RlSettings):
    """Train an agent on the environment; a run that was stopped goes on where it was."""

    json: Path | None = None
    """Write steps, reward and hold rate of the last evaluation here."""


def main(settings: TrainRlSettings) -> None:
    """Train, report."""
    import dataclasses

    from rich.console import Console

    from training.rl.trainer import as_json, train_rl

    fields = {field.name for field in dataclasses.fields(RlSettings)}
    run = RlSettings(**{name: getattr(settings, name) for name in fields})
    summary = train_rl(run, progress_bar=True)
    write_json(settings.json, as_json(summary))
    Console().print(
        f"{summary.steps} steps; on held-out objects: mean return {summary.reward:.3f}, "
        f"success {summary.hold_rate:.1%}; model in {summary.model}"
    )


if __name__ == "__main__":
    run_cli(TrainRlSettings, main)
