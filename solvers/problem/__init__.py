"""What is asked: the fields of a problem, their checks, scales, residuals and canonical form.

`residuals` may be imported as a module, where its functions are named like methods.
"""

from .canonical_form import CanonicalProblem, canonical
from .definition import MAX_QUALITY, OBJECTIVES, GraspForceProblem, as_problem
from .fields import ARRAY_FIELDS, CORE_NDIM
from .inwards import moved_inwards
from .multipliers import Multipliers, as_multipliers, check_multipliers
from .residuals import (
    apply,
    apply_transposed,
    friction_violation,
    joint_torques,
    needs_no_force,
    normal_violation,
    objective_value,
    per_contact,
    tangential_size,
    torque_violation,
)
from .scaling import balance_rows, balanced_wrench, force_scale, least_force, moment_arm

__all__ = [
    "ARRAY_FIELDS",
    "CORE_NDIM",
    "MAX_QUALITY",
    "OBJECTIVES",
    "CanonicalProblem",
    "GraspForceProblem",
    "Multipliers",
    "apply",
    "apply_transposed",
    "as_multipliers",
    "as_problem",
    "balance_rows",
    "balanced_wrench",
    "canonical",
    "check_multipliers",
    "force_scale",
    "friction_violation",
    "joint_torques",
    "least_force",
    "moment_arm",
    "moved_inwards",
    "needs_no_force",
    "normal_violation",
    "objective_value",
    "per_contact",
    "tangential_size",
    "torque_violation",
]
