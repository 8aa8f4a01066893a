"""Training of the conditioned network: on dual values, and on how they grow."""

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from rich.progress import Progress
from torch import Tensor, nn

from gfo_env.grasps import GraspTable
from solvers import GraspForceProblem, solve
from solvers.duality import dual_bound
from solvers.kkt.multiplier_flow import best_iterate
from solvers.learned.network import ConditionedKktNetwork
from solvers.problem import CanonicalProblem, canonical
from training.problems.sampling import sample_problems

from .loop import VALIDATION_SEED, Lesson, TrainingSummary, run_lesson
from .losses import problem_weights, training_loss
from .settings import TrainingError, TrainingSettings

_BUCKETS = ((3, 4), (5, 5), (6, 99))
"""Numbers of contacts that share a batch, so that little of it is padding."""


@dataclass(frozen=True, eq=False)
class Validation:
    """Fixed problems of the held-out objects, with their optimal values from an exact solver."""

    exact: GraspForceProblem
    """Canonical problems in float64: bounds in float32 are too coarse for the gaps reached."""
    problem: CanonicalProblem
    feasible: torch.Tensor
    optimum: torch.Tensor


class _Conditioned(Lesson):
    """Multipliers whose dual values come close to the optimum."""

    kind = TrainingSettings
    weights = "conditioned.safetensors"

    def __init__(
        self,
        settings: TrainingSettings,
        training: GraspTable,
        held_out: GraspTable,
        device: torch.device,
    ) -> None:
        self._settings, self._grasps, self._device = settings, training, device
        self._buckets = _buckets(training)
        self._validation = _validation(held_out, settings, device)

    @staticmethod
    def network(settings: TrainingSettings) -> ConditionedKktNetwork:
        return ConditionedKktNetwork(settings.network)

    def loss(self, model: nn.Module, rng: np.random.Generator) -> Tensor:
        problems = _batch(self._grasps, self._buckets, rng, self._settings)
        exact, batch = prepare(problems, self._device)
        iterates = model(batch)
        weights = problem_weights(exact, iterates)
        return training_loss(batch, iterates, weights, self._settings.collocation)

    def validate(self, network: Any) -> dict[str, float]:
        return validate(network, self._validation, self._settings.collocation)

    def news(self, metrics: dict[str, float]) -> str:
        return f"gap p90 {metrics['gap_p90']:.1e}, p99 {metrics['gap_p99']:.1e}"


def train(
    settings: TrainingSettings, *, command: str = "", progress: Progress | None = None
) -> TrainingSummary:
    """Train the conditioned network, see `run_lesson`.

    The metrics are the validation's loss, and quantiles of the relative dual gap: `gap_median`,
    `gap_p90`, `gap_p99`.
    """
    return run_lesson(_Conditioned, settings, command=command, progress=progress)


def prepare(
    problem: GraspForceProblem, device: torch.device | str = "cpu"
) -> tuple[CanonicalProblem, CanonicalProblem]:
    """The canonical form in float64 numpy, and what the network is given: float32 tensors."""
    exact = canonical(problem)
    tensors = exact.problem.to_torch(dtype=torch.float32, device=device)
    return exact, dataclasses.replace(exact, problem=tensors)


@torch.no_grad()
def validate(
    network: ConditionedKktNetwork, validation: Validation, collocation: float = 0.0
) -> dict[str, float]:
    """The training's loss, and quantiles of the relative gap of the dual bound to the optimum."""
    iterates = network(validation.problem)
    best = best_iterate(validation.problem.problem, iterates).map(Tensor.double)
    bound = dual_bound(validation.exact, best)[validation.feasible]
    gap = ((validation.optimum - bound) / validation.optimum).cpu().numpy()
    median, p90, p99 = np.quantile(gap, [0.5, 0.9, 0.99])
    weights = validation.feasible.float()
    return {
        "loss": float(training_loss(validation.problem, iterates, weights, collocation)),
        "gap_median": float(median),
        "gap_p90": float(p90),
        "gap_p99": float(p99),
    }


def _validation(
    held_out: GraspTable, settings: TrainingSettings, device: torch.device
) -> Validation:
    rng = np.random.default_rng([settings.seed, VALIDATION_SEED])
    # the same problems however many of the training's are made harder, so that figures compare
    sampling = dataclasses.replace(settings.sampling, hard=0.0)
    problem = sample_problems(held_out, rng, sampling)
    answer = solve(problem)
    feasible = np.isin(answer.status, ["optimal", "feasible"])
    if not feasible.any():
        raise TrainingError(
            f"none of the {len(held_out)} problems of the held-out objects is feasible; "
            "collect more grasps or ask for easier loads"
        )
    exact, form = prepare(problem, device)
    optimum = (answer.objective / exact.scale**2)[feasible]
    return Validation(
        exact=exact.problem.to_torch(device=device),
        problem=form,
        feasible=torch.as_tensor(feasible, device=device),
        optimum=torch.as_tensor(optimum, device=device),
    )


def _buckets(grasps: GraspTable) -> list[NDArray[np.intp]]:
    contacts = grasps.contact_mask.sum(axis=1)
    rows = [np.flatnonzero((contacts >= low) & (contacts <= high)) for low, high in _BUCKETS]
    return [indices for indices in rows if len(indices)]


def _batch(
    grasps: GraspTable,
    buckets: list[NDArray[np.intp]],
    rng: np.random.Generator,
    settings: TrainingSettings,
) -> GraspForceProblem:
    sizes = np.array([len(rows) for rows in buckets])
    rows = buckets[rng.choice(len(buckets), p=sizes / sizes.sum())]
    return sample_problems(grasps[rng.choice(rows, settings.batch)], rng, settings.sampling)
