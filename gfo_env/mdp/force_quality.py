"""How commanded forces do on the problem that they answer, in one compiled call."""

from collections.abc import Callable, Mapping

import numpy as np
from numba import njit

from solvers.arrays import Array
from solvers.compiled.cache import digest
from solvers.compiled.judge.force_measures import measure_forces
from solvers.compiled.quality.support import least_support
from solvers.judge import ForceResiduals
from solvers.problem import ARRAY_FIELDS
from solvers.quality.directions import spread_directions


def residuals_and_quality(
    fields: Mapping[str, Array], forces: Array, length: float
) -> tuple[ForceResiduals, float]:
    """The residuals of forces, and the estimate of q_lrw of the normal forces among them.

    Args:
        fields: array fields of a problem that forces can balance under every load.
        forces: (3n,) N.
        length: m, divisor of torques.
    """
    arrays = tuple(fields[name] for name in ARRAY_FIELDS)
    residuals, quality = _measure(arrays, forces, length, spread_directions())
    return ForceResiduals(*residuals), quality


def _entry(sources: str) -> Callable[..., tuple[tuple[float, ...], float]]:
    @njit(cache=True)
    def residuals_and_quality(
        arrays: tuple[Array, ...], forces: Array, length: float, starts: Array
    ) -> tuple[tuple[float, ...], float]:
        sources  # noqa: B018 - see `cache.digest`
        grasp_map, _, friction = arrays[:3]
        weakest = np.empty((8, 6))
        estimate = least_support(grasp_map, friction, forces[2::3], length, starts, weakest)
        return measure_forces(arrays, forces), estimate

    return residuals_and_quality


_measure = _entry(digest())
