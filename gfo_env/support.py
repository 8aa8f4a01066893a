"""q_lrw from the support function of the friction cones: fast, mostly a little too large.

The least reach of the hull of all contacts' wrenches, over unit directions d of the wrench space,
is q_lrw. Any direction gives an upper bound; the search descends from a fixed set of directions,
spread evenly after whitening, because weak directions lie close together. The hull itself
(`quality.lowest_resisted_wrench`) takes milliseconds, and its pyramids of few edges are far too
small.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri
from scipy.stats import qmc

from solvers.compiled.reach import least_reach

Array = NDArray[np.float64]

_STARTS = 32


def _spread_directions(count: int) -> Array:
    """(count, 6) unit vectors, evenly from all sides: Sobol points made normal, then unit."""
    points = qmc.Sobol(6, scramble=True, rng=0).random(count)
    normal = ndtri(np.clip(points, 1e-9, 1.0 - 1e-9))
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))


SPREAD = _spread_directions(_STARTS)
"""(32, 6) unit directions that the search begins with."""


def quality_estimate(
    grasp_map: Array, friction: Array, normal_forces: Array, length: float
) -> float:
    """N: an upper bound of q_lrw for the true (round) friction cones.

    Where it is 0, q_lrw is 0. Mostly it is a few per cent too large, at times far more:
    docs/environment.md has the figures against refined hulls.

    Args:
        grasp_map: (6, 3n) G of n >= 0 contacts, object frame; N, m.
        friction: (n,) coefficients.
        normal_forces: (n,) N; contacts that do not push are left out.
        length: m, divisor of torques.
    """
    return float(
        least_reach(np.ascontiguousarray(grasp_map), friction, normal_forces, length, SPREAD)
    )
