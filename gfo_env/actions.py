"""From an action to the contact forces that it commands."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


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
