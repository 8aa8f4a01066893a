"""Training of the network for quality: on what its forces are worth, through the exact repair."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from rich.progress import Progress
from torch import Tensor

from gfo_env.grasps import GraspTable
from solvers import GraspForceProblem
from solvers.differentiable import soft_least_support
from solvers.learned.files import save_network
from solvers.max_quality.flow import QualityPoint, better_point, even_shares, quality_point
from solvers.max_quality.learned import best_points, quality_steps
from solvers.max_quality.network import QualityFeatures, QualityNetwork
from solvers.max_quality.preload import least_forces
from training.problems.quality_sampling import sample_quality_problems

from .checkpoint import provenance, resume, run_identity, save_checkpoint
from .conditioned import HISTORY, learning_rate_factor, split_by_object
from .quality_repair import answered
from .quality_settings import QualityTrainingSettings
from .settings import TrainingError

QUALITY_WEIGHTS = "quality.safetensors"

_VALIDATION_SEED = 1_000_003
_MEAN = 0.1
"""Weight of the mean over the proposals of a step, beside the best of them."""

_LEAST_QUALITY = 1e-3
"""N of q_lrw per N of budget at even preloads, below which a problem teaches nothing."""


@dataclass(frozen=True)
class QualityTrainingSummary:
    """What a finished run amounts to.

    Args:
        weights: file of the network.
        steps: of training.
        metrics: of the last validation: `gain_median`, `gain_p10` and `gain_p90`, relative to the
            even preload, where effort has no price; `worth`, mean gain in worth where it has one,
            over quality and price of the even preload.
    """

    weights: Path
    steps: int
    metrics: dict[str, float]


def train_quality(
    settings: QualityTrainingSettings, *, command: str = "", progress: Progress | None = None
) -> QualityTrainingSummary:
    """Train, or go on with the checkpoint in the output folder.

    On one CPU thread the same settings give the same weights, stopped in between or not.

    Args:
        settings: of the run.
        command: recorded with the weights, so that a reader can make them again.
        progress: bar to show; none by default.

    Raises:
        TrainingError: if the folder holds a run with other settings, or there are too few objects.
        GraspTableError: if the table of grasps cannot be read.
    """
    grasps = GraspTable.load(settings.grasps)
    training, held_out = split_by_object(grasps, settings.validation_share, settings.seed)
    settings.output.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(settings.seed)
    network = QualityNetwork(settings.network)
    optimizer = torch.optim.Adam(network.parameters(), lr=settings.learning_rate)
    identity = run_identity(settings, QualityTrainingSettings)
    start, history = resume(settings.output, identity, network, optimizer)
    rng = np.random.default_rng([settings.seed, _VALIDATION_SEED])
    validation = sample_quality_problems(held_out, rng, settings.sampling)
    if len(validation) == 0:
        raise TrainingError(
            f"none of the {len(held_out)} grasps of the held-out objects can carry its load; "
            "collect more grasps or ask for easier loads"
        )
    if not history:
        history.append({"step": 0} | validate_quality(network, validation))
    task = None if progress is None else progress.add_task("train", total=settings.steps)
    for step in range(start, settings.steps):
        rng = np.random.default_rng([settings.seed, step])
        rows = rng.integers(len(training), size=settings.batch)
        problem = sample_quality_problems(training[rows], rng, settings.sampling)
        for group in optimizer.param_groups:
            factor = learning_rate_factor(step, settings.steps, settings.warmup)
            group["lr"] = settings.learning_rate * factor
        if len(problem):
            optimizer.zero_grad()
            quality_loss(network, problem).backward()
            torch.nn.utils.clip_grad_norm_(network.parameters(), settings.gradient_norm)
            optimizer.step()
        done = step + 1
        if done % settings.validate_every == 0 or done == settings.steps:
            history.append({"step": done} | validate_quality(network, validation))
            save_checkpoint(settings.output, identity, network, optimizer, done, history)
        if progress is not None and task is not None:
            text = f"train (gain {history[-1]['gain_median']:.1%})"
            progress.update(task, completed=done, description=text)
    metrics = {name: value for name, value in history[-1].items() if name != "step"}
    (settings.output / HISTORY).write_text(json.dumps(history, indent=2) + "\n")
    metadata = provenance(settings, command, training, metrics)
    weights = settings.output / QUALITY_WEIGHTS
    save_network(network, weights, metadata)
    return QualityTrainingSummary(weights, settings.steps, metrics)


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
    """What `QualityTrainingSummary` says of problems; estimates of q_lrw, not certified."""
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
    scale: np.ndarray = np.maximum(start.quality + price, 1e-9)
    return scale
