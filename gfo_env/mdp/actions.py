"""Between an action and the contact forces that it commands, and the torques that realise them."""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gfo_env.exceptions import EnvironmentSettingsError
from solvers.arrays import Array


def checked_action(action: Any, size: int) -> Array:
    """(size,) float64 of an action, none of it NaN; numbers beyond [-1, 1] stay as they are.

    Raises:
        EnvironmentSettingsError: it has another shape, or holds what is no number.
    """
    try:
        given = np.asarray(action)
        if given.shape == (size,) and given.dtype.kind in "iuf":
            numbers = np.ascontiguousarray(given, dtype=np.float64)
            if not np.isnan(numbers).any():
                return numbers
        found = f"shape {given.shape} of {given.dtype}"
    # arrays of other libraries have their own errors for what cannot become an array of numpy
    except (TypeError, ValueError, RuntimeError) as error:
        raise EnvironmentSettingsError(
            f"An action is {size} numbers, and no {type(action).__name__}: {error}."
        ) from error
    raise EnvironmentSettingsError(
        f"An action is {size} numbers in one dimension, none of them NaN; got {found}."
    )


def largest_force(normal_max: Array) -> Array:
    """(..., 1) N that an action of 1 commands; 1 without contacts, where actions mean nothing.

    Args:
        normal_max: (..., n) N, of an observation: the environment caps every contact by that force.
    """
    most = np.max(normal_max, axis=-1, keepdims=True, initial=0.0)
    return np.where(most > 0.0, most, 1.0)


def action_of(forces: Array, normal_max: Array) -> NDArray[np.float32]:
    """(..., 3n) in [-1, 1]: the action that commands forces, clipped.

    Args:
        forces: (..., 3n) N.
        normal_max: (..., n) N, of the observation that the action answers.
    """
    return np.clip(forces / largest_force(normal_max), -1.0, 1.0).astype(np.float32)


@njit(cache=True)
def commanded_forces(action: Array, contacts: int, max_force: float) -> Array:
    """(3n,) N of n contacts, action times `max_force`, clipped.

    Args:
        action: (m,), m >= 3n; what lies beyond is padding.
        contacts: n.
        max_force: N, what an action of 1 commands.
    """
    forces = np.empty(3 * contacts)
    for k in range(3 * contacts):
        forces[k] = max_force * min(max(action[k], -1.0), 1.0)
    return forces


@njit(cache=True)
def joint_torques(
    forces: Array, jacobian: Array, torque: Array, torque_min: Array, torque_max: Array
) -> Array:
    """(n_tau,) N·m: J_h' f and what carries the links, clipped to the limits.

    Args:
        forces: (3n,) N, in the contact frames.
        jacobian: (3n, n_tau) J_h.
        torque: (n_tau,) N·m that carry the links.
        torque_min: (n_tau,) N·m.
        torque_max: (n_tau,) N·m.
    """
    torques = np.dot(forces, jacobian)  # in the bits of numpy's, by the same BLAS
    for joint in range(len(torques)):
        asked = torques[joint] + torque[joint]
        torques[joint] = min(max(asked, torque_min[joint]), torque_max[joint])
    return torques
