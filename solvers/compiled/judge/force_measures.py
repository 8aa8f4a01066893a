"""The judge's residuals of one set of forces, without its verdict: what a reward is made of."""

from typing import Any

import numpy as np
from numba import njit

from ..arrays import ProblemArrays
from ..cache import digest
from ..constants import MIN_NORM
from .measure import COLUMNS, factor, force_scale, measure_residuals

_WIDTH = len(COLUMNS)


def _entry(sources: str) -> Any:
    @njit(cache=True, error_model="numpy")
    def measure_forces(arrays: Any, forces: Any) -> tuple[float, float, float, float, float]:
        sources  # noqa: B018 - see `cache.digest`
        problem = ProblemArrays(*arrays)
        triangle, scratch, row = np.zeros((6, 6)), np.zeros(6), np.zeros(_WIDTH)
        arm = factor(problem, triangle)
        scale, _ = force_scale(problem, triangle, arm, scratch)
        measure_residuals(problem, MIN_NORM, forces, triangle, arm, 0.0, scratch, row)
        return row[0], row[1], row[2], row[3], scale

    return measure_forces


measure_forces = _entry(digest())
"""Of one problem without a batch dimension: `residuals.equilibrium_residual` N,
`friction_violation` N, `normal_violation` N, `torque_violation` N·m, and `scaling.force_scale` N.
Arguments: the arrays of the problem as a tuple, and forces (3n,) N."""
