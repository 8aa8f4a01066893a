"""q_lrw from the support function of the friction cones: fast, mostly a little too large.

The least reach of the hull of all contacts' wrenches, over unit directions d of the wrench space,
is q_lrw. Any direction gives an upper bound; the search descends from a fixed set of directions,
spread evenly after whitening, because weak directions lie close together. The hull itself
(`quality.lowest_resisted_wrench`) takes milliseconds, and its pyramids of few edges are far too
small.
"""

import math

from numpy.typing import ArrayLike

from gfo_env.checks import checked_arrays, is_number
from gfo_env.exceptions import QualityError
from solvers.quality.directions import weakest_support


def quality_estimate(
    grasp_map: ArrayLike, friction: ArrayLike, normal_forces: ArrayLike, length: float
) -> float:
    """N: an upper bound of q_lrw for the true (round) friction cones.

    Where it is 0, q_lrw is 0. Mostly it is a few per cent too large, at times far more:
    docs/environment.md has the figures against refined hulls.

    Args:
        grasp_map: (6, 3n) G of n >= 0 contacts, object frame; N, m.
        friction: (n,) coefficients.
        normal_forces: (n,) N; contacts that do not push are left out.
        length: m, divisor of torques.

    Raises:
        QualityError: an argument has another shape, is not finite, or below zero where none is.
    """
    matrix, coefficients, forces = checked_arrays(
        {"grasp_map": grasp_map, "friction": friction, "normal_forces": normal_forces},
        {"grasp_map": (6, "3n"), "friction": ("n",), "normal_forces": ("n",)},
        QualityError,
    )
    if (coefficients < 0).any():
        raise QualityError("friction must be >= 0.")
    if not (is_number(length) and 0 < length < math.inf):
        raise QualityError(f"length must be a positive number of metres, not {length!r}.")
    return weakest_support(matrix, coefficients, forces, length)[0]
