"""The observation space of the environment."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces

from gfo_env.grasps.acquisition import LARGEST_OBJECT

_BOUNDS = {
    "grasp_map": (-LARGEST_OBJECT, LARGEST_OBJECT),
    "friction": (0.0, np.inf),
    "torque_min": (-np.inf, 0.0),
    "torque_max": (0.0, np.inf),
    "normal_min": (0.0, np.inf),
    "normal_max": (0.0, np.inf),
    "contact_mask": (0.0, 1.0),
}


def observation_space(layout: Mapping[str, tuple[int, ...]]) -> spaces.Dict[Any]:
    """One-dimensional boxes, float32, with limits that no observation passes; see the environment.

    They depend on shapes alone and neither on loads nor on a hand's strength: agents are refused by
    what they were not trained on only where they cannot work.

    Args:
        layout: shape of each key, see `observation`.
    """
    boxes: dict[str, spaces.Space[Any]] = {}
    for name, shape in layout.items():
        low, high = _BOUNDS.get(name, (-np.inf, np.inf))
        boxes[name] = spaces.Box(low, high, (math.prod(shape),), np.float32)
    return spaces.Dict(boxes)
