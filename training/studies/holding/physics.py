"""What the simulator's settings do to hold rates: one setting changed at a time."""

import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.progress import Progress

from gfo_env.grasps.collection import CollectionPlan, collect
from gfo_env.hand.urdf import build_urdf
from gfo_env.holding import ShakePhysics
from training.evaluation.shaking import hold_all
from training.problems.tasks import make_task
from training.reports.intervals import object_interval

from .rates import ORACLE, HoldPlan, Row, carriable_forces, disturbed, hold_problems

CONTROLS = ("noise_40%", "equal_squeeze_same_effort")
"""Bad forces beside the oracle's: a setting that holds them is no better."""

_PHYSICS: dict[str, tuple[float, ...]] = {
    "time_step": (1 / 240, 1 / 480, 1 / 1000),
    "iterations": (25, 50, 100, 200),
    "joint_friction": (0.0, 0.005, 0.01, 0.02, 0.05),
    "joint_damping": (0.002, 0.01),
}
_PLANNING: dict[str, tuple[float, ...]] = {
    "preload": (0.0, 2.0, 3.0, 4.0, 5.0),
    "friction_factor": (0.6, 0.7, 0.8, 0.9),
}


def physics_rows(
    plan: HoldPlan, *, workers: int = 1, progress: Progress | None = None
) -> list[Row]:
    """Hold rates of the oracle and of bad forces, one row a setting; the first is the plan's own.

    Args:
        plan: around which settings are changed, on the same grasps and tasks.
        workers: processes of the simulation.
        progress: bars are added to it.
    """
    table, _ = collect(
        CollectionPlan(plan.objects, plan.grasps, plan.seed), workers=workers, progress=progress
    )
    tasks = [make_task(plan.seed, int(number)) for number in table.attempt]
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        for setting, value, variant in variants(plan, Path(folder)):
            problems = hold_problems(variant, table, tasks, variant.preload)
            best, carriable = carriable_forces(problems)
            friction = problems.friction / variant.friction_factor
            bad = disturbed(best, problems.contact_mask, friction, plan.seed)
            forces = {ORACLE: best, **{name: bad[name] for name in CONTROLS}}
            held = hold_all(variant.shaker, table, tasks, forces, carriable, workers, progress)
            owners = table.object_id[carriable]
            row: Row = {
                "setting": setting,
                "value": value,
                "grasps": len(table),
                "grasps_shaken": int(carriable.sum()),
            }
            for name, outcome in held.items():
                row[name] = float(outcome.mean())
                row[f"{name}_ci"] = list(object_interval(outcome.astype(float), owners))
            rows.append(row)
    return rows


def variants(plan: HoldPlan, folder: Path) -> Iterator[tuple[str, float | None, HoldPlan]]:
    """Setting, value and plan of each row; a hand without armature is written into `folder`."""
    yield "as it is", None, plan
    for setting, values in _PHYSICS.items():
        kind = type(getattr(ShakePhysics(), setting))
        for value in values:
            if value != getattr(plan.physics, setting):
                physics = replace(plan.physics, **{setting: kind(value)})
                yield setting, value, replace(plan, physics=physics)
    for setting, values in _PLANNING.items():
        for value in values:
            if value != getattr(plan, setting):
                changes: dict[str, Any] = {setting: value}
                yield setting, value, replace(plan, **changes)
    path = folder / "no_armature.urdf"
    path.write_text(build_urdf(armature=False))
    yield "armature", 0.0, replace(plan, hand=replace(plan.hand, urdf=path))
