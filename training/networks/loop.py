"""One training loop for every network: the same on a CPU, a GPU and several of them."""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from accelerate import Accelerator
from rich.progress import Progress
from torch import Tensor, nn

from gfo_env.grasps import GraspTable
from solvers.files import make_folder, write_json
from solvers.learned.files import SavedNetwork, save_network

from .checkpoint import provenance, resume, run_identity, save_checkpoint
from .settings import RunSettings, TrainingError

HISTORY = "history.json"

VALIDATION_SEED = 1_000_003
"""Apart from the steps' numbers, which seed the training batches."""


@dataclass(frozen=True)
class TrainingSummary:
    """What a finished run amounts to.

    Args:
        weights: file of the network.
        steps: of training.
        metrics: of the last validation, see `Lesson.validate` of the network.
    """

    weights: Path
    steps: int
    metrics: dict[str, float]


class Lesson(ABC):
    """What a network is taught, and on what it is examined.

    Args:
        training: grasps of the objects that it learns from.
        held_out: grasps of others.
        device: that the network is on.
    """

    kind: ClassVar[type[RunSettings]]
    """Whose fields tell one run from another."""
    weights: ClassVar[str]
    """Name of the file of the finished network."""
    cpu: ClassVar[bool] = False
    """Whether it can be taught on a CPU alone."""

    @abstractmethod
    def __init__(
        self, settings: Any, training: GraspTable, held_out: GraspTable, device: torch.device
    ) -> None: ...

    @staticmethod
    @abstractmethod
    def network(settings: Any) -> SavedNetwork:
        """The network at its first weights."""

    @abstractmethod
    def loss(self, model: nn.Module, rng: np.random.Generator) -> Tensor | None:
        """That of a step on problems drawn anew; None if none of them teaches anything."""

    @abstractmethod
    def validate(self, network: nn.Module) -> dict[str, float]:
        """Measurements on the held-out objects."""

    @abstractmethod
    def news(self, metrics: dict[str, float]) -> str:
        """A validation in a few characters, for the progress bar."""


def run_lesson(
    lesson: type[Lesson], settings: Any, *, command: str = "", progress: Progress | None = None
) -> TrainingSummary:
    """Train, or go on with the checkpoint in the output folder.

    On one CPU thread the same settings give the same weights, stopped in between or not: every
    batch is a function of the seed and of the number of the step.

    Args:
        lesson: what is taught.
        settings: of the run.
        command: recorded with the weights, so that a reader can make them again.
        progress: bar to show; none by default.

    Raises:
        TrainingError: if the folder holds a run with other settings or a damaged checkpoint, there
            are too few objects, or the gradients grow without bound.
        GraspTableError: if the table of grasps cannot be read.
        UnwritableFileError: if the system refuses to write; the last checkpoint is left.
    """
    accelerator = Accelerator(cpu=lesson.cpu)
    grasps = GraspTable.load(settings.grasps)
    training, held_out = split_by_object(grasps, settings.validation_share, settings.seed)
    make_folder(settings.output)

    torch.manual_seed(settings.seed)
    network = lesson.network(settings)
    optimizer = torch.optim.Adam(network.parameters(), lr=settings.learning_rate)
    identity = run_identity(settings, lesson.kind)
    start, history = resume(settings.output, identity, network, optimizer)
    model, optimizer = accelerator.prepare(network, optimizer)
    taught = lesson(settings, training, held_out, accelerator.device)
    if not history:
        history.append({"step": 0} | taught.validate(network))

    task = None if progress is None else progress.add_task("train", total=settings.steps)
    for step in range(start, settings.steps):
        factor = learning_rate_factor(step, settings.steps, settings.warmup)
        for group in optimizer.param_groups:
            group["lr"] = settings.learning_rate * factor
        loss = taught.loss(model, _draws(settings.seed, step, accelerator.process_index))
        if loss is not None:
            optimizer.zero_grad()
            accelerator.backward(loss)
            norm = accelerator.clip_grad_norm_(model.parameters(), settings.gradient_norm)
            if not math.isfinite(norm):
                raise TrainingError(
                    f"the gradients of step {step + 1} are not finite; use a smaller learning rate"
                )
            optimizer.step()

        done = step + 1
        if done % settings.validate_every == 0 or done == settings.steps:
            history.append({"step": done} | taught.validate(network))
            if accelerator.is_main_process:
                save_checkpoint(settings.output, identity, network, optimizer, done, history)
        if progress is not None and task is not None:
            text = f"train ({taught.news(history[-1])})"
            progress.update(task, completed=done, description=text)

    metrics = {name: value for name, value in history[-1].items() if name != "step"}
    weights = settings.output / lesson.weights
    if accelerator.is_main_process:
        write_json(settings.output / HISTORY, history)
        metadata = provenance(settings, command, training, metrics)
        save_network(network, weights, metadata)
    return TrainingSummary(weights, settings.steps, metrics)


def _draws(seed: int, step: int, process: int) -> np.random.Generator:
    """The only source of randomness of a step, another one in every process."""
    return np.random.default_rng([seed, step, process])


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


def learning_rate_factor(step: int, steps: int, warmup: int) -> float:
    """Linear warm-up times a cosine that ends at zero."""
    rise = min(1.0, (step + 1) / max(warmup, 1))
    return rise * 0.5 * (1.0 + math.cos(math.pi * step / steps))
