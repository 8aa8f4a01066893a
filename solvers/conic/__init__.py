"""Cone programs for Clarabel: the one call of it, and a problem in its form."""

from .grasp import (
    JOINT_SCALE,
    ConicProgram,
    cone_rows,
    force_limits,
    normal_rows,
    torque_rows,
)
from .program import (
    POSITIVE,
    SECOND_ORDER,
    SEMIDEFINITE,
    ZERO,
    Rows,
    maximise,
    solve,
)

__all__ = [
    "JOINT_SCALE",
    "POSITIVE",
    "SECOND_ORDER",
    "SEMIDEFINITE",
    "ZERO",
    "ConicProgram",
    "Rows",
    "cone_rows",
    "force_limits",
    "maximise",
    "normal_rows",
    "solve",
    "torque_rows",
]
