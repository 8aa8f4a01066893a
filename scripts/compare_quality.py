"""Compare forces of high quality: network, reference and simple ways; write the page about it.

Examples:
    python scripts/compare_quality.py --grasps 100 --seed 0 --workers 2
    python scripts/compare_quality.py --from-json runs/quality.json
"""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from scripts._cli import ResultFiles, command_line, run_cli, write_study
from training.studies.quality.plan import QualityStudyPlan

if TYPE_CHECKING:
    from rich.progress import Progress

    from training.studies.quality.measures import QualityStudy


@dataclass(frozen=True)
class CompareQualitySettings(ResultFiles, QualityStudyPlan):
    """Compare forces that are to have the most quality for their effort."""

    page: Path = Path("docs/quality.md")
    """The page; its picture is written beside it."""


def main(settings: CompareQualitySettings) -> None:
    """Compare, measure, write, say what came out."""
    from gfo_env.grasps.collection import CollectionPlan, collect
    from gfo_env.objects import RANDOM_URDFS, ObjectSet
    from training.studies.quality.measures import QualityStudy, take_measures
    from training.studies.quality.page import write_page
    from training.studies.quality.run import run_study

    def measured(progress: "Progress") -> "QualityStudy":
        rows = run_study(settings, progress)
        objects = ObjectSet(RANDOM_URDFS, split="test")
        plan = CollectionPlan(objects, settings.grasps, settings.seed)
        table, _ = collect(plan, workers=settings.workers, progress=progress)
        progress.console.print("timing ...")
        return QualityStudy.of(settings, rows, take_measures(settings, table))

    names = ("folders", "grasps", "seed", "times", "prices", "batch", "timed", "rounds")
    command = command_line("compare_quality", settings, *names, always=("grasps", "seed"))
    write_study(settings, QualityStudy, measured, write_page, command)


if __name__ == "__main__":
    run_cli(CompareQualitySettings, main)
