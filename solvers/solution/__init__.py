"""From candidates to solutions: nearly feasible forces repaired, finished, judged and packed."""

from .finish import finished, nearly_feasible
from .repair import (
    corrected_forces,
    is_balanced,
    is_feasible,
    shrunk_forces,
    tightened,
)
from .solution import Candidate, GraspForceSolution, judge_candidate

__all__ = [
    "Candidate",
    "GraspForceSolution",
    "corrected_forces",
    "finished",
    "is_balanced",
    "is_feasible",
    "judge_candidate",
    "nearly_feasible",
    "shrunk_forces",
    "tightened",
]
