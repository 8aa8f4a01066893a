"""The study: grasps, forces of every method, their measures, and what became of them."""

from contextlib import closing
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from rich.progress import Progress

from gfo_env.grasps.acquisition import Grasp
from gfo_env.grasps.attempts import grasp_of
from gfo_env.grasps.collection import CollectionPlan, collect
from gfo_env.grasps.problem import in_object_frame
from gfo_env.holding import SHAKE_PROTOCOLS, ShakeProtocol, shake
from gfo_env.simulation import Simulation
from solvers import GraspForceError
from training.measuring.jobs import run_all
from training.problems.tasks import Task, make_task, pose_problem

from ..rates import HoldPlan
from .measures import MEASURES, measure
from .methods import forces_of_methods
from .records import AGAIN, COLUMNS, STIFF, Records

Row = dict[str, Any]


class SurvivalError(GraspForceError, ValueError):
    """Settings that make no sense, a file of something else, or a study that cannot be finished."""


@dataclass(frozen=True)
class SurvivalPlan(HoldPlan):
    """What is shaken: no preload is asked for."""

    protocol: ShakeProtocol = field(default_factory=lambda: SHAKE_PROTOCOLS["weight"])
    preload: float = 0.0


@dataclass(frozen=True, eq=False)
class Study:
    """Everything that the page is made of.

    Args:
        object_set: name or path of the objects' set.
        split: of the set.
        acquired: grasps, those that cannot carry their object too.
        seed: of acquisition and tasks.
        friction_factor: share of the true friction that forces are planned with.
        joint_friction: N·m, dry.
        protocol: of the shake.
        records: of the shakes.
    """

    object_set: str
    split: str
    acquired: int
    seed: int
    friction_factor: float
    joint_friction: float
    protocol: ShakeProtocol
    records: Records


def make_study(plan: SurvivalPlan, *, workers: int = 1, progress: Progress | None = None) -> Study:
    """Acquire grasps, find the forces of every method, measure them, shake.

    Args:
        plan: what to shake.
        workers: processes.
        progress: bars are added to it.

    Raises:
        SurvivalError: no grasp can carry its object.
        GraspTableError, CollectionError, MeshError: from the acquisition.
    """
    table, _ = collect(
        CollectionPlan(plan.objects, plan.grasps, plan.seed, plan.hand),
        workers=workers,
        progress=progress,
    )
    calls = [
        (plan, grasp_of(table, k), make_task(plan.seed, int(number)), int(number))
        for k, number in enumerate(table.attempt)
    ]
    made = run_all(_rows, calls, title="shaking", workers=workers, progress=progress)
    rows = [row for of_grasp in made for row in of_grasp]
    if not rows:
        raise SurvivalError("no grasp can carry its object: ask for more grasps")
    columns: Row = {
        name: np.array([row[name] for row in rows], kind) for name, kind in COLUMNS.items()
    }
    measures = {name: np.array([row[name] for row in rows], float) for name in MEASURES}
    return Study(
        object_set=table.object_set,
        split=table.split,
        acquired=len(table),
        seed=plan.seed,
        friction_factor=plan.friction_factor,
        joint_friction=plan.physics.joint_friction,
        protocol=plan.protocol,
        records=Records(**columns, measures=measures),
    )


def _rows(plan: SurvivalPlan, grasp: Grasp, task: Task, number: int) -> list[Row]:
    """The rows of one grasp; none if it cannot carry the weight."""
    body = plan.objects[grasp.object_id].with_mass(task.mass)
    problem = pose_problem(
        grasp,
        task,
        plan.protocol,
        plan.preload,
        radius=body.radius,
        friction_factor=plan.friction_factor,
        hand=plan.hand,
    )[0]
    true = problem.replace(friction=problem.friction / plan.friction_factor)
    weight = task.mass * float(np.linalg.norm(task.gravity))
    loads = plan.protocol.disturbances(weight, body.radius)[1:]
    disturbances = in_object_frame(loads, grasp.pose)
    friction = plan.physics.joint_friction
    rows: list[Row] = []
    with closing(Simulation(plan.hand)) as simulation:
        for method, level, forces in forces_of_methods(
            problem, disturbances, body.radius, joint_friction=friction
        ):
            first, again, stiff = (
                shake(
                    simulation,
                    grasp,
                    body,
                    np.tile(forces, (plan.protocol.phases, 1)),
                    task.gravity,
                    friction=factor * task.friction,
                    protocol=plan.protocol,
                    physics=physics,
                )
                for factor, physics in (
                    (1.0, plan.physics),
                    (AGAIN, plan.physics),
                    (1.0, replace(plan.physics, joint_friction=STIFF)),
                )
            )
            row: Row = {
                "object_id": grasp.object_id,
                "attempt": number,
                "method": method,
                "level": level,
                "phases_held": first.phases_held,
                "held": first.held,
                "held_again": again.held,
                "held_stiff": stiff.held,
            }
            rows.append(row | measure(true, forces, disturbances, body, friction))
    return rows
