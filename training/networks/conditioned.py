"""Training of the conditioned network: one loop, the same on a CPU, a GPU and several of them."""

import dataclasses
import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from accelerate import Accelerator
from numpy.typing import NDArray
from rich.progress import Progress

from gfo_env.grasps import GraspTable
from solvers import GraspForceProblem, solve
from solvers.duality import dual_bound
from solvers.kkt.multiplier_flow import best_iterate
from solvers.learned.files import save_network
from solvers.learned.network import ConditionedKktNetwork
from solvers.problem import CanonicalProblem, Multipliers, canonical
from training.problems.sampling import sample_problems

from .checkpoint import provenance, resume, run_identity, save_checkpoint
from .losses import problem_weights, training_loss
from .settings import TrainingError, TrainingSettings

HISTORY = "history.json"
WEIGHTS = "conditioned.safetensors"

_BUCKETS = ((3, 4), (5, 5), (6, 99))
"""Numbers of contacts that share a batch, so that little of it is padding."""

_VALIDATION_SEED = 1_000_003
"""Apart from the steps' numbers, which seed the training batches."""


@dataclass(frozen=True, eq=False)
class Validation:
    """Fixed problems of the held-out objects, with their optimal values from an exact solver."""

    exact: GraspForceProblem
    """Canonical problems in float64: bounds in float32 are too coarse for the gaps reached."""
    problem: CanonicalProblem
    feasible: torch.Tensor
    optimum: torch.Tensor


@dataclass(frozen=True)
class TrainingSummary:
    """What a finished run amounts to."""

    weights: Path
    steps: int
    metrics: dict[str, float]
    """Of the last validation: `loss`, and quantiles of the relative dual gap: `gap_median`, ..."""


def train(
    settings: TrainingSettings, *, command: str = "", progress: Progress | None = None
) -> TrainingSummary:
    """Train, or go on with the checkpoint in the output folder.

    On one CPU thread the same settings give the same weights, stopped in between or not: every
    batch is a function of the seed and of the number of the step.

    Args:
        settings: of the run.
        command: recorded with the weights, so that a reader can make them again.
        progress: bar to show; none by default.

    Raises:
        TrainingError: if the folder holds a run with other settings, or there are too few objects.
        GraspTableError: if the table of grasps cannot be read.
    """
    accelerator = Accelerator()
    grasps = GraspTable.load(settings.grasps)
    training, held_out = split_by_object(grasps, settings.validation_share, settings.seed)
    settings.output.mkdir(parents=True, exist_ok=True)

    torch.manual_seed(settings.seed)
    network = ConditionedKktNetwork(settings.network)
    optimizer = torch.optim.Adam(network.parameters(), lr=settings.learning_rate)
    identity = run_identity(settings, TrainingSettings)
    start, history = resume(settings.output, identity, network, optimizer)
    model, optimizer = accelerator.prepare(network, optimizer)
    validation = _validation(held_out, settings, accelerator.device)
    if not history:
        history.append({"step": 0} | validate(network, validation, settings.collocation))
    buckets = _buckets(training)

    task = None if progress is None else progress.add_task("train", total=settings.steps)
    for step in range(start, settings.steps):
        rng = np.random.default_rng([settings.seed, step, accelerator.process_index])
        problems = _batch(training, buckets, rng, settings)
        for group in optimizer.param_groups:
            group["lr"] = settings.learning_rate * learning_rate_factor(
                step, settings.steps, settings.warmup
            )
        exact, batch = prepare(problems, accelerator.device)
        iterates = model(batch)
        worth = problem_weights(exact, iterates)
        loss = training_loss(batch, iterates, worth, settings.collocation)
        optimizer.zero_grad()
        accelerator.backward(loss)
        accelerator.clip_grad_norm_(model.parameters(), settings.gradient_norm)
        optimizer.step()

        done = step + 1
        if done % settings.validate_every == 0 or done == settings.steps:
            history.append({"step": done} | validate(network, validation, settings.collocation))
            if accelerator.is_main_process:
                save_checkpoint(settings.output, identity, network, optimizer, done, history)
        if progress is not None and task is not None:
            latest = history[-1]
            text = f"train (gap p90 {latest['gap_p90']:.1e}, p99 {latest['gap_p99']:.1e})"
            progress.update(task, completed=done, description=text)

    metrics = {name: value for name, value in history[-1].items() if name != "step"}
    weights = settings.output / WEIGHTS
    if accelerator.is_main_process:
        (settings.output / HISTORY).write_text(json.dumps(history, indent=2) + "\n")
        metadata = provenance(settings, command, training, metrics)
        save_network(network, weights, metadata)
    return TrainingSummary(weights, settings.steps, metrics)


def prepare(
    problem: GraspForceProblem, device: torch.device | str = "cpu"
) -> tuple[CanonicalProblem, CanonicalProblem]:
    """The canonical form in float64 numpy, and what the network is given: float32 tensors."""
    exact = canonical(problem)
    tensors = exact.problem.to_torch(dtype=torch.float32, device=device)
    return exact, dataclasses.replace(exact, problem=tensors)


def split_by_object(grasps: GraspTable, share: float, seed: int) -> tuple[GraspTable, GraspTable]:
    """Grasps for training and for validation; no object is in both.

    Args:
        grasps: of several objects.
        share: of the objects that is kept out of training.
        seed: of the choice.

    Raises:
        TrainingError: if there is only one object.
    """
    objects = np.unique(grasps.object_id)
    if len(objects) < 2:
        raise TrainingError(
            f"all grasps of the table are of {', '.join(objects)}; validation needs another object"
        )
    count = min(max(1, round(share * len(objects))), len(objects) - 1)
    chosen = np.random.default_rng(seed).permutation(objects)[:count]
    held_out = np.isin(grasps.object_id, chosen)
    return grasps[~held_out], grasps[held_out]


@torch.no_grad()
def validate(
    network: ConditionedKktNetwork, validation: Validation, collocation: float = 0.0
) -> dict[str, float]:
    """The training's loss, and quantiles of the relative gap of the dual bound to the optimum."""
    iterates = network(validation.problem)
    best = best_iterate(validation.problem.problem, iterates)
    best = Multipliers(best.equilibrium.double(), best.torque.double())
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
    rng = np.random.default_rng([settings.seed, _VALIDATION_SEED])
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


def learning_rate_factor(step: int, steps: int, warmup: int) -> float:
    """Linear warm-up times a cosine that ends at zero."""
    rise = min(1.0, (step + 1) / max(warmup, 1))
    return rise * 0.5 * (1.0 + math.cos(math.pi * step / steps))
