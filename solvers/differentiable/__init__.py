"""Gradients of optimal values, of optimal forces and of q_lrw, in torch."""

from .implicit import Optimum, forces_gradients
from .optimum import optimal_forces, optimal_value
from .quality import contact_reaches, quality_estimates, soft_least_reach

__all__ = [
    "Optimum",
    "contact_reaches",
    "forces_gradients",
    "optimal_forces",
    "optimal_value",
    "quality_estimates",
    "soft_least_reach",
]
