"""Settings of a training run for quality; apart from the trainer, so that they need no torch."""

from dataclasses import dataclass, field

from solvers.max_quality.config import QualityNetworkConfig
from training.problems.quality_sampling import QualitySamplingSettings

from .settings import RunSettings


@dataclass(frozen=True)
class QualityTrainingSettings(RunSettings):
    """Train the network for quality on grasps; a run that was stopped goes on where it was."""

    steps: int = 500
    """Gradient steps, each on a batch of problems that is never seen again."""
    batch: int = 320
    """Grasps in a batch; those that cannot carry their load at all are left out."""
    warmup: int = 30
    """Steps in which the learning rate rises from zero."""
    validate_every: int = 50
    """Steps between measurements; a checkpoint is written with each."""
    network: QualityNetworkConfig = field(default_factory=QualityNetworkConfig)
    """Sizes of the network."""
    sampling: QualitySamplingSettings = field(default_factory=QualitySamplingSettings)
    """Ranges that loads, friction, limits, budgets and prices of effort are drawn from."""
