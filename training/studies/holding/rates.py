"""Which forces hold an object: the exact answer, the network, heuristics, noise and chance.

Every grasp gets one task, as in `training.evaluation.solvers`; grasps whose loads the exact solver
can all carry are shaken with the forces of every method.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from rich.progress import Progress

from gfo_env.conditions import FRICTION_FACTOR, PRELOAD
from gfo_env.grasps import GraspTable
from gfo_env.grasps.collection import CollectionPlan, collect
from gfo_env.hand import BARRETT_BH8_280, HandDescription
from gfo_env.holding import HoldingError, ShakePhysics, ShakeProtocol
from gfo_env.objects import ObjectSet
from solvers import GraspForceProblem, make_solver
from solvers.arrays import Array
from training.evaluation.shaking import Shaker, hold_all
from training.evaluation.solvers import ALONE, NETWORK, untrained_network
from training.problems.tasks import Task, make_problems, make_task
from training.reports.intervals import object_interval

ORACLE = "dual_newton"

NOISE_LEVELS = (0.1, 0.2, 0.4, 0.8)
"""Sizes of the noise on the oracle's forces, relative to them."""

_HAVE_FORCES = ("optimal", "feasible")

Row = dict[str, object]


@dataclass(frozen=True)
class HoldPlan:
    """What is shaken, and how.

    Args:
        objects: the set, at one of its splits.
        grasps: how many to acquire.
        seed: of acquisition, tasks, noise and chance.
        protocol: of the shake.
        physics: settings of the simulator.
        preload: N, least normal force of every contact.
        friction_factor: share of the true friction that forces are planned with.
        hand: that holds.

    Raises:
        HoldingError: the friction factor or the preload makes no sense.
    """

    objects: ObjectSet
    grasps: int
    seed: int
    protocol: ShakeProtocol = field(default_factory=ShakeProtocol)
    physics: ShakePhysics = field(default_factory=ShakePhysics)
    preload: float = PRELOAD
    friction_factor: float = FRICTION_FACTOR
    hand: HandDescription = BARRETT_BH8_280

    def __post_init__(self) -> None:
        if not 0.0 < self.friction_factor <= 1.0:
            raise HoldingError(
                f"the friction factor is {self.friction_factor}; it must be above 0, at most 1"
            )
        if not 0.0 <= self.preload < np.inf:
            raise HoldingError(f"the preload is {self.preload} N; it must be 0 or more")

    @property
    def shaker(self) -> Shaker:
        """How to shake."""
        return Shaker(self.objects, self.protocol, self.physics, self.hand)


@dataclass(frozen=True, eq=False)
class Outcomes:
    """What became of every grasp that was shaken.

    Args:
        held: (k,) of each method, for the k grasps whose loads can all be carried.
        forces: (k, phases, 3n) N of each method.
        table: (k) grasps.
        tasks: (k) of them.
        grasps: acquired; the k are those of them that can be carried.
    """

    held: dict[str, NDArray[np.bool_]]
    forces: dict[str, Array]
    table: GraspTable
    tasks: list[Task]
    grasps: int


def judge_holding(
    plan: HoldPlan, *, workers: int = 1, progress: Progress | None = None
) -> Outcomes:
    """Acquire grasps, find the forces of every method, and shake.

    Args:
        plan: what to shake, and how.
        workers: processes of the simulation.
        progress: bars are added to it.

    Raises:
        GraspTableError, MeshError: from the acquisition.
    """
    table, _ = collect(
        CollectionPlan(plan.objects, plan.grasps, plan.seed), workers=workers, progress=progress
    )
    tasks = [make_task(plan.seed, int(number)) for number in table.attempt]
    problems = hold_problems(plan, table, tasks, plan.preload)
    forces, carriable = all_forces(plan, table, tasks, problems)
    held = hold_all(plan.shaker, table, tasks, forces, carriable, workers, progress)
    rows = np.flatnonzero(carriable)
    return Outcomes(
        held,
        {name: of_method[rows] for name, of_method in forces.items()},
        table[rows],
        [tasks[row] for row in rows],
        len(table),
    )


def hold_problems(
    plan: HoldPlan, table: GraspTable, tasks: list[Task], preload: float
) -> GraspForceProblem:
    """(grasps, phases) problems: every load of the plan's protocol, for every grasp."""
    return make_problems(
        table,
        tasks,
        plan.protocol,
        preload,
        friction_factor=plan.friction_factor,
        hand=plan.hand,
    )


