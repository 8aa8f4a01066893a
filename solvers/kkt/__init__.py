"""The KKT conditions as an ODE: of any cone program, of a problem's multipliers, and its ansatz.

The flow of multipliers and the ansatz are imported by file.
"""

from .cone_program import (
    OBJECTIVE_WEIGHT,
    Cone,
    ConeProgram,
    canonical_multipliers,
    grasp_multipliers,
    grasp_program,
    kkt_field,
    linear_program,
    project_dual_cone,
)

__all__ = [
    "OBJECTIVE_WEIGHT",
    "Cone",
    "ConeProgram",
    "canonical_multipliers",
    "grasp_multipliers",
    "grasp_program",
    "kkt_field",
    "linear_program",
    "project_dual_cone",
]
