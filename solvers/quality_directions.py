"""Directions of the wrench space to begin a search for the weakest one with."""

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri
from scipy.stats import qmc

from .compiled.reach import least_reach
from .problem import GraspForceProblem

Array = NDArray[np.float64]


def spread_directions(count: int) -> Array:
    """(count, 6) unit vectors, evenly from all sides: Sobol points made normal, then unit."""
    points = qmc.Sobol(6, scramble=True, rng=0).random(count)
    normal = ndtri(np.clip(points, 1e-9, 1.0 - 1e-9))
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))


SPREAD = spread_directions(32)
"""(32, 6) directions that searches for the weakest one begin with."""


def weak_directions(problem: GraspForceProblem, normal: Array) -> tuple[float, Array]:
    """The least reach found, N, and eight directions along which contacts reach little.

    The reach is an upper bound of q_lrw, mostly a few per cent too large.

    Args:
        problem: one float64 numpy problem, `max_quality`.
        normal: (n,) N; contacts that do not push are left out.
    """
    found = np.tile(SPREAD[:1], (8, 1))
    least = least_reach(
        np.ascontiguousarray(problem.grasp_map),
        np.ascontiguousarray(problem.friction),
        np.ascontiguousarray(normal),
        float(problem.characteristic_length),
        SPREAD,
        found,
    )
    return float(least), found


def estimated_quality(problem: GraspForceProblem, normal: Array) -> float:
    """N: an upper bound of q_lrw for the true (round) friction cones; see `weak_directions`."""
    return weak_directions(problem, normal)[0]
