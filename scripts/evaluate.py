"""Evaluate solvers on grasps of an object set: certificates, quality, holding, time.

Example: python scripts/evaluate.py --objects random_urdfs --split test --grasps 300 --json out.json
"""

import os
from dataclasses import dataclass
from pathlib import Path

from scripts._cli import run_cli, write_json


@dataclass(frozen=True)
class EvaluateSettings:
    """Evaluate solvers on grasps of an object set: certificates, quality, holding, time."""

    objects: str = "random_urdfs"
    """`random_urdfs`, or a folder of meshes."""
    split: str | None = None
    """Split of `random_urdfs`: train, test or all. Default: test; a folder has none."""
    target_size: float | None = None
    """Scale every mesh of a folder so that its longest edge has this length, in metres."""
    solvers: tuple[str, ...] = (
        "dual_newton",
        "clarabel",
        "conditioned",
        "pseudoinverse",
        "equal_squeeze",
    )
    """Names of the solvers to compare."""
    grasps: int = 100
    """How many grasps to acquire."""
    seed: int = 0
    """Seed of acquisition and loads."""
    workers: int = os.cpu_count() or 1
    """Processes of the simulation."""
    json: Path | None = None
    """Write the rows of the table here."""


_COLUMNS = (
    ("feasible", "feasible_rate", "{:.1%}"),
    ("gap median", "gap_median", "{:.1e}"),
    ("p90", "gap_p90", "{:.1e}"),
    ("p99", "gap_p99", "{:.1e}"),
    ("balance error", "equilibrium_residual_median", "{:.1e}"),
    ("friction N", "friction_violation_max", "{:.1e}"),
    ("torque N·m", "torque_violation_max", "{:.1e}"),
    ("closure", "force_closure_rate", "{:.1%}"),
    ("q_lrw N", "q_lrw_mean", "{:.3f}"),
    ("of oracle", "q_lrw_ratio", "{:.2f}"),
    ("held", "hold_rate", "{:.1%}"),
    ("ms", "time_ms", "{:.3f}"),
)
_CAPTION = (
    "feasible: of the problems that the oracle solves; gap: certified, over feasible answers; "
    "balance error: median, relative to the forces; friction, torque: largest violation; "
    "closure, q_lrw: of the forces that carry the weight; held: of the grasps shaken; "
    "ms: per problem, judging included; in brackets 95 % intervals over objects"
)
_WITH_INTERVAL = ("feasible_rate", "hold_rate", "q_lrw_ratio")


def main(settings: EvaluateSettings) -> None:
    """Evaluate, print the table, write the rows."""
    from rich.console import Console
    from rich.progress import MofNCompleteColumn, Progress, TimeElapsedColumn
    from rich.table import Table

    from gfo_env.objects import RANDOM_URDFS, ObjectSet
    from training.evaluation import EvaluationPlan, evaluate

    split = settings.split or ("test" if settings.objects == RANDOM_URDFS else "all")
    objects = ObjectSet(settings.objects, split, target_size=settings.target_size)
    plan = EvaluationPlan(objects, settings.solvers, settings.grasps, settings.seed)
    with Progress(
        *Progress.get_default_columns()[:2], MofNCompleteColumn(), TimeElapsedColumn()
    ) as progress:
        rows = evaluate(plan, workers=settings.workers, progress=progress)
    write_json(settings.json, rows)
    first = rows[0]
    title = (
        f"{first['object_set']} ({first['split']}): {first['grasps']} grasps of "
        f"{first['objects']} objects, {first['problems_feasible']} of {first['problems']} "
        f"problems feasible, {first['grasps_shaken']} grasps shaken"
    )
    table = Table(title=title, caption=_CAPTION)
    table.add_column("solver")
    for heading, _, _ in _COLUMNS:
        table.add_column(heading, justify="right")
    for row in rows:
        cells = []
        for _, metric, form in _COLUMNS:
            value, interval = row[metric], row.get(f"{metric}_ci")
            text = "-" if value is None else form.format(value)
            if metric in _WITH_INTERVAL and isinstance(interval, list) and value is not None:
                text += f"\n[{form.format(interval[0])}, {form.format(interval[1])}]"
            cells.append(text)
        table.add_row(str(row["solver"]), *cells)
    Console(width=None if os.isatty(1) else 200).print(table)


if __name__ == "__main__":
    run_cli(EvaluateSettings, main)
