"""From a grasp and a load to the fields of the grasp force problem that a solver takes."""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from gfo_env.checks import checked_array
from gfo_env.contacts import Contacts
from gfo_env.exceptions import GeometryError
from gfo_env.hand import HandDescription
from gfo_env.pose import Pose, turned
from solvers.arrays import Array

from .acquisition import Grasp


@dataclass(frozen=True, eq=False)
class ForceLimits:
    """What problems of one hand ask of forces and torques, for so many contacts at most.

    Args:
        torque_min, torque_max: (n_tau,) N·m.
        normal_min, normal_max: (n,) N.
        contact_mask: (n,) all True.
    """

    torque_min: Array
    torque_max: Array
    normal_min: Array
    normal_max: Array
    contact_mask: NDArray[np.bool_]

    @classmethod
    def of(
        cls, hand: HandDescription, contacts: int, preload: float, cap: float, torque_scale: float
    ) -> Self:
        """See `problem_fields`; `contacts` is the largest number of them."""
        limits = torque_scale * np.array(hand.max_torque)
        return cls(
            -limits,
            limits,
            np.full(contacts, preload),
            np.full(contacts, cap),
            np.ones(contacts, dtype=np.bool_),
        )

    def fields(
        self, contacts: Contacts, wrench: Array, torque: Array, friction: float
    ) -> dict[str, Any]:
        """The fields of a `GraspForceProblem`; arrays of these limits are part of them, not copied.

        Args:
            contacts: perhaps none.
            wrench: (..., 6) external wrench, object frame.
            torque: (..., n_tau) external torque.
            friction: coefficient.
        """
        count = len(contacts)
        return {
            "grasp_map": contacts.grasp_map,
            "hand_jacobian": contacts.jacobian,
            "friction": friction * self.contact_mask[:count],
            "torque_min": self.torque_min,
            "torque_max": self.torque_max,
            "external_wrench": wrench,
            "external_torque": torque,
            "normal_min": self.normal_min[:count],
            "normal_max": self.normal_max[:count],
            "contact_mask": self.contact_mask[:count],
        }


def in_object_frame(wrench: Array, pose: Pose) -> Array:
    """(..., 6) wrenches of the hand frame about the centre of mass, in the object frame.

    Raises:
        GeometryError: the wrenches have another last dimension.
    """
    if wrench.shape[-1:] != (6,):
        raise GeometryError(f"wrench must have shape (..., 6), not {wrench.shape}.")
    parts: Array = turned(wrench.reshape(-1, 3), pose.rotation)
    return parts.reshape(wrench.shape)


def carrying_torques(gravity: Array, gravity_map: Array) -> Array:
    """(..., n_tau) joint torques that carry the hand's links under gravity (..., 3), m/s2.

    Args:
        gravity: (..., 3) m/s2.
        gravity_map: (n_tau, 3), see `Posture.gravity_map`.

    Raises:
        GeometryError: an argument has another last dimension.
    """
    if gravity.shape[-1:] != (3,) or gravity_map.shape[1:] != (3,):
        raise GeometryError(
            f"gravity must have shape (..., 3) and gravity_map (n_tau, 3), not {gravity.shape} "
            f"and {gravity_map.shape}."
        )
    torques: Array = times_transposed(gravity.reshape(-1, 3), gravity_map)
    return torques.reshape(*gravity.shape[:-1], -1)


@njit(cache=True, fastmath={"contract"})
def times_transposed(first: Array, second: Array) -> Array:
    """(k, m) `first @ second.T` of (k, 3) and (m, 3); for one row, the bits are those of numpy."""
    result = np.empty((len(first), len(second)))
    for k in range(len(first)):
        x, y, z = first[k]
        for row in range(len(second)):
            result[k, row] = second[row, 0] * x + second[row, 1] * y + second[row, 2] * z
    return result


def problem_fields(
    grasp: Grasp,
    hand: HandDescription,
    wrench: ArrayLike,
    gravity: ArrayLike,
    *,
    friction: float,
    preload: float = 0.0,
    cap: float = np.inf,
    torque_scale: float = 1.0,
) -> dict[str, Any]:
    """The fields of the `GraspForceProblem` of carrying loads with a grasp.

    They are fields and not a problem, because the contacts of a slipping object may be too few for
    one.

    Args:
        grasp: the contacts, perhaps none.
        hand: whose joints must supply the torques.
        wrench: (..., 6) load on the object, hand frame, about the centre of mass: N, N·m. Its
            weight is part of it.
        gravity: (..., 3) m/s2, hand frame: the hand's own links weigh, too.
        friction: coefficient to plan with; a safety factor is already in it.
        preload: N, least normal force of every contact.
        cap: N, largest normal force of every contact.
        torque_scale: factor on the hand's torque limits.

    Raises:
        GeometryError: wrench or gravity have another shape or are not finite.
    """
    load = checked_array("wrench", wrench, (6,), batched=True)
    down = checked_array("gravity", gravity, (3,), batched=True)
    limits = ForceLimits.of(hand, len(grasp.contacts), preload, cap, torque_scale)
    return limits.fields(
        grasp.contacts,
        in_object_frame(load, grasp.pose),
        carrying_torques(down, grasp.gravity_map),
        friction,
    )
