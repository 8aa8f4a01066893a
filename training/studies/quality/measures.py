"""Time of the methods, and error of the estimates of q_lrw."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import torch

from gfo_env.grasps import GraspTable
from solvers import GraspForceProblem
from solvers.arrays import Array
from solvers.differentiable import quality_estimates
from solvers.learned.files import load_network, read_metadata
from solvers.max_quality.learned import DEFAULT_QUALITY_WEIGHTS, QualitySolver
from solvers.max_quality.network import QualityNetwork
from solvers.max_quality.search import QualitySearchSolver
from solvers.max_quality.uniform import UniformPreloadSolver
from solvers.quality.directions import weakest_directions
from solvers.quality.verdict import quality_bounds
from solvers.solution import Candidate, judge_candidate
from training.problems.quality_sampling import sample_quality_problems

from .plan import QualityStudyPlan
from .problems import SAMPLING
from .run import EVEN, NETWORK, REFERENCE, Row

_JUDGED = 64
_LEAST = 1e-3
"""N: estimates of a smaller q_lrw have no meaningful relative error."""


@dataclass(frozen=True)
class Measures:
    """What is said beside the comparison.

    Args:
        batch: problems that were timed together.
        seconds: of each method, for one problem of the batch.
        judge: s, of the judge's verdict on one answer of the network.
        errors: median, p90 and largest relative error of estimates, by name and forces.
        judged: answers behind each error.
    """

    batch: int
    seconds: dict[str, float]
    judge: float
    errors: dict[str, tuple[float, float, float]]
    judged: int

    @property
    def ratio(self) -> float:
        """Time of the reference over that of the network."""
        return self.seconds[REFERENCE] / self.seconds[NETWORK]


@dataclass(frozen=True)
class QualityStudy:
    """Everything that the page is made of.

    Args:
        plan: of the study.
        rows: of `run_study`.
        measures: beside them.
        training: `command`, `grasps` and `steps` of the shipped network.
        proposals, steps: of the network.
    """

    plan: QualityStudyPlan
    rows: list[Row]
    measures: Measures
    training: dict[str, str]
    proposals: int
    steps: int

    @classmethod
    def of(cls, plan: QualityStudyPlan, rows: list[Row], measures: Measures) -> Self:
        """With what is known of the shipped network."""
        metadata = read_metadata(DEFAULT_QUALITY_WEIGHTS, QualityNetwork)
        config = load_network(DEFAULT_QUALITY_WEIGHTS, QualityNetwork).config
        training = {name: metadata[name] for name in ("command", "grasps", "steps")}
        return cls(plan, rows, measures, training, config.proposals, config.steps)


def take_measures(plan: QualityStudyPlan, table: GraspTable) -> Measures:
    """Time the methods on random problems of a table's grasps, at twice the least effort."""
    rng = np.random.default_rng([plan.seed, 4])
    rows = rng.integers(len(table), size=2 * plan.batch)
    problem = sample_quality_problems(table[rows], rng, SAMPLING)[: plan.batch]
    problem = problem.derived(effort_budget=2.0 * problem.effort_budget)
    few = problem[: plan.timed]
    reference = QualitySearchSolver(rounds=plan.rounds)
    seconds, answers = {}, {}
    for name, solver in ((EVEN, UniformPreloadSolver()), (NETWORK, QualitySolver())):
        solver.propose(problem[:16])  # compiled by now
        seconds[name], answers[name] = _timed(solver.propose, problem)
    seconds[REFERENCE], _ = _timed(reference.propose, few)
    judged = problem[:_JUDGED]
    some = {name: _first(answer, len(judged)) for name, answer in answers.items()}
    judge, _ = _timed(lambda asked: judge_candidate(asked, some[NETWORK]), judged)
    errors = {}
    for name, answer in some.items():
        normal = np.nan_to_num(answer.forces[:, 2::3])
        for kind, error in _errors(judged, normal).items():
            errors[f"{kind}, {name}"] = error
    return Measures(len(problem), seconds, judge, errors, len(judged))


def _timed(call: Callable[[GraspForceProblem], Any], problem: GraspForceProblem) -> Any:
    """Seconds for each problem, and the answer."""
    begun = time.perf_counter()
    answer = call(problem)
    return (time.perf_counter() - begun) / len(problem), answer


def _first(answer: Any, count: int) -> Any:
    return Candidate(answer.forces[:count], answer.multipliers[:count], answer.message[:count])


def _errors(problem: GraspForceProblem, normal: Array) -> dict[str, tuple[float, float, float]]:
    bounds = [
        quality_bounds(problem[i].without_padding(), normal[i][problem.contact_mask[i]])
        for i in range(len(problem))
    ]
    lower = np.array([bound.lower for bound in bounds])
    chosen = lower > _LEAST
    compiled, _ = weakest_directions(problem, normal)
    tensors = quality_estimates(problem.to_torch(), torch.as_tensor(normal)).numpy()
    found = {}
    for name, estimate in (("compiled", compiled), ("torch", tensors)):
        error = estimate[chosen] / lower[chosen] - 1.0
        found[name] = (
            float(np.median(error)),
            float(np.quantile(error, 0.9)),
            float(error.max()),
        )
    return found
