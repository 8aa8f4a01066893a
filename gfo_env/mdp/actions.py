"""From an action to the contact forces that it commands, and to the torques that realise them."""

import numpy as np
from numba import njit

from solvers.arrays import Array


@njit(cache=True)
def commanded_forces(action: Array, contacts: int, max_force: float) -> tuple[Array, bool]:
    """(3n,) N of n contacts, action times `max_force`, clipped; and whether no entry is NaN.

    Args:
        action: (m,), m >= 3n; what lies beyond is padding.
        contacts: n.
        max_force: N, what an action of 1 commands.
    """
    forces = np.empty(3 * contacts)
    for k in range(3 * contacts):
        forces[k] = max_force * min(max(action[k], -1.0), 1.0)
    return forces, not np.isnan(action).any()


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
