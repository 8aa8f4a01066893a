"""What each part of the conditioned network is worth: small variants, trained alike and measured.

A tenth of the objects is kept out of all trainings, and every variant is measured on the same
problems of these. Each training is a run of `training.networks.conditioned` in a folder of its own,
so that a command that was stopped goes on where it was.
"""

import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from rich.progress import Progress

from gfo_env.grasps import GraspTable
from solvers import GraspForceProblem, make_solver, solve
from solvers.arrays import Array
from solvers.duality import dual_bound, usable
from solvers.exact.polish import polished
from solvers.exact.torch_newton import cold_start
from solvers.files import make_folder
from solvers.kkt.multiplier_flow import best_iterate
from solvers.learned.config import NetworkConfig
from solvers.learned.files import load_network
from solvers.learned.network import ConditionedKktNetwork
from solvers.problem import CanonicalProblem, Multipliers, canonical
from training.networks.conditioned import prepare, train
from training.networks.loop import split_by_object
from training.networks.settings import TrainingError, TrainingSettings
from training.problems.sampling import SamplingSettings, sample_problems

SOLVED = 1e-9
"""Relative dual gap at which a problem counts as solved by Newton steps."""

MOST_NEWTON_STEPS = 20
"""Problems that take more count as this many."""

_REFERENCE_STEPS = 20
"""Newton steps from the exact solver's multipliers to the optimum that gaps are measured from."""

DRAWS = 2
"""Problems drawn for each held-out grasp."""

_ROUNDS = 5
"""Of timing."""


@dataclass(frozen=True)
class AblationPlan:
    """Small trainings for the sake of comparison.

    Args:
        grasps: table of grasps.
        output: folder of the runs.
        steps: of each training.
        batch: problems in a batch.
        repeats: trainings of the default variant, whose differences are those of chance; all others
            are trained once.
        seed: of the split of the objects, of the problems measured on, and of the first training.

    Raises:
        TrainingError: for a number that is not positive.
    """

    grasps: Path
    output: Path
    steps: int
    batch: int
    repeats: int
    seed: int

    def __post_init__(self) -> None:
        for name in ("steps", "batch", "repeats"):
            if getattr(self, name) < 1:
                raise TrainingError(f"{name} is {getattr(self, name)}; it must be positive")
        if self.seed < 0:
            raise TrainingError(f"seed is {self.seed}; it cannot be negative")


@dataclass(frozen=True)
class Variant:
    """One way to build and train the network; the default one, but for what is given."""

    group: str
    name: str
    network: NetworkConfig = field(default_factory=NetworkConfig)
    collocation: float = 0.0
    hard: float = 0.0
    trained: bool = True

    @property
    def folder(self) -> str:
        """Name of the folder of its runs."""
        return f"{self.group}-{self.name}".replace(" ", "-").replace(",", "")


BASE = Variant("base", "dual value, force space, 8 steps, width 64")
VARIANTS = (
    BASE,
    Variant("training", "none", trained=False),
    Variant("loss", "collocation only", collocation=1.0),
    Variant("loss", "half of each", collocation=0.5),
    Variant("loss", "a twentieth collocation", collocation=0.05),
    Variant("coordinates", "raw", NetworkConfig(coordinates="raw")),
    Variant("problems", "a third made harder", hard=1.0 / 3.0),
    Variant("steps", "2", NetworkConfig(steps=2)),
    Variant("steps", "4", NetworkConfig(steps=4)),
    Variant("steps", "6", NetworkConfig(steps=6)),
    Variant("width", "16", NetworkConfig(width=16)),
    Variant("width", "32", NetworkConfig(width=32)),
)


@dataclass(frozen=True, eq=False)
class Reference:
    """Problems to measure on, and their optimal values.

    Args:
        problem: B of them.
        form: their canonical form.
        feasible: (B,) which have a solution.
        optimum: (F,) optimal values of these in canonical units, as proven by multipliers.
    """

    problem: GraspForceProblem
    form: CanonicalProblem
    feasible: NDArray[np.bool_]
    optimum: Array

    def gap(self, multipliers: Multipliers) -> Array:
        """(F,) relative distance of the dual bound from the optimum, where there is one."""
        bound = dual_bound(self.form.problem, multipliers)[self.feasible]
        return np.maximum((self.optimum - bound) / self.optimum, 0.0)


@dataclass(frozen=True)
class AblationRow:
    """A variant and its measurements; lists have one entry for each training.

    Gaps are relative dual gaps of the network alone; `feasible` is the share of the feasible
    problems for which its own repair finds forces; `steps_to_gap` the mean number of Newton steps
    to a gap of `SOLVED`; `microseconds` the time for a problem, canonical form included.
    """

    group: str
    name: str
    weights: int
    gap_median: list[float]
    gap_p90: list[float]
    gap_p99: list[float]
    feasible: list[float]
    steps_to_gap: list[float]
    microseconds: float


@dataclass(frozen=True)
class Ablation:
    """All rows, and what they were measured on."""

    plan: AblationPlan
    rows: list[AblationRow]
    problems: int
    feasible: int
    objects: int
    cold_newton_steps: float
    """Mean Newton steps from y0 = 2 G^+ w, without any network."""


