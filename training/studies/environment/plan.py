"""How much of the environment to measure, and what can be wrong with that."""

from dataclasses import dataclass
from pathlib import Path

from solvers.exceptions import GraspForceError


class EnvSpeedError(GraspForceError, ValueError):
    """The environment cannot be measured as asked."""


@dataclass(frozen=True)
class SpeedPlan:
    """How much to measure."""

    seconds: float = 5.0
    """That one measurement lasts, about."""
    repeats: int = 5
    """Of every measurement, in turns; medians count."""
    workers: tuple[int, ...] = (1, 2, 4)
    """Numbers of processes."""
    resets: int = 10_000
    """Resets over which memory is watched."""
    objects: int = 500
    """Objects that these resets go through."""
    grasps: int = 500
    """Held-out grasps for the accuracy of q_lrw."""
    chunks: int = 4
    """Chunks of the grasp cache that are made anew."""
    seed: int = 0
    """Seed of everything that is drawn."""
    table: Path | None = None
    """Grasps to begin with, from scripts/collect.py. Default: the cache, which is filled first."""
    held_out_table: Path | None = None
    """Grasps of held-out objects, likewise."""
    peer_python: Path | None = None
    """Interpreter of an environment with panda-gym, to measure it beside."""

    def check(self) -> None:
        """See that every number can be met.

        Raises:
            EnvSpeedError: if one cannot.
        """
        if not self.seconds > 0:
            raise EnvSpeedError(f"seconds is {self.seconds}; it must be positive")
        for name in ("repeats", "resets", "objects", "grasps", "chunks"):
            if getattr(self, name) < 1:
                raise EnvSpeedError(f"{name} is {getattr(self, name)}; it must be 1 or more")
        if not self.workers or min(self.workers) < 1:
            raise EnvSpeedError(f"workers is {self.workers}; name numbers of 1 or more")
        if self.seed < 0:
            raise EnvSpeedError(f"seed is {self.seed}; it must be 0 or more")
