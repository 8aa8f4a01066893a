"""What the comparison runs, and the problems that it poses."""

from dataclasses import dataclass, field
from pathlib import Path

from solvers.exceptions import GraspForceError


class QualityStudyError(GraspForceError, ValueError):
    """A comparison that makes no sense, or a folder that holds another one."""


@dataclass(frozen=True)
class QualityStudyPlan:
    """Compare forces that are to have the most quality for their effort."""

    folders: tuple[Path, ...] = ()
    """Folders of meshes beside the test and train splits of random_urdfs, metres."""
    grasps: int = 60
    """Problems of each set: one a grasp."""
    times: tuple[float, ...] = (1.25, 1.5, 2.0, 3.0)
    """Budgets, in multiples of the effort of the least-norm forces."""
    prices: tuple[float, ...] = (0.01, 0.02, 0.05)
    """Newtons of q_lrw that a newton of effort is worth, at the largest of the budgets."""
    batch: int = 4096
    """Problems that are timed together."""
    timed: int = 16
    """Of these, problems that the reference is timed on."""
    rounds: int = 400
    """Of the reference, for each problem and budget."""
    seed: int = 0
    """Of grasps and problems."""
    workers: int = 1
    """Processes."""
    output: Path = field(default=Path("runs/quality_study"))
    """Folder that keeps what is finished; the same command goes on after a kill."""

    def __post_init__(self) -> None:
        for name in ("grasps", "batch", "timed", "rounds", "workers"):
            if getattr(self, name) < 1:
                raise QualityStudyError(f"{name} is {getattr(self, name)}; it must be 1 or more")
        if not self.times or min(self.times) <= 1.0:
            raise QualityStudyError(f"budgets are {self.times} times the least; all must exceed 1")
        if any(price <= 0.0 for price in self.prices):
            raise QualityStudyError(f"prices are {self.prices}; all must be above 0")

    @property
    def sets(self) -> tuple[tuple[str, str], ...]:
        """Object set and split of each, the training's last."""
        folders = [(str(folder), "all") for folder in self.folders]
        return ("random_urdfs", "test"), *folders, ("random_urdfs", "train")
