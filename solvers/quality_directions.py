"""Directions of the wrench space to begin a search for the weakest one with."""

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .compiled.reach import least_reach, least_reaches
from .problem import GraspForceProblem

Array = NDArray[np.float64]


@cache
def spread_directions(count: int = 32) -> Array:
    """(count, 6) unit vectors, evenly from all sides: Sobol points made normal, then unit.

    Made once for each count, and shared: not to be written to.
    """
    # a second to load, for arrays that few of those who import this module ask for
    from scipy.special import ndtri
    from scipy.stats import qmc

    points = qmc.Sobol(6, scramble=True, rng=0).random(count)
    normal = ndtri(np.clip(points, 1e-9, 1.0 - 1e-9))
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))


def weak_directions(problem: GraspForceProblem, normal: Array) -> tuple[float, Array]:
    """The least reach found, N, and eight directions along which contacts reach little.

    The reach is an upper bound of q_lrw, mostly a few per cent too large.

    Args:
        problem: one float64 numpy problem, `max_quality`.
        normal: (n,) N; contacts that do not push are left out.
    """
    starts = spread_directions()
    found = np.tile(starts[:1], (8, 1))
    least = least_reach(
        np.ascontiguousarray(problem.grasp_map),
        np.ascontiguousarray(problem.friction),
        np.ascontiguousarray(normal),
        float(problem.characteristic_length),
        starts,
        found,
    )
    return float(least), found


def weakest_directions(
    problem: GraspForceProblem, normal: Array, starts: Array | None = None
) -> tuple[Array, Array]:
    """`weak_directions` of a batch: (B,) N and (B, 8, 6).

    Args:
        problem: flat float64 numpy problems, `max_quality`.
        normal: (B, n) N.
        starts: (8k, 6) unit directions that the searches begin with; `spread_directions()` by
            default.
    """
    spread = spread_directions()
    found = np.tile(spread[:8], (len(problem), 1, 1))
    values = np.empty(len(problem))
    fields = (
        problem.grasp_map,
        problem.friction,
        np.where(problem.contact_mask, normal, 0.0),
        problem.characteristic_length,
    )
    ready = [np.require(array, np.float64, requirements=["C", "W"]) for array in fields]
    least_reaches(*ready, spread if starts is None else starts, found, values)
    return values, found


def unit_wrenches(problem: GraspForceProblem) -> Any:
    """(B, n, 6, 3) wrenches of unit forces, torques over the characteristic length.

    Args:
        problem: `max_quality` problems with one batch dimension, numpy or torch.
    """
    xp = problem.xp
    batch, n = problem.friction.shape
    torques = problem.grasp_map[:, 3:] / problem.characteristic_length[:, None, None]
    rows = xp.concat([problem.grasp_map[:, :3], torques], axis=1)
    return xp.permute_dims(xp.reshape(rows, (batch, 6, n, 3)), (0, 2, 1, 3))
