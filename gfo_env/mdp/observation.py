"""The grasp force problem as an observation: its fields, padded and flat in float32, and back.

An observation holds the fields of `solvers.GraspForceProblem` under their names. Matrices are
flattened row by row, because Stable-Baselines3 wants observations of one dimension.
"""

import math
from collections.abc import Mapping
from functools import cache
from itertools import accumulate, islice
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from solvers.arrays import Array

Observation = dict[str, Any]


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


_PROBLEM = tuple(shapes(0, 0))


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
    parts, length = packed_parts(tuple(layout.items()))
    packed = np.zeros(length, dtype=np.float32)
    contacts, joints = layout["friction"][0], layout["torque_min"][0]
    pack_problem(packed, contacts, joints, *[fields[name] for name in _PROBLEM])
    observation = {name: packed[part] for name, part in parts}
    for name in islice(layout, len(_PROBLEM), None):
        observation[name][: len(fields[name])] = fields[name]
    return observation


@cache
def packed_parts(
    layout: tuple[tuple[str, tuple[int, ...]], ...],
) -> tuple[list[tuple[str, slice]], int]:
    """The part of a packed observation that each field has, and how long all are."""
    ends = [0, *accumulate(math.prod(shape) for _, shape in layout)]
    parts = [(name, slice(*ends[k : k + 2])) for k, (name, _) in enumerate(layout)]
    return parts, ends[-1]


@njit(cache=True)
def pack_problem(
    packed: NDArray[np.float32], contacts: int, joints: int, grasp_map: Array, hand_jacobian: Array,
    friction: Array, torque_min: Array, torque_max: Array, external_torque: Array,
    external_wrench: Array, normal_min: Array, normal_max: Array, contact_mask: Array,
) -> None:  # fmt: skip
    """Write the fields of `shapes` one after the other."""
    for row in range(6):
        _put(packed, 3 * contacts * row, grasp_map[row])
    begin = 18 * contacts
    for row in range(len(hand_jacobian)):
        _put(packed, begin + joints * row, hand_jacobian[row])
    begin += 3 * contacts * joints
    _put(packed, begin, friction)
    begin += contacts
    _put(packed, begin, torque_min)
    _put(packed, begin + joints, torque_max)
    _put(packed, begin + 2 * joints, external_torque)
    begin += 3 * joints
    _put(packed, begin, external_wrench)
    begin += 6
    _put(packed, begin, normal_min)
    _put(packed, begin + contacts, normal_max)
    _put(packed, begin + 2 * contacts, contact_mask)


@njit(cache=True)
def _put(packed: NDArray[np.float32], begin: int, field: Array) -> None:
    for k in range(len(field)):
        packed[begin + k] = field[k]


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
