"""Judging solvers on real grasps: certificates, quality, and whether the simulator's object stays.

Every grasp gets one task: a mass, a friction coefficient, an orientation of the hand. Its loads are
those of the shake protocol; every solver gets the same problems, and the same simulator shakes the
object with each solver's forces.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.progress import Progress

from gfo_env.conditions import PRELOAD
from gfo_env.contacts import is_force_closure, lowest_resisted_wrench
from gfo_env.grasps import GraspTable
from gfo_env.grasps.collection import CollectionPlan, collect
from gfo_env.holding import ShakeProtocol
from gfo_env.objects import ObjectSet
from gfo_env.workers import bar
from solvers import GraspForceProblem, Solver, make_solver
from solvers.arrays import Array
from training.problems.tasks import Task, make_problems, make_task
from training.reports.intervals import object_interval

from .answers import JudgedAnswers, judged, judged_answers
from .shaking import Shaker, hold_all

ORACLE = "clarabel"

NETWORK = "conditioned"

ALONE: dict[str, Any] = {"polish_steps": 0, "fallback": None}
"""Settings under which the network is judged: exact steps behind it would hide its failures."""

UNTRAINED = "untrained_network"
"""A control beside the network: the same steps with no learned correction."""

NOISE = 0.4
"""Size of the noise on the oracle's forces in the control, relative to them."""

QUALITY_EDGES = 8

_WITH_FORCES = ("optimal", "feasible")
"""Statuses of answers whose forces hold."""

_PRESSED = 1e-6


@dataclass(frozen=True)
class EvaluationPlan:
    """What to evaluate.

    Args:
        objects: the set, at one of its splits.
        solvers: names of solvers; the oracle is added if it is not among them.
        grasps: how many to acquire.
        seed: of acquisition and tasks.
        protocol: of the shake.
    """

    objects: ObjectSet
    solvers: tuple[str, ...]
    grasps: int
    seed: int
    protocol: ShakeProtocol = field(default_factory=ShakeProtocol)


Row = dict[str, object]


def evaluate(
    plan: EvaluationPlan, *, workers: int = 1, progress: Progress | None = None
) -> list[Row]:
    """One row a solver, controls after them; keys as in the README, `<metric>_ci` beside a metric.

    Args:
        plan: what to evaluate.
        workers: processes of the simulation; solvers run in this process.
        progress: bars are added to it.

    Raises:
        UnknownSolverError, MissingDependencyError: before any work is done.
        GraspTableError, MeshError: from the acquisition.
    """
    names = plan.solvers if ORACLE in plan.solvers else (ORACLE, *plan.solvers)
    solvers = {name: make_solver(name, **(ALONE if name == NETWORK else {})) for name in names}
    if NETWORK in solvers:
        solvers[UNTRAINED] = untrained_network()
    collection = CollectionPlan(plan.objects, plan.grasps, plan.seed)
    table, _ = collect(collection, workers=workers, progress=progress)
    tasks = [make_task(plan.seed, int(number)) for number in table.attempt]
    problems = make_problems(table, tasks, plan.protocol, PRELOAD)
    step = bar(progress, "solvers", len(solvers))
    answers: dict[str, JudgedAnswers] = {}
    for name, solver in solvers.items():
        answers[name] = judged_answers(problems, solver)
        step()
    oracle = answers[ORACLE]
    answers |= controls(table, tasks, plan, problems, oracle)
    carriable = np.all(np.isin(oracle.status, _WITH_FORCES), axis=1)
    forces = {name: of_solver.forces for name, of_solver in answers.items()}
    shaker = Shaker(plan.objects, plan.protocol)
    held = hold_all(shaker, table, tasks, forces, carriable, workers, progress)
    quality = measure_quality(table, tasks, answers, carriable, progress)
    return [_row(plan, table, name, answers, held[name], quality, carriable) for name in answers]


def controls(
    table: GraspTable,
    tasks: list[Task],
    plan: EvaluationPlan,
    problems: GraspForceProblem,
    oracle: JudgedAnswers,
) -> dict[str, JudgedAnswers]:
    """Forces whose fate says whether the shake tells good from bad: none, noisy, no preload."""
    rng = np.random.default_rng([plan.seed, 3])
    used = np.repeat(problems.contact_mask, 3, axis=-1)
    count = used.sum(axis=-1, keepdims=True)
    size = np.linalg.norm(oracle.forces, axis=-1, keepdims=True) / np.sqrt(count)
    noise = NOISE * size * used * rng.normal(size=oracle.forces.shape)
    bare = make_problems(table, tasks, plan.protocol, 0.0)
    unloaded = judged_answers(bare, make_solver(ORACLE))
    unknown = np.full(oracle.status.shape, "failed")
    nothing = np.full(oracle.gap.shape, np.nan)
    return {
        f"{ORACLE}_without_preload": JudgedAnswers(**{**vars(unloaded), "time_ms": np.nan}),
        f"{ORACLE}_noise_{NOISE:.0%}".replace("%", "_percent"): judged(
            problems, oracle.forces + noise, unknown, nothing, np.nan
        ),
        "zero_force": judged(problems, 0.0 * oracle.forces, unknown, nothing, np.nan),
    }


