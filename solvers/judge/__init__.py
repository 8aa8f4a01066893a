"""The independent verdict on any answer, and the residuals that rewards are made of."""

from .force_measures import ForceResiduals, force_residuals
from .verdict import (
    EQUILIBRIUM_TOLERANCE,
    FARKAS_TOLERANCE,
    GAP_TOLERANCE,
    LARGEST_NUMBER,
    LOAD_SHARE,
    NEGLIGIBLE,
    Status,
    Verdict,
    judge,
    judge_flat,
)

__all__ = [
    "EQUILIBRIUM_TOLERANCE",
    "FARKAS_TOLERANCE",
    "GAP_TOLERANCE",
    "LARGEST_NUMBER",
    "LOAD_SHARE",
    "NEGLIGIBLE",
    "ForceResiduals",
    "Status",
    "Verdict",
    "force_residuals",
    "judge",
    "judge_flat",
]