def all_forces(
    plan: HoldPlan, table: GraspTable, tasks: list[Task], problems: GraspForceProblem
) -> tuple[dict[str, Array], NDArray[np.bool_]]:
    """(grasps, phases, 3n) N of every method, and (grasps,) whether all loads can be carried."""
    best, carriable = carriable_forces(problems)

    def of_solver(name: str, asked: GraspForceProblem = problems, **settings: object) -> Array:
        return np.nan_to_num(np.asarray(make_solver(name, **settings).solve(asked).forces))

    untrained = np.nan_to_num(np.asarray(untrained_network().solve(problems).forces))
    forces = {
        ORACLE: best,
        NETWORK: of_solver(NETWORK),
        f"{NETWORK}_alone": of_solver(NETWORK, **ALONE),
        "untrained_network_alone": untrained,
        "no_preload": of_solver(ORACLE, hold_problems(plan, table, tasks, 0.0)),
        "weight_only": np.repeat(best[:, :1], best.shape[1], axis=1),
    }
    true_friction = problems.friction / plan.friction_factor
    forces |= disturbed(best, problems.contact_mask, true_friction, plan.seed)
    forces["equal_squeeze"] = of_solver("equal_squeeze")
    forces["pseudoinverse"] = of_solver("pseudoinverse")
    forces["zero_force"] = np.zeros_like(best)
    return forces, carriable


def carriable_forces(problems: GraspForceProblem) -> tuple[Array, NDArray[np.bool_]]:
    """(grasps, phases, 3n) N of the oracle, and (grasps,) whether all loads can be carried.

    Raises:
        HoldingError: none of the grasps can carry all of its loads.
    """
    exact = make_solver(ORACLE).solve(problems)
    carriable = np.all(np.isin(exact.status, _HAVE_FORCES), axis=1)
    if not carriable.any():
        raise HoldingError("no grasp can carry every load: ask for more grasps, or less preload")
    return np.nan_to_num(np.asarray(exact.forces)), carriable


def disturbed(
    forces: Array, mask: NDArray[np.bool_], friction: Array, seed: int
) -> dict[str, Array]:
    """Forces with noise, and two that keep nothing of them but their size, load by load.

    Args:
        forces: (..., 3n) N.
        mask: (..., n) contacts.
        friction: (..., n) coefficient whose cones the random forces are drawn from.
        seed: of noise and chance.
    """
    rng = np.random.default_rng([seed, 3])
    used = np.repeat(mask, 3, axis=-1).astype(float)
    size = np.linalg.norm(forces, axis=-1, keepdims=True)
    share = size / np.sqrt(used.sum(axis=-1, keepdims=True))
    made = {
        f"noise_{level:.0%}": forces + level * share * used * rng.normal(size=forces.shape)
        for level in NOISE_LEVELS
    }
    squeeze = np.zeros((*mask.shape, 3))
    squeeze[..., 2] = mask
    normal = rng.uniform(size=mask.shape)
    tangent = friction * normal * np.sqrt(rng.uniform(size=mask.shape))
    angle = rng.uniform(0.0, 2.0 * np.pi, mask.shape)
    chance = np.stack([tangent * np.cos(angle), tangent * np.sin(angle), normal], axis=-1)
    for name, vectors in (
        ("equal_squeeze_same_effort", squeeze),
        ("random_in_cone_same_effort", chance),
    ):
        flat = used * vectors.reshape(forces.shape)
        made[name] = flat * size / np.linalg.norm(flat, axis=-1, keepdims=True)
    return made


def hold_rows(plan: HoldPlan, outcomes: Outcomes) -> list[Row]:
    """One row a method: the rate, its interval, and the mean effort."""
    owners = outcomes.table.object_id
    rows: list[Row] = []
    for name, held in outcomes.held.items():
        effort = np.linalg.norm(outcomes.forces[name], axis=-1)
        rows.append(
            {
                "solver": name,
                "object_set": outcomes.table.object_set,
                "split": outcomes.table.split,
                "seed": plan.seed,
                "grasps": outcomes.grasps,
                "grasps_shaken": len(held),
                "objects": len(np.unique(owners)),
                "hold_rate": float(held.mean()),
                "hold_rate_ci": list(object_interval(held.astype(float), owners)),
                "effort_median": float(np.median(effort)),
            }
        )
    return rows
