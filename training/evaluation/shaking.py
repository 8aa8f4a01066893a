"""Shaking many grasps, with the forces of many methods, in parallel."""

from contextlib import closing
from dataclasses import dataclass, field

import numpy as np
from joblib import delayed
from numpy.typing import NDArray
from rich.progress import Progress

from gfo_env.grasps import GraspTable
from gfo_env.grasps.attempts import grasp_of
from gfo_env.hand import BARRETT_BH8_280, HandDescription
from gfo_env.holding import ShakePhysics, ShakeProtocol, shake
from gfo_env.objects import ObjectSet
from gfo_env.simulation import Simulation
from gfo_env.workers import bar, worker_pool
from solvers.arrays import Array
from training.problems.tasks import Task

_AT_ONCE = 5


@dataclass(frozen=True)
class Shaker:
    """How grasps are shaken.

    Args:
        objects: the set that the grasps belong to.
        protocol: loads and thresholds.
        physics: settings of the simulator.
        hand: that holds; one with the links and joints that the grasps were made with.
    """

    objects: ObjectSet
    protocol: ShakeProtocol = field(default_factory=ShakeProtocol)
    physics: ShakePhysics = field(default_factory=ShakePhysics)
    hand: HandDescription = BARRETT_BH8_280


def hold_all(
    shaker: Shaker,
    table: GraspTable,
    tasks: list[Task],
    forces: dict[str, Array],
    chosen: NDArray[np.bool_],
    workers: int = 1,
    progress: Progress | None = None,
) -> dict[str, NDArray[np.bool_]]:
    """For each method, whether each chosen grasp held, in the order of the chosen grasps.

    Args:
        shaker: how to shake.
        table: N grasps.
        tasks: of each grasp.
        forces: (N, phases, 3n) N of each method.
        chosen: (N,) the grasps to shake.
        workers: processes.
        progress: a bar is added to it.
    """
    rows = np.flatnonzero(chosen)
    chunks = [rows[start : start + _AT_ONCE] for start in range(0, len(rows), _AT_ONCE)]
    step = bar(progress, "holding", len(rows))
    results: dict[str, list[bool]] = {name: [] for name in forces}
    with worker_pool(workers) as pool:
        jobs = (
            delayed(_hold_chunk)(
                shaker,
                table[chunk],
                [tasks[i] for i in chunk],
                {name: of_method[chunk] for name, of_method in forces.items()},
            )
            for chunk in chunks
        )
        for made in pool(jobs):
            for name, held in made.items():
                results[name] += held
            step(len(next(iter(made.values()))))
    return {name: np.array(held, dtype=np.bool_) for name, held in results.items()}


def _hold_chunk(
    shaker: Shaker, table: GraspTable, tasks: list[Task], forces: dict[str, Array]
) -> dict[str, list[bool]]:
    held: dict[str, list[bool]] = {name: [] for name in forces}
    with closing(Simulation(shaker.hand)) as simulation:
        for index, task in enumerate(tasks):
            grasp = grasp_of(table, index)
            body = shaker.objects[grasp.object_id].with_mass(task.mass)
            for name, commanded in forces.items():
                result = shake(
                    simulation,
                    grasp,
                    body,
                    commanded[index, :, : 3 * len(grasp.contacts)],
                    task.gravity,
                    friction=task.friction,
                    protocol=shaker.protocol,
                    physics=shaker.physics,
                )
                held[name].append(result.held)
    return held
