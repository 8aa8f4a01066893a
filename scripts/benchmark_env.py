"""Measure how fast the environment is, and write the page about it.

Example: python scripts/benchmark_env.py --page docs/environment.md --peer-python ~/panda/bin/python
"""

from dataclasses import dataclass
from pathlib import Path

from scripts._cli import expect_file, run_cli, write_json
from training.studies.environment.plan import SpeedPlan


@dataclass(frozen=True)
class BenchmarkEnvSettings(SpeedPlan):
    """Measure how fast the environment is, and write the page about it."""

    page: Path = Path("docs/environment.md")
    """The page; its picture is written beside it."""
    json: Path | None = None
    """Write every figure here, a row each."""


def main(settings: BenchmarkEnvSettings) -> None:
    """Measure, write, say where."""
    from rich.console import Console
    from rich.progress import MofNCompleteColumn, Progress, TimeElapsedColumn

    from training.studies.environment.page import summary, write_page
    from training.studies.environment.run import measure

    expect_file(settings.page)
    console = Console()
    with Progress(
        *Progress.get_default_columns()[:2],
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        console=console,
    ) as progress:
        report = measure(settings, progress)
    write_page(report, settings.page, _command(settings))
    write_json(settings.json, report.rows())
    console.print(summary(report), markup=False, highlight=False)
    console.print(f"Page: {settings.page}")


def _command(settings: BenchmarkEnvSettings) -> str:
    """The command that makes the page: options that matter, and where they are not the default."""
    command = f"python scripts/benchmark_env.py --seconds {settings.seconds:g}"
    command += f" --repeats {settings.repeats} --seed {settings.seed}"
    default = BenchmarkEnvSettings()
    for name in ("workers", "resets", "objects", "grasps", "chunks"):
        value = getattr(settings, name)
        if value != getattr(default, name):
            command += f" --{name} {' '.join(map(str, value)) if name == 'workers' else value}"
    if settings.table is not None:
        command += f" --table {settings.table.name}"
    if settings.held_out_table is not None:
        command += f" --held-out-table {settings.held_out_table.name}"
    if settings.peer_python is not None:
        command += " --peer-python ~/panda/bin/python"
    return command


if __name__ == "__main__":
    run_cli(BenchmarkEnvSettings, main)
