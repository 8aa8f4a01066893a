"""The observation space of the environment."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces

from gfo_env.grasps.acquisition import LARGEST_OBJECT
from gfo_env.hand import HandDescription
from solvers.arrays import Array

from .loads import LoadSettings


def observation_space(
    layout: Mapping[str, tuple[int, ...]],
    hand: HandDescription,
    loads: LoadSettings,
    max_force: float,
    torque_scale: float,
) -> spaces.Dict[Any]:
    """One-dimensional boxes, float32, with limits that no observation passes; see the environment.

    Args:
        layout: shape of each key, see `observation`.
        hand: that holds.
        loads: what loads are drawn from.
        max_force: N, cap of normal forces.
        torque_scale: highest factor on the hand's torque limits.
    """
    strongest = np.array(hand.max_torque)
    torque = torque_scale * strongest
    load = max(loads.largest_weight + loads.push, loads.twist)
    bounds: dict[str, tuple[float | Array, float | Array]] = {
        "grasp_map": (-LARGEST_OBJECT, LARGEST_OBJECT),
        "hand_jacobian": (-LARGEST_OBJECT, LARGEST_OBJECT),
        "friction": (0.0, loads.highest_friction),
        "torque_min": (-torque, 0.0),
        "torque_max": (0.0, torque),
        "external_torque": (-strongest, strongest),
        "external_wrench": (-load, load),
        "normal_min": (0.0, max_force),
        "normal_max": (0.0, max_force),
        "contact_mask": (0.0, 1.0),
    }
    boxes: dict[str, spaces.Space[Any]] = {}
    for name, shape in layout.items():
        # what a hand feels has no limit that can be told
        limits = bounds.get(name, (-np.inf, np.inf))
        low, high = (np.full(math.prod(shape), limit, np.float32) for limit in limits)
        boxes[name] = spaces.Box(low, high, dtype=np.float32)
    return spaces.Dict(boxes)
