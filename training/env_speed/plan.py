"""How much of the environment to measure, and what can be wrong with that."""

from dataclasses import dataclass
from pathlib import Path

from solvers.exceptions import GraspForceError


class EnvSpeedError(GraspForceError, ValueError):
    """The environment cannot be measured as asked."""


@dataclass(frozen=True)
class SpeedPlan:
    """How much to measure.

    Args:
        seconds: that one measurement lasts, about.
        repeats: of every measurement, in turns; medians count.
        workers: numbers of processes.
        resets: that memory is watched over.
        objects: that these resets go through.
        grasps: held-out ones for the accuracy of q_lrw.
        chunks: of the grasp cache that are made anew.
        seed: of all draws.
        table: grasps to begin episodes with; None for the user's cache.
        held_out_table: likewise for held-out grasps.
        peer_python: interpreter with panda-gym; None to leave that out.

    Raises:
        EnvSpeedError: a number is too small.
    """

    seconds: float = 5.0
    repeats: int = 5
    workers: tuple[int, ...] = (1, 2, 4)
    resets: int = 10_000
    objects: int = 500
    grasps: int = 500
    chunks: int = 4
    seed: int = 0
    table: Path | None = None
    held_out_table: Path | None = None
    peer_python: Path | None = None

    def __post_init__(self) -> None:
        if not self.seconds > 0:
            raise EnvSpeedError(f"seconds is {self.seconds}; it must be positive")
        for name in ("repeats", "resets", "objects", "grasps", "chunks"):
            if getattr(self, name) < 1:
                raise EnvSpeedError(f"{name} is {getattr(self, name)}; it must be 1 or more")
        if not self.workers or min(self.workers) < 1:
            raise EnvSpeedError(f"workers is {self.workers}; name numbers of 1 or more")
        if self.seed < 0:
            raise EnvSpeedError(f"seed is {self.seed}; it must be 0 or more")
