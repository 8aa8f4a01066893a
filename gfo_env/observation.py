"""The grasp force problem as an observation: its fields, padded and flat in float32, and back.

An observation holds the fields of `solvers.GraspForceProblem` under their names. Matrices are
flattened row by row, because Stable-Baselines3 wants observations of one dimension.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solvers.scaling import balance_rows

Array = NDArray[np.float64]
Observation = dict[str, Any]

RANK_TOLERANCE = 1e-4
"""A grasp map whose singular values (torque rows over their moment arm) fall below this ratio of
the largest cannot balance every load: some would take forces ten thousand times their size."""


def shapes(max_contacts: int, joints: int) -> dict[str, tuple[int, ...]]:
    """Shape of each field with this many contacts and joints, before it is flattened."""
    n = max_contacts
    return {
        "grasp_map": (6, 3 * n),
        "hand_jacobian": (3 * n, joints),
        "friction": (n,),
        "torque_min": (joints,),
        "torque_max": (joints,),
        "external_torque": (joints,),
        "external_wrench": (6,),
        "normal_min": (n,),
        "normal_max": (n,),
        "contact_mask": (n,),
    }


def feedback_shapes(max_contacts: int, joints: int) -> dict[str, tuple[int, ...]]:
    """Shape of what a hand can feel, which observations of unannounced loads add."""
    return {
        "joint_positions": (joints,),
        "joint_velocities": (joints,),
        "contact_forces": (3 * max_contacts,),
        "object_velocity": (6,),
    }


def pack(fields: Mapping[str, Array], layout: Mapping[str, tuple[int, ...]]) -> Observation:
    """The observation of these fields; padding contacts are zero in every field.

    Args:
        fields: by name, their leading parts in the shapes of the layout.
        layout: `shapes`, with `feedback_shapes` perhaps.
    """
    observation = {}
    for name, shape in layout.items():
        padded, field = np.zeros(shape, dtype=np.float32), fields[name]
        if len(shape) == 1:
            padded[: len(field)] = field
        else:
            padded[: field.shape[0], : field.shape[1]] = field
        observation[name] = padded.reshape(-1)
    return observation


def unpack(observation: Mapping[str, Any]) -> dict[str, Any]:
    """The float64 fields of an observation, or of a batch of them along the first dimension.

    Returns:
        fields of the shapes of `shapes`, behind the batch dimension if there is one; `contact_mask`
        as float64 like the others.
    """
    friction, limits = np.asarray(observation["friction"]), np.asarray(observation["torque_min"])
    batch = friction.shape[:-1]
    return {
        name: np.asarray(observation[name], dtype=np.float64).reshape(*batch, *shape)
        for name, shape in shapes(friction.shape[-1], limits.shape[-1]).items()
    }


def can_balance(grasp_map: Array) -> NDArray[np.bool_]:
    """(...,) whether forces at the contacts, friction ignored, can balance every load.

    Args:
        grasp_map: (..., 6, 3n), padding included or not.
    """
    if grasp_map.shape[-1] < 6:
        return np.zeros(grasp_map.shape[:-2], dtype=np.bool_)
    singular = np.linalg.svd(balance_rows(np, grasp_map), compute_uv=False)
    full: NDArray[np.bool_] = singular[..., -1] > RANK_TOLERANCE * singular[..., 0]
    return full
