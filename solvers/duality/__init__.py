"""What multipliers prove: bounds, infeasibility, and the friction cones behind both."""

from .bounds import FORCE_HORIZON, contact_duals, dual_bound, farkas_value, usable
from .cones import cone_slope, in_metric, project_cones, projection_jacobian
from .recession import given_torques, recession_direction, relaxed

__all__ = [
    "FORCE_HORIZON",
    "cone_slope",
    "contact_duals",
    "dual_bound",
    "farkas_value",
    "given_torques",
    "in_metric",
    "project_cones",
    "projection_jacobian",
    "recession_direction",
    "relaxed",
    "usable",
]
