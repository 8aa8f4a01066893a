"""Training of the network for quality: on what its forces are worth, through the exact repair."""

from typing import Any

import numpy as np
import torch
from rich.progress import Progress
from torch import Tensor

from gfo_env.grasps import GraspTable
from solvers import GraspForceProblem
from solvers.differentiable import soft_least_support
from solvers.max_quality.flow import QualityPoint, better_point, even_shares, quality_point
from solvers.max_quality.learned import best_points, quality_steps
from solvers.max_quality.network import QualityFeatures, QualityNetwork
from solvers.max_quality.preload import least_forces
from training.problems.quality_sampling import sample_quality_problems

from .loop import VALIDATION_SEED, Lesson, TrainingSummary, run_lesson
from .quality_repair import answered
from .quality_settings import QualityTrainingSettings
from .settings import TrainingError

_MEAN = 0.1
"""Weight of the mean over the proposals of a step, beside the best of them."""

_LEAST_QUALITY = 1e-3
"""N of q_lrw per N of budget at even preloads, below which a problem teaches nothing."""


class _Quality(Lesson):
    """Shares of the preload whose forces are worth most."""

    kind = QualityTrainingSettings
    weights = "quality.safetensors"
    cpu = True  # the exact repair is compiled for one

    def __init__(
        self,
        settings: QualityTrainingSettings,
        training: GraspTable,
        held_out: GraspTable,
        device: torch.device,
    ) -> None:
        self._settings, self._grasps = settings, training
        rng = np.random.default_rng([settings.seed, VALIDATION_SEED])
        self._validation = sample_quality_problems(held_out, rng, settings.sampling)
        if len(self._validation) == 0:
            raise TrainingError(
                f"none of the {len(held_out)} grasps of the held-out objects can carry its load; "
                "collect more grasps or ask for easier loads"
            )

    @staticmethod
    def network(settings: QualityTrainingSettings) -> QualityNetwork:
        return QualityNetwork(settings.network)

    def loss(self, model: Any, rng: np.random.Generator) -> Tensor | None:
        rows = rng.integers(len(self._grasps), size=self._settings.batch)
        problem = sample_quality_problems(self._grasps[rows], rng, self._settings.sampling)
        return quality_loss(model, problem) if len(problem) else None

    def validate(self, network: Any) -> dict[str, float]:
        return validate_quality(network, self._validation)

    def news(self, metrics: dict[str, float]) -> str:
        return f"gain {metrics['gain_median']:.1%}"


def train_quality(
    settings: QualityTrainingSettings, *, command: str = "", progress: Progress | None = None
) -> TrainingSummary:
    """Train the network for quality, see `run_lesson`.

    The metrics are those of `validate_quality`.
    """
    return run_lesson(_Quality, settings, command=command, progress=progress)


def quality_loss(network: QualityNetwork, problem: GraspForceProblem) -> Tensor:
    """() less what the forces of all steps are worth, over what is at stake in their problem.

    Of a step's proposals the best counts most, so that they learn to differ; later steps count
    more. Gradients go through the exact repair of each step, and stay within it.
    """
    least = least_forces(problem)
    point = quality_point(problem, least, even_shares(problem), problem.effort_budget)
    features = QualityFeatures.of(problem, least, point)
    scale = _scale(problem, point)
    teaches = point.quality > _LEAST_QUALITY * problem.effort_budget
    memory = network.encode(features)
    effort = torch.as_tensor(least.effort)
    spare = torch.as_tensor(problem.effort_budget) - effort
    price = torch.as_tensor(problem.effort_weight)
    total = torch.zeros((), dtype=torch.float64)
    for step in range(network.config.steps):
        proposals, spend, memory = network(features, memory, point, step)
        memory = memory.detach()
        limit = effort + spend.double() * spare
        points, worths = [], []
        for shares in proposals:
            new, normal = answered(problem, least, shares, limit, point)
            quality = soft_least_support(
                features.wrenches.double(),
                torch.as_tensor(problem.friction),
                torch.as_tensor(new.directions),
                torch.where(torch.as_tensor(problem.contact_mask), normal, 0.0),
            )
            points.append(new)
            worths.append((quality - price * normal.sum(dim=1)) / torch.as_tensor(scale))
        point = better_point(problem, points)
        worth = torch.stack(worths)
        value = _MEAN * worth.mean(dim=0) + (1.0 - _MEAN) * worth.amax(dim=0)
        mean = torch.where(torch.as_tensor(teaches), value, 0.0).sum() / max(teaches.sum(), 1)
        total = total - (step + 1) / network.config.steps * mean
    return total


def validate_quality(network: QualityNetwork, problem: GraspForceProblem) -> dict[str, float]:
    """Gains over the even preload, by estimates of q_lrw that are not certified.

    `gain_median`, `gain_p10` and `gain_p90` are relative, where effort has no price; `worth` is the
    mean gain in worth where it has one, over quality and price of the even preload.
    """
    least = least_forces(problem)
    points = quality_steps(network, problem, least)
    _, worth = best_points(problem, least, points)
    even = worth[1]
    scale = _scale(problem, points[0])
    teaches = points[0].quality > _LEAST_QUALITY * problem.effort_budget
    gain = (worth.max(axis=0) - even) / scale
    free = teaches & (problem.effort_weight == 0.0)
    priced = teaches & (problem.effort_weight > 0.0)
    quantiles = np.quantile(gain[free], [0.5, 0.1, 0.9]) if free.any() else np.zeros(3)
    return {
        "gain_median": float(quantiles[0]),
        "gain_p10": float(quantiles[1]),
        "gain_p90": float(quantiles[2]),
        "worth": float(gain[priced].mean()) if priced.any() else 0.0,
    }


def _scale(problem: GraspForceProblem, start: QualityPoint) -> np.ndarray:
    """(B,) N: quality and price of the even preload."""
    price = problem.effort_weight * problem.effort_budget
    return np.maximum(start.quality + price, 1e-9)
