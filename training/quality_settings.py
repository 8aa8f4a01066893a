"""Settings of a training run for quality; apart from the trainer, so that they need no torch."""

from dataclasses import dataclass, field
from pathlib import Path

from solvers.quality_network_config import QualityNetworkConfig

from .sampling import SamplingSettings
from .settings import TrainingError


@dataclass(frozen=True)
class QualitySamplingSettings:
    """Ranges that problems of quality are drawn from."""

    budget: tuple[float, float] = (1.1, 6.0)
    """Times the effort of the least-norm forces, log-uniform."""
    priced: float = 0.4
    """Share of the problems in which effort has a price."""
    price: tuple[float, float] = (0.005, 0.1)
    """Newtons of q_lrw that a newton of effort is worth, log-uniform."""
    constraints: SamplingSettings = field(
        default_factory=lambda: SamplingSettings(preload=2.0, torque_scale=(0.2, 1.0))
    )
    """Loads, friction and limits."""


@dataclass(frozen=True)
class QualityTrainingSettings:
    """Train the network for quality on grasps; a run that was stopped goes on where it was."""

    grasps: Path
    """Table of grasps (.npz) from scripts/collect.py."""
    output: Path
    """Folder for the checkpoint, the history and the weights."""
    steps: int = 500
    """Gradient steps, each on a batch of problems that is never seen again."""
    batch: int = 320
    """Grasps in a batch; those that cannot carry their load at all are left out."""
    learning_rate: float = 1e-3
    """Of Adam, after the warm-up; it falls along a cosine to zero."""
    warmup: int = 30
    """Steps in which the learning rate rises from zero."""
    gradient_norm: float = 1.0
    """Longer gradients are shortened to this."""
    validation_share: float = 0.1
    """Share of the objects that is kept out of training, to measure the network on."""
    validate_every: int = 50
    """Steps between measurements; a checkpoint is written with each."""
    seed: int = 0
    """Fixes the split of the objects, the first weights and every batch."""
    network: QualityNetworkConfig = field(default_factory=QualityNetworkConfig)
    """Sizes of the network."""
    sampling: QualitySamplingSettings = field(default_factory=QualitySamplingSettings)
    """Ranges that loads, friction, limits, budgets and prices of effort are drawn from."""

    def __post_init__(self) -> None:
        for name in ("steps", "batch", "validate_every", "learning_rate", "gradient_norm"):
            if getattr(self, name) <= 0:
                raise TrainingError(f"{name} is {getattr(self, name)}; it must be positive")
        if not 0.0 < self.validation_share < 1.0:
            raise TrainingError(
                f"validation_share is {self.validation_share}; it must lie between 0 and 1"
            )
