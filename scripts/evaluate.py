"""Evaluate solvers on grasps of an object set: certificates, quality, holding, time.

Examples:
    python scripts/evaluate.py --objects random_urdfs --split test --grasps 300 --json out.json
    python scripts/evaluate.py --hold --grasps 300 --preload 2
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from scripts._cli import ObjectOptions, bars, run_cli, write_json


@dataclass(frozen=True)
class EvaluateSettings(ObjectOptions):
    """Evaluate solvers on grasps of an object set: certificates, quality, holding, time."""

    split: str | None = None
    """Split of `random_urdfs`: train, test or all. Default: test; a folder has none."""
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
    hold: bool = False
    """Judge nothing but holding: more methods, and a static margin against the outcomes."""
    physics: bool = False
    """Hold rates while one setting of the simulator is changed after the other."""
    protocol: Literal["push", "weight"] = "push"
    """Of --hold and --physics: pushes of 2 N, or forces and torques in multiples of the weight."""
    preload: float | None = None
    """Of --hold and --physics: least normal force of every contact, in newtons."""
    friction_factor: float | None = None
    """Of --hold and --physics: share of the true friction that forces are planned with."""
    time_step: float | None = None
    """Of --hold and --physics, in seconds."""
    iterations: int | None = None
    """Of --hold and --physics: of the simulator's contact solver."""
    joint_friction: float | None = None
    """Of --hold and --physics: dry friction of every joint, in N·m."""
    joint_damping: float | None = None
    """Of --hold and --physics: viscous, of every joint, in N·m·s."""
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
_WITHOUT_INTERVAL = (
    "gap_median",
    "gap_p90",
    "gap_p99",
    "equilibrium_residual_median",
    "friction_violation_max",
    "torque_violation_max",
    "force_closure_rate",
    "q_lrw_mean",
)
_HOLD_COLUMNS = (("held", "hold_rate", "{:.1%}"), ("effort N", "effort_median", "{:.1f}"))
_HOLD_CAPTION = (
    "held: of the grasps whose loads can all be carried; effort: 2-norm of the forces, median over "
    "grasps and loads; in brackets 95 % intervals over objects"
)
_ROC_COLUMNS = (
    ("all", "roc_area", "{:.3f}"),
    ("feasible forces", "roc_area_feasible", "{:.3f}"),
    ("certified error m/s2", "certified_error_max", "{:.1e}"),
)
_ROC_CAPTION = (
    "area under the ROC curve against survival: of good and bad forces pooled, and of forces that "
    "satisfy every constraint; in brackets 95 % intervals over objects"
)


def main(settings: EvaluateSettings) -> None:
    """Evaluate, print the table, write the rows."""
    from gfo_env.objects import RANDOM_URDFS

    objects = settings.open(
        settings.split or ("test" if settings.objects == RANDOM_URDFS else "all")
    )
    if settings.hold:
        judge_holding(settings, objects)
    elif settings.physics:
        vary_physics(settings, objects)
    else:
        compare_solvers(settings, objects)


def compare_solvers(settings: EvaluateSettings, objects: Any) -> None:
    """Certificates, quality, holding and time of every solver."""
    from training.evaluation.solvers import EvaluationPlan, evaluate

    plan = EvaluationPlan(objects, settings.solvers, settings.grasps, settings.seed)
    with bars() as progress:
        rows = evaluate(plan, workers=settings.workers, progress=progress)
    write_json(settings.json, rows)
    first = rows[0]
    title = (
        f"{first['object_set']} ({first['split']}): {first['grasps']} grasps of "
        f"{first['objects']} objects, {first['problems_feasible']} of {first['problems']} "
        f"problems feasible, {first['grasps_shaken']} grasps shaken"
    )
    _print_table(title, _CAPTION, "solver", _COLUMNS, rows)


def judge_holding(settings: EvaluateSettings, objects: Any) -> None:
    """Hold rates of every method, and how well a static margin foretells them."""
    from training.studies.holding import rates as hold_rates
    from training.studies.holding.prediction import roc_rows

    plan = _hold_plan(settings, objects)
    with bars() as progress:
        outcomes = hold_rates.judge_holding(plan, workers=settings.workers, progress=progress)
        rows = hold_rates.hold_rows(plan, outcomes)
        margins = roc_rows(plan, outcomes, progress)
    write_json(settings.json, rows + margins)
    first = rows[0]
    title = (
        f"{first['object_set']} ({first['split']}): {first['grasps_shaken']} of "
        f"{first['grasps']} grasps can carry every load; they are of {first['objects']} objects"
    )
    _print_table(title, _HOLD_CAPTION, "solver", _HOLD_COLUMNS, rows)
    _print_table(None, _ROC_CAPTION, "predictor", _ROC_COLUMNS, margins)


def vary_physics(settings: EvaluateSettings, objects: Any) -> None:
    """Hold rates while one setting is changed after the other."""
    from training.studies.holding.physics import CONTROLS, physics_rows
    from training.studies.holding.rates import ORACLE

    plan = _hold_plan(settings, objects)
    with bars() as progress:
        rows = physics_rows(plan, workers=settings.workers, progress=progress)
    write_json(settings.json, rows)
    columns = (
        ("value", "value", "{:.4g}"),
        ("shaken", "grasps_shaken", "{}"),
        *((name, name, "{:.1%}") for name in (ORACLE, *CONTROLS)),
    )
    _print_table(None, "held, each setting alone", "setting", columns, rows)


def _hold_plan(settings: EvaluateSettings, objects: Any) -> Any:
    from gfo_env.holding import SHAKE_PROTOCOLS
    from training.studies.holding.rates import HoldPlan

    plan = HoldPlan(
        objects, settings.grasps, settings.seed, protocol=SHAKE_PROTOCOLS[settings.protocol]
    )
    names = ("time_step", "iterations", "joint_friction", "joint_damping")
    plan = replace(plan, physics=replace(plan.physics, **_given(settings, names)))
    return replace(plan, **_given(settings, ("preload", "friction_factor")))


def _given(settings: EvaluateSettings, names: Sequence[str]) -> dict[str, Any]:
    values = {name: getattr(settings, name) for name in names}
    return {name: value for name, value in values.items() if value is not None}


def _print_table(
    title: str | None,
    caption: str,
    key: str,
    columns: Sequence[tuple[str, str, str]],
    rows: list[dict[str, object]],
) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title, caption=caption)
    table.add_column(key)
    for heading, _, _ in columns:
        table.add_column(heading, justify="right")
    for row in rows:
        cells = []
        for _, metric, form in columns:
            value, interval = row[metric], row.get(f"{metric}_ci")
            text = "-" if value is None else form.format(value)
            if metric not in _WITHOUT_INTERVAL and isinstance(interval, list) and value is not None:
                text += f"\n[{form.format(interval[0])}, {form.format(interval[1])}]"
            cells.append(text)
        table.add_row(str(row[key]), *cells)
    Console(width=None if os.isatty(1) else 200).print(table)


if __name__ == "__main__":
    run_cli(EvaluateSettings, main)
