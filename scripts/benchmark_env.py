"""Measure how fast the environment is, and write the page about it.

Examples:
    python scripts/benchmark_env.py --page docs/environment.md --peer-python ~/panda/bin/python
    python scripts/benchmark_env.py --from-json runs/environment.json
"""

from dataclasses import dataclass
from pathlib import Path

from scripts._cli import ResultFiles, command_line, run_cli, write_study
from training.studies.environment.plan import SpeedPlan


@dataclass(frozen=True)
class BenchmarkEnvSettings(ResultFiles, SpeedPlan):
    """Measure how fast the environment is, and write the page about it."""

    page: Path = Path("docs/environment.md")
    """The page; its picture is written beside it."""


def main(settings: BenchmarkEnvSettings) -> None:
    """Measure, write, say where."""
    from training.measuring.machine import machine
    from training.studies.environment.page import write_page
    from training.studies.environment.run import PACKAGES, SpeedReport, measure

    write_study(
        settings,
        SpeedReport,
        lambda progress: measure(settings, progress),
        write_page,
        _command(settings),
        lambda: machine(PACKAGES),
    )


def _command(settings: BenchmarkEnvSettings) -> str:
    always = ("seconds", "repeats", "seed")
    others = ("workers", "resets", "objects", "grasps", "chunks", "table", "held_out_table")
    command = command_line("benchmark_env", settings, *always, *others, always=always)
    peer = " --peer-python ~/panda/bin/python"
    return command if settings.peer_python is None else command + peer


if __name__ == "__main__":
    run_cli(BenchmarkEnvSettings, main)
