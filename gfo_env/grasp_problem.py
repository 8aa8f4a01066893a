"""From a grasp and a load to the fields of the grasp force problem that a solver takes."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .acquisition import Grasp
from .hand import HandDescription

Array = NDArray[np.float64]


def problem_fields(
    grasp: Grasp,
    hand: HandDescription,
    wrench: Array,
    gravity: Array,
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
    """
    contacts = grasp.contacts
    in_object = np.reshape(wrench, (*np.shape(wrench)[:-1], 2, 3)) @ grasp.pose.rotation
    limits = torque_scale * np.array(hand.max_torque)
    count = len(contacts)
    return {
        "grasp_map": contacts.grasp_map,
        "hand_jacobian": contacts.jacobian,
        "friction": np.full(count, friction),
        "torque_min": -limits,
        "torque_max": limits,
        "external_wrench": in_object.reshape(np.shape(wrench)),
        "external_torque": gravity @ grasp.gravity_map.T,
        "normal_min": np.full(count, preload),
        "normal_max": np.full(count, cap),
        "contact_mask": np.ones(count, dtype=np.bool_),
    }
