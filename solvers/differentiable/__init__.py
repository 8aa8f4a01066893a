"""Gradients of optimal values, of optimal forces and of q_lrw, in torch."""

from .implicit import Optimum, forces_gradients
from .optimum import optimal_forces, optimal_value
from .quality import contact_supports, quality_estimates, soft_least_support

__all__ = [
    "Optimum",
    "contact_supports",
    "forces_gradients",
    "optimal_forces",
    "optimal_value",
    "quality_estimates",
    "soft_least_support",
]
