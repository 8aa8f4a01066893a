"""The judge's residuals of one set of forces, without its verdict: what a reward is made of."""

from typing import Any

import numpy as np
from numba import njit

from ..cache import digest
from ..objectives import MIN_NORM
from .measure import COLUMNS, _factor, _measure_forces, _scale

_WIDTH = len(COLUMNS)


def _entry(sources: str) -> Any:
    @njit(cache=True, error_model="numpy")
    def measure_forces(
        grasp_map: Any, hand_jacobian: Any, friction: Any, torque_min: Any, torque_max: Any,
        external_wrench: Any, external_torque: Any, normal_min: Any, normal_max: Any,
        contact_mask: Any, forces: Any,
    ) -> tuple[float, float, float, float, float]:  # fmt: skip
        sources  # noqa: B018 - see `sources.digest`
        problem = (
            grasp_map, hand_jacobian, friction, torque_min, torque_max, external_wrench,
            external_torque, normal_min, normal_max, contact_mask,
        )  # fmt: skip
        triangle, scratch, row = np.zeros((6, 6)), np.zeros(6), np.zeros(_WIDTH)
        arm = _factor(grasp_map, contact_mask, triangle)
        scale, _ = _scale(problem, hand_jacobian, triangle, arm, scratch)
        _measure_forces(problem, MIN_NORM, forces, triangle, arm, 0.0, scratch, row)
        return row[0], row[1], row[2], row[3], scale

    return measure_forces


measure_forces = _entry(digest())
"""Of one problem without a batch dimension: `residuals.equilibrium_residual` N,
`friction_violation` N, `normal_violation` N, `torque_violation` N·m, and `scaling.force_scale` N.
Arguments: the arrays of the problem, then forces (3n,) N."""
