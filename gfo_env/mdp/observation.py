"""The grasp force problem as an observation: its fields, padded and flat in float32, and back.

An observation holds the fields of `solvers.GraspForceProblem` under their names. Matrices are
flattened row by row, because Stable-Baselines3 wants observations of one dimension.
"""

import math
from collections.abc import Mapping, Sequence
from functools import cache
from itertools import accumulate, islice
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gfo_env.exceptions import ObservationError
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


_FEEDBACK = tuple(feedback_shapes(0, 0))


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
    """The float64 fields of an observation, or of a batch of them along the first dimensions.

    Returns:
        fields of the shapes of `shapes`, behind the batch dimensions if there are some;
        `contact_mask` as float64 like the others.

    Raises:
        ObservationError: a key is missing, or what it holds has another shape or is no number.
    """
    arrays = _arrays(observation, _PROBLEM)
    *batch, contacts = arrays["friction"].shape
    layout = shapes(contacts, arrays["torque_min"].shape[-1])
    _check_sizes(arrays, layout, tuple(batch))
    return {name: arrays[name].reshape(*batch, *shape) for name, shape in layout.items()}


def checked_batch(observation: Mapping[str, Any]) -> int | None:
    """How many observations lie along the first dimension; None if it is a single one.

    Raises:
        ObservationError: keys, shapes or numbers that no observation of the environment has.
    """
    names = [name for name in (*_PROBLEM, *_FEEDBACK) if name in _mapping(observation)]
    arrays = _arrays(observation, names)
    *batch, contacts = arrays["friction"].shape
    joints = arrays["torque_min"].shape[-1]
    _check_sizes(arrays, shapes(contacts, joints) | feedback_shapes(contacts, joints), tuple(batch))
    if len(batch) > 1:
        raise ObservationError(
            f"A policy answers one observation, or a batch of them along one dimension; these have "
            f"the batch dimensions {tuple(batch)}: flatten them."
        )
    if not np.isfinite(np.concatenate([array.reshape(-1) for array in arrays.values()])).all():
        wrong = [name for name, array in arrays.items() if not np.isfinite(array).all()]
        raise ObservationError(f"{', '.join(wrong)} of an observation must be finite.")
    least, most, mask = arrays["normal_min"], arrays["normal_max"], arrays["contact_mask"]
    fits = (arrays["friction"] >= 0.0).all() and (least >= 0.0).all() and (least <= most).all()
    fits = fits and (arrays["torque_min"] <= arrays["torque_max"]).all()
    if not (fits and (mask * mask == mask).all()):
        raise ObservationError(
            "The numbers of an observation make no grasp: friction, limits or mask are none. Pass "
            "observations as the environment gives them, not normalised ones."
        )
    return batch[0] if batch else None


def _mapping(observation: Any) -> Mapping[str, Any]:
    if not isinstance(observation, Mapping):
        raise ObservationError(
            f"An observation is a dictionary of arrays, not a {type(observation).__name__}: pass "
            "it as the environment gives it, not flattened."
        )
    return observation


def _arrays(observation: Any, names: Sequence[str]) -> dict[str, Array]:
    """The float64 arrays of these names and of the problem, each of one dimension at least."""
    seen = _mapping(observation)
    if missing := [name for name in _PROBLEM if name not in seen]:
        raise ObservationError(f"An observation has {', '.join(_PROBLEM)}; {missing} are missing.")
    arrays = {}
    for name in names:
        try:
            given = np.asarray(seen[name])
        # arrays of other libraries have their own errors for what numpy cannot take
        except (TypeError, ValueError, RuntimeError) as error:
            raise ObservationError(f"{name} of an observation must be an array: {error}") from error
        if given.ndim == 0 or given.dtype.kind not in "biuf":
            raise ObservationError(
                f"{name} of an observation must be an array of numbers, not of shape {given.shape} "
                f"and {given.dtype}."
            )
        arrays[name] = given.astype(np.float64, copy=False)
    return arrays


def _check_sizes(
    arrays: Mapping[str, Array], layout: Mapping[str, tuple[int, ...]], batch: tuple[int, ...]
) -> None:
    for name, array in arrays.items():
        wanted = (*batch, math.prod(layout[name]))
        if array.shape != wanted:
            raise ObservationError(
                f"{name} of an observation must have shape {wanted}, as friction and torque_min "
                f"say, not {array.shape}."
            )