def measure_quality(
    table: GraspTable,
    tasks: list[Task],
    answers: dict[str, JudgedAnswers],
    carriable: NDArray[np.bool_],
    progress: Progress | None,
) -> dict[str, Array]:
    """For each solver (k, 2) of the k carriable grasps: q_lrw (lower bound, N), force closure.

    Of the forces that carry the weight; only contacts that are pressed count. Torques are divided
    by the object's radius.
    """
    chosen = np.flatnonzero(carriable)
    step = bar(progress, "quality", len(chosen) * len(answers))
    quality = {name: np.zeros((len(chosen), 2)) for name in answers}
    for name, a in answers.items():
        for row, index in enumerate(chosen):
            mask = table.contact_mask[index]
            normal = a.forces[index, 0].reshape(-1, 3)[mask, 2]
            pressed = np.flatnonzero(mask)[normal > _PRESSED]
            if len(pressed):
                contacts = (
                    table.positions[index, pressed],
                    table.frames[index, pressed, :, 2],
                    np.full(len(pressed), tasks[index].friction),
                )
                interval = lowest_resisted_wrench(
                    *contacts,
                    normal_forces=normal[normal > _PRESSED],
                    edges=QUALITY_EDGES,
                    length=float(table.object_radius[index]),
                )
                closed = interval.lower > 0 or is_force_closure(*contacts)
                quality[name][row] = interval.lower, closed
            step()
    return quality


def untrained_network() -> Solver:
    """The network's steps with no learned correction."""
    from solvers.learned.network import ConditionedKktNetwork

    return make_solver(NETWORK, weights=ConditionedKktNetwork(), **ALONE)


def _row(
    plan: EvaluationPlan,
    table: GraspTable,
    name: str,
    answers: dict[str, JudgedAnswers],
    held: NDArray[np.bool_],
    quality: dict[str, Array],
    carriable: NDArray[np.bool_],
) -> Row:
    a = answers[name]
    oracle = answers[ORACLE]
    ids = np.broadcast_to(table.object_id[:, None], a.status.shape)
    solvable = np.isin(oracle.status, _WITH_FORCES)
    # a control may have been asked about other problems: it has no part in proofs
    proven = (oracle.status == "infeasible") & np.isfinite(a.time_ms)
    good = np.isin(a.status, _WITH_FORCES)
    certified = good & np.isfinite(a.gap)
    known = np.isfinite(a.residual) & solvable
    owner = table.object_id[carriable]
    q, closed = quality[name].T
    pair = np.stack([q, quality[ORACLE][:, 0]], axis=1)

    def ratio(rows: Array) -> float:
        return float(rows[:, 0].sum() / max(rows[:, 1].sum(), 1e-12))

    samples: dict[str, tuple[Array, NDArray[np.str_], Callable[[Array], Any]]] = {
        "feasible_rate": (good[solvable].astype(float), ids[solvable], np.mean),
        "infeasible_proven_rate": (
            (a.status == "infeasible")[proven].astype(float),
            ids[proven],
            np.mean,
        ),
        "equilibrium_residual_median": (a.residual[known], ids[known], np.median),
        "equilibrium_residual_max": (a.residual[known], ids[known], np.max),
        "friction_violation_max": (a.friction_violation[known], ids[known], np.max),
        "torque_violation_max": (a.torque_violation[known], ids[known], np.max),
        "gap_median": (a.gap[certified], ids[certified], np.median),
        "gap_p90": (a.gap[certified], ids[certified], lambda v: np.percentile(v, 90)),
        "gap_p99": (a.gap[certified], ids[certified], lambda v: np.percentile(v, 99)),
        "force_closure_rate": (closed, owner, np.mean),
        "q_lrw_mean": (q, owner, np.mean),
        "q_lrw_ratio": (pair, owner, ratio),
        "hold_rate": (held.astype(float), owner, np.mean),
    }
    row: Row = {
        "solver": name,
        "object_set": table.object_set,
        "split": table.split,
        "seed": plan.seed,
        "grasps": len(table),
        "objects": len(np.unique(table.object_id)),
        "grasps_shaken": int(carriable.sum()),
        "problems": int(a.status.size),
        "problems_feasible": int(solvable.sum()),
    }
    for metric, (values, owners, statistic) in samples.items():
        has = len(values) > 0 and not (metric.startswith("gap") and np.isnan(values).all())
        row[metric] = float(statistic(values)) if has else None
        row[f"{metric}_ci"] = list(object_interval(values, owners, statistic)) if has else None
    row["time_ms"] = None if np.isnan(a.time_ms) else a.time_ms
    return row
