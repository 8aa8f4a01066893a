"""Directions of the wrench space to begin a search for the weakest one with."""

from functools import cache
from typing import Any

import numpy as np

from solvers.arguments import plain_array
from solvers.arrays import Array
from solvers.compiled.quality.support import least_support, least_supports
from solvers.problem import GraspForceProblem, as_problem


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


def weakest_support(
    grasp_map: Array, friction: Array, normal: Array, length: float
) -> tuple[float, Array]:
    """The least reach found, N, and (8, 6) directions along which contacts reach little.

    The reach is an upper bound of q_lrw, mostly a few per cent too large. Where fewer than three
    contacts push there are no directions, but zeros.

    Args:
        grasp_map: (6, 3n) N, m.
        friction: (n,) coefficients.
        normal: (n,) N; contacts that do not push are left out.
        length: m, divisor of torques.

    Raises:
        ProblemError: for arrays of other shapes; (n,) is that of the friction.
    """
    found = np.zeros((8, 6))
    contacts = np.size(friction)
    ready = [
        plain_array("grasp_map", grasp_map, (6, 3 * contacts)),
        plain_array("friction", friction, (contacts,)),
        plain_array("normal", normal, (contacts,)),
    ]
    return float(least_support(*ready, float(length), spread_directions(), found)), found


def weak_directions(problem: GraspForceProblem, normal: Array) -> tuple[float, Array]:
    """`weakest_support` of a problem, with some directions in any case.

    Args:
        problem: one float64 numpy problem, `max_quality`.
        normal: (n,) N; contacts that do not push are left out.
    """
    least, found = weakest_support(
        problem.grasp_map, problem.friction, normal, problem.characteristic_length
    )
    # along any direction contacts reach as little, where fewer than three push
    return least, found if found.any() else np.tile(spread_directions()[:1], (8, 1))


def weakest_directions(
    problem: GraspForceProblem, normal: Array, starts: Array | None = None
) -> tuple[Array, Array]:
    """`weak_directions` of a batch: (B,) N and (B, 8, 6).

    Args:
        problem: flat float64 numpy problems, `max_quality`.
        normal: (B, n) N.
        starts: (8k, 6) unit directions that the searches begin with; `spread_directions()` by
            default.

    Raises:
        ProblemError: for a problem that is not flat, or arrays of other shapes.
    """
    grasp_map, _, friction, *_ = as_problem(problem).plain_arrays(1)
    count, contacts = friction.shape
    normal = plain_array("normal", normal, (count, contacts))
    spread = spread_directions()
    if starts is None:
        starts = spread
    wanted = max(8 * (np.shape(starts)[0] // 8), 8) if np.ndim(starts) == 2 else 8
    starts = plain_array("starts", starts, (wanted, 6))
    found = np.tile(spread[:8], (count, 1, 1))
    values = np.empty(count)
    pressing = np.where(problem.contact_mask, normal, 0.0)
    length = plain_array("characteristic_length", problem.characteristic_length, (count,))
    least_supports(grasp_map, friction, pressing, length, starts, found, values)
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
