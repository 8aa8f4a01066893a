"""Settings of a training run; kept apart from the trainer so that reading them needs no torch."""

import math
from dataclasses import dataclass, field
from pathlib import Path

from solvers import GraspForceError
from solvers.learned.config import NetworkConfig
from training.problems.sampling import SamplingSettings


class TrainingError(GraspForceError):
    """A training run cannot start or go on as asked."""


def expect_whole(name: str, value: int, *, least: int = 0, most: int = 2**63 - 1) -> None:
    """See that a setting is a whole number from `least` to `most`.

    Raises:
        TrainingError: if it is not.
    """
    if type(value) is not int or value < least:
        raise TrainingError(f"{name} is {value}; it must be a whole number, {least} or more")
    if value > most:
        raise TrainingError(f"{name} is {value}; it must be {most} or less")


@dataclass(frozen=True)
class RunSettings:
    """What the training of any network on grasps takes."""

    grasps: Path
    """Table of grasps (.npz) from scripts/collect.py."""
    output: Path
    """Folder for the checkpoint, the history and the weights."""
    steps: int = 300
    """Gradient steps, each on a batch of problems that is never seen again."""
    batch: int = 512
    """Problems in a batch."""
    learning_rate: float = 1e-3
    """Of Adam, after the warm-up; it falls along a cosine to zero."""
    warmup: int = 50
    """Steps in which the learning rate rises from zero."""
    gradient_norm: float = 1.0
    """Longer gradients are shortened to this: near-infeasible problems make some very long."""
    validation_share: float = 0.1
    """Share of the objects that is kept out of training, to measure the network on."""
    validate_every: int = 100
    """Steps between measurements; a checkpoint is written with each."""
    seed: int = 0
    """Fixes the split of the objects, the first weights and every batch."""

    def __post_init__(self) -> None:
        for name in ("steps", "batch", "validate_every"):
            expect_whole(name, getattr(self, name), least=1)
        for name in ("warmup", "seed"):
            expect_whole(name, getattr(self, name))
        for name in ("learning_rate", "gradient_norm"):
            value = getattr(self, name)
            if not 0.0 < value < math.inf:
                raise TrainingError(f"{name} is {value}; it must be positive and finite")
        if not 0.0 < self.validation_share < 1.0:
            raise TrainingError(
                f"validation_share is {self.validation_share}; it must lie between 0 and 1"
            )


@dataclass(frozen=True)
class TrainingSettings(RunSettings):
    """Train the conditioned network on grasps; a run that was stopped goes on where it was."""

    collocation: float = 0.0
    """Share of the ODE's collocation residual in the loss; the rest is the dual value."""
    network: NetworkConfig = field(default_factory=NetworkConfig)
    """Sizes of the network."""
    sampling: SamplingSettings = field(default_factory=SamplingSettings)
    """Ranges that loads, friction and limits are drawn from."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.0 <= self.collocation <= 1.0:
            raise TrainingError(f"collocation is {self.collocation}; it must lie from 0 to 1")
