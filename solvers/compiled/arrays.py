"""The arrays of a problem, as the kernels take them."""

from typing import Any, NamedTuple

from numba import njit


class ProblemArrays(NamedTuple):
    """The array fields of `GraspForceProblem`, in its order: of one problem, or of a flat batch."""

    grasp_map: Any
    hand_jacobian: Any
    friction: Any
    torque_min: Any
    torque_max: Any
    external_wrench: Any
    external_torque: Any
    normal_min: Any
    normal_max: Any
    contact_mask: Any


@njit(nogil=True, error_model="numpy", forceinline=True)
def one_of(batch: ProblemArrays, b: int) -> ProblemArrays:
    """Problem b of a batch."""
    return ProblemArrays(
        batch.grasp_map[b],
        batch.hand_jacobian[b],
        batch.friction[b],
        batch.torque_min[b],
        batch.torque_max[b],
        batch.external_wrench[b],
        batch.external_torque[b],
        batch.normal_min[b],
        batch.normal_max[b],
        batch.contact_mask[b],
    )
