"""What each stage of the `conditioned` solver adds: network, repair and Newton steps; and cold."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.progress import Progress

from gfo_env.grasps import GraspTable
from gfo_env.workers import bar
from solvers import make_solver
from solvers.arrays import Array
from solvers.duality import dual_bound
from solvers.learned.conditioned import DEFAULT_WEIGHTS
from solvers.learned.config import NetworkConfig
from solvers.learned.files import load_network
from solvers.learned.network import ConditionedKktNetwork
from solvers.problem import Multipliers
from training.networks.loop import split_by_object
from training.networks.settings import TrainingSettings
from training.problems.sampling import sample_problems

from .run import DRAWS, Ablation, AblationPlan, Reference, best_multipliers, reference, steps_to_gap

POLISH_STEPS = (0, 1, 2, 4)

_GRASPS = 600
"""Of a table, at most."""

_STREAM = 0x57A6E5
"""Sets the problems apart from those of the variants."""


@dataclass(frozen=True)
class Stage:
    """One start and number of Newton steps; three numbers are median and 90th, 99th percentile.

    Args:
        start: `network`, or `cold` for y0 = 2 G^+ w without any network.
        polish_steps: Newton steps before the repair.
        gap: relative dual gap, over all feasible problems.
        feasible: share of these that the repair finds forces for.
        certified_gap: relative distance of the forces' value from the dual bound, over those.
        proven: share of the infeasible problems that are proven to be so.
    """

    start: str
    polish_steps: int
    gap: list[float]
    feasible: float
    certified_gap: list[float]
    proven: float


@dataclass(frozen=True)
class Stages:
    """All stages, and the Newton steps that each start needs, see `run.steps_to_gap`."""

    rows: list[Stage]
    steps_to_gap: dict[str, float]
    problems: int
    feasible: int


@dataclass(frozen=True)
class AblationStudy:
    """Everything that the page is made of.

    Args:
        ablation: the variants.
        stages: of the shipped weights, by the name of the objects.
    """

    ablation: Ablation
    stages: dict[str, Stages]


def shipped_stages(
    plan: AblationPlan, held_out: Path | None, *, progress: Progress | None = None
) -> dict[str, Stages]:
    """The stages with the shipped weights, by the name of the objects that they are measured on.

    Args:
        plan: its table and seed tell the objects of the training, if they are those of the weights.
        held_out: table of grasps of other objects, if there is one.
        progress: bar to show; none by default.

    Raises:
        GraspTableError: if a table cannot be read.
    """
    settings = TrainingSettings(grasps=plan.grasps, output=plan.output, seed=plan.seed)
    known, _ = split_by_object(
        GraspTable.load(plan.grasps), settings.validation_share, settings.seed
    )
    tables = {} if held_out is None else {"Held-out objects": GraspTable.load(held_out)}
    tables["Objects of the training"] = known
    network = load_network(DEFAULT_WEIGHTS, ConditionedKktNetwork)
    step = bar(progress, "stages", len(tables))
    results = {}
    for name, table in tables.items():
        rng = np.random.default_rng([plan.seed, _STREAM])
        rows = rng.permutation(len(table))[:_GRASPS]
        problems = reference(sample_problems(table[np.tile(rows, DRAWS)], rng))
        results[name] = run_stages(network, problems)
        step()
    return results


def run_stages(network: ConditionedKktNetwork, problems: Reference) -> Stages:
    """Measure the stages on problems of a table, without any fallback."""
    starts = {"network": network, "cold": ConditionedKktNetwork(NetworkConfig(steps=0)).eval()}
    return Stages(
        rows=[
            _stage(start, steps, start_network, problems)
            for start, start_network in starts.items()
            for steps in POLISH_STEPS
        ],
        steps_to_gap={
            start: float(steps_to_gap(problems, best_multipliers(start_network, problems)).mean())
            for start, start_network in starts.items()
        },
        problems=len(problems.problem),
        feasible=int(problems.feasible.sum()),
    )


def _stage(start: str, steps: int, network: ConditionedKktNetwork, problems: Reference) -> Stage:
    solver = make_solver("conditioned", weights=network, polish_steps=steps, fallback=None)
    answer = solver.solve(problems.problem)
    feasible = problems.feasible
    found = feasible & np.isin(answer.status, ["optimal", "feasible"])
    bound = dual_bound(problems.problem, Multipliers(answer.equilibrium_dual, answer.torque_dual))[
        feasible
    ]
    optimum = problems.optimum * problems.form.scale[feasible] ** 2
    none = ~feasible
    proven = answer.status[none] == "infeasible"
    return Stage(
        start=start,
        polish_steps=steps,
        gap=_quantiles(np.maximum((optimum - bound) / optimum, 0.0)),
        feasible=float(found.sum() / feasible.sum()),
        certified_gap=_quantiles(answer.gap[found]),
        proven=float(proven.mean()) if none.any() else 1.0,
    )


def _quantiles(values: Array) -> list[float]:
    return np.quantile(values, [0.5, 0.9, 0.99]).tolist()
