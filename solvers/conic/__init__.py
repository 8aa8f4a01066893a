"""Cone programs for Clarabel: the one call of it, and a problem in its form."""

from .grasp import ConicProgram
from .program import (
    JOINT_SCALE,
    POSITIVE,
    SECOND_ORDER,
    SEMIDEFINITE,
    ZERO,
    ConicOutcome,
    Rows,
    force_limits,
    friction_cones,
    maximise,
    solve,
)

__all__ = [
    "JOINT_SCALE",
    "POSITIVE",
    "SECOND_ORDER",
    "SEMIDEFINITE",
    "ZERO",
    "ConicOutcome",
    "ConicProgram",
    "Rows",
    "force_limits",
    "friction_cones",
    "maximise",
    "solve",
]