def run_ablation(
    plan: AblationPlan,
    variants: tuple[Variant, ...] = VARIANTS,
    *,
    progress: Progress | None = None,
) -> Ablation:
    """Train what is not trained yet, and measure everything.

    Raises:
        TrainingError: if the folder holds runs with other settings, or there are too few objects.
        GraspTableError: if the table of grasps cannot be read.
    """
    table = plan.output / "grasps.npz"
    base = _settings(plan, BASE, plan.seed, plan.grasps)
    training, held_out = split_by_object(
        GraspTable.load(plan.grasps), base.validation_share, base.seed
    )
    make_folder(plan.output)
    training.save(table)  # same table, same bytes: runs that are there already go on with it
    rows = held_out[np.tile(np.arange(len(held_out)), DRAWS)]
    rng = np.random.default_rng([plan.seed, 0xAB1A7E])
    problems = reference(sample_problems(rows, rng))
    cold = cold_start(problems.form.problem)

    def trained(variant: Variant, seed: int) -> ConditionedKktNetwork:
        if not variant.trained:
            torch.manual_seed(seed)
            return ConditionedKktNetwork(variant.network).eval()
        weights = train(_settings(plan, variant, seed, table), progress=progress).weights
        return load_network(weights, ConditionedKktNetwork)

    task = None if progress is None else progress.add_task("ablation", total=len(variants))
    networks = []
    for variant in variants:
        repeats = plan.repeats if variant.group == BASE.group else 1
        seeds = range(plan.seed, plan.seed + repeats)
        networks.append([trained(variant, seed) for seed in seeds])
        if progress is not None and task is not None:
            for other in [other.id for other in progress.tasks if other.id != task]:
                progress.remove_task(other)
            progress.advance(task)
    return Ablation(
        plan=plan,
        rows=_measured(variants, networks, problems),
        problems=len(problems.problem),
        feasible=int(problems.feasible.sum()),
        objects=len(set(held_out.object_id)),
        cold_newton_steps=float(steps_to_gap(problems, cold).mean()),
    )


def reference(problem: GraspForceProblem) -> Reference:
    """The problems with their optimal values: an exact solver's multipliers, polished.

    Raises:
        TrainingError: if none is feasible.
    """
    form = canonical(problem)
    exact = solve(problem)
    feasible = np.isin(exact.status, ["optimal", "feasible"])
    if not feasible.any():
        raise TrainingError("none of the problems of the held-out objects is feasible")
    start = usable(
        form.problem, form.scaled(Multipliers(exact.equilibrium_dual, exact.torque_dual))
    )
    here = feasible.nonzero()[0]
    end = polished(form[here].problem, start[here], _REFERENCE_STEPS)
    return Reference(problem, form, feasible, dual_bound(form[here].problem, end))


def _measured(
    variants: tuple[Variant, ...], networks: list[list[ConditionedKktNetwork]], problems: Reference
) -> list[AblationRow]:
    """The measurements of every variant's networks."""
    times = microseconds([some[0] for some in networks], problems)
    rows = []
    for variant, some, time_each in zip(variants, networks, times, strict=True):
        gaps, feasible, steps = [], [], []
        for network in some:
            guess = best_multipliers(network, problems)
            gaps.append(np.quantile(problems.gap(guess), [0.5, 0.9, 0.99]).tolist())
            solver = make_solver("conditioned", weights=network, polish_steps=0, fallback=None)
            status = solver.solve(problems.problem).status[problems.feasible]
            feasible.append(float(np.mean(np.isin(status, ["optimal", "feasible"]))))
            steps.append(float(steps_to_gap(problems, guess).mean()))
        median, p90, p99 = (list(values) for values in zip(*gaps, strict=True))
        count = sum(parameter.numel() for parameter in some[0].parameters())
        rows.append(
            AblationRow(
                group=variant.group,
                name=variant.name,
                weights=count,
                gap_median=median,
                gap_p90=p90,
                gap_p99=p99,
                feasible=feasible,
                steps_to_gap=steps,
                microseconds=time_each,
            )
        )
    return rows


def best_multipliers(network: ConditionedKktNetwork, problems: Reference) -> Multipliers:
    """(B, .) the best iterates of a network, float64 numpy, canonical units."""
    _, form = prepare(problems.problem)
    with torch.inference_mode():
        best = best_iterate(form.problem, network(form))
    return usable(problems.form.problem, best.map(lambda part: part.double().numpy()))


def steps_to_gap(problems: Reference, start: Multipliers) -> NDArray[np.int64]:
    """(F,) Newton steps from `start` to a relative dual gap of `SOLVED`, of feasible problems."""
    rows = problems.feasible.nonzero()[0]
    form = problems.form[rows].problem
    here = start[rows]
    steps = np.full(len(rows), MOST_NEWTON_STEPS)
    for step in range(MOST_NEWTON_STEPS):
        bound = dual_bound(form, here)
        done = problems.optimum - bound <= SOLVED * problems.optimum
        steps = np.where(done & (steps == MOST_NEWTON_STEPS), step, steps)
        here = polished(form, here, 1)
    return steps


def microseconds(networks: list[ConditionedKktNetwork], problems: Reference) -> list[float]:
    """Time that each network takes for a problem, in batches: the least of a few rounds.

    Rounds go through all networks, so that what else a machine does falls on all of them alike.
    """
    rounds = []
    for _ in range(_ROUNDS):
        times = []
        for network in networks:
            start = time.perf_counter()
            best_multipliers(network, problems)
            times.append(time.perf_counter() - start)
        rounds.append(times)
    least = np.min(rounds, axis=0) / len(problems.problem)
    return [float(value) for value in 1e6 * least]


def _settings(plan: AblationPlan, variant: Variant, seed: int, grasps: Path) -> TrainingSettings:
    return TrainingSettings(
        grasps=grasps,
        output=plan.output / variant.folder / str(seed),
        steps=plan.steps,
        batch=plan.batch,
        seed=seed,
        collocation=variant.collocation,
        network=variant.network,
        sampling=SamplingSettings(hard=variant.hard),
    )
