"""Compare forces of high quality: network, reference and simple ways; write the page about it.

Example: python scripts/compare_quality.py --grasps 100 --seed 0 --workers 2
"""

from dataclasses import dataclass
from pathlib import Path

from scripts._cli import expect_file, run_cli, write_json
from training.studies.quality.plan import QualityStudyPlan


@dataclass(frozen=True)
class CompareQualitySettings(QualityStudyPlan):
    """Compare forces that are to have the most quality for their effort."""

    page: Path = Path("docs/quality.md")
    """The page; its picture is written beside it."""
    json: Path | None = None
    """Write every row here."""


def main(settings: CompareQualitySettings) -> None:
    """Compare, measure, write, say what came out."""
    from rich.console import Console
    from rich.progress import MofNCompleteColumn, Progress, TimeRemainingColumn

    from gfo_env.grasps.collection import CollectionPlan, collect
    from gfo_env.objects import RANDOM_URDFS, ObjectSet
    from training.studies.quality.measures import take_measures
    from training.studies.quality.page import summary, write_page
    from training.studies.quality.run import run_study

    expect_file(settings.page)
    console = Console()
    with Progress(
        *Progress.get_default_columns()[:2],
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=console,
    ) as progress:
        rows = run_study(settings, progress)
        objects = ObjectSet(RANDOM_URDFS, split="test")
        plan = CollectionPlan(objects, settings.grasps, settings.seed)
        table, _ = collect(plan, workers=settings.workers, progress=progress)
        console.print("timing ...")
        measures = take_measures(settings, table)
    write_page(settings, rows, measures, settings.page, _command(settings))
    write_json(settings.json, rows)
    console.print(summary(settings, rows, measures), markup=False, highlight=False)
    console.print(f"Page: {settings.page}")


def _command(settings: CompareQualitySettings) -> str:
    """The command that makes the page: the options that decide its numbers."""
    words = ["python scripts/compare_quality.py"]
    if settings.folders:
        words.append(f"--folders {' '.join(folder.name for folder in settings.folders)}")
    words.append(f"--grasps {settings.grasps} --seed {settings.seed}")
    default = CompareQualitySettings()
    for name in ("times", "prices", "batch", "timed", "rounds"):
        value = getattr(settings, name)
        if value != getattr(default, name):
            several = value if isinstance(value, tuple) else (value,)
            words.append(f"--{name} {' '.join(map(str, several))}")
    return " ".join(words)


if __name__ == "__main__":
    run_cli(CompareQualitySettings, main)
