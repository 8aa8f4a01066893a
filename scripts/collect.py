"""Collect grasps of an object set by simulation, in one file or in the cache of the environments.

Examples:
    python scripts/collect.py --grasps 10000 --workers 2 --output train.npz
    python scripts/collect.py --cache
"""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from scripts._cli import ObjectOptions, bars, run_cli, write_json


@dataclass(frozen=True)
class CollectSettings(ObjectOptions):
    """Collect grasps of an object set by simulation, in one file or in the user's cache."""

    output: Path | None = None
    """Where the table of grasps goes (.npz)."""
    cache: bool = False
    """Instead of a table, fill the cache that environments take their grasps from: all that is
    missing there, whatever `grasps` and `seed` are."""
    split: str = "train"
    """Split of `random_urdfs`: train, test or all."""
    contacts: Literal["hand", "fingertips"] = "hand"
    """What may touch: the whole hand, or fingertips alone."""
    grasps: int = 1000
    """How many grasps to collect."""
    seed: int = 0
    """Seed: the same seed gives the same bytes, whatever the number of workers."""
    workers: int = os.cpu_count() or 1
    """Processes."""
    json: Path | None = None
    """Write the figures of the report here."""


def main(settings: CollectSettings) -> None:
    """Collect, write, report."""
    from rich.console import Console

    from gfo_env.grasps.collection import CollectionError, CollectionPlan, collect, fill_cache
    from gfo_env.grasps.source import GraspSource
    from gfo_env.hand import BARRETT_BH8_280
    from solvers.files import make_folder

    if settings.cache == (settings.output is not None):
        raise CollectionError("say where the grasps go: --output FILE, or --cache, not both")
    objects = settings.open(settings.split)
    fingertips = settings.contacts == "fingertips"
    with bars() as progress:
        if settings.output is None:
            source = GraspSource(objects, BARRETT_BH8_280, fingertips=fingertips)
            report = fill_cache(source, workers=settings.workers, progress=progress)
            place = source.store.folder
        else:
            make_folder(settings.output.parent)
            plan = CollectionPlan(
                objects, settings.grasps, settings.seed, BARRETT_BH8_280, fingertips
            )
            _, report = collect(
                plan, workers=settings.workers, output=settings.output, progress=progress
            )
            place = settings.output
    summary = report.summary()
    write_json(settings.json, summary)
    console = Console()
    console.print(
        f"{report.grasps} grasps in {report.seconds:.0f} s "
        f"({summary['grasps_per_second']:.1f} per second, {settings.workers} workers), "
        f"written to {place}"
    )
    console.print(
        f"yield {summary['yield']:.1%} of {report.attempts} attempts; "
        f"{report.objects_grasped} of {report.objects_tried} objects grasped "
        f"({summary['object_yield']:.1%})"
    )
    if len(report.attempt_ms):
        console.print(
            f"attempt: median {summary['attempt_ms_median']:.0f} ms, "
            f"p95 {summary['attempt_ms_p95']:.0f} ms; "
            f"{summary['ms_per_grasp_one_core']:.0f} ms per grasp on one core"
        )
    for outcome, count in report.outcomes.items():
        console.print(f"  {outcome}: {count}")


if __name__ == "__main__":
    run_cli(CollectSettings, main)
