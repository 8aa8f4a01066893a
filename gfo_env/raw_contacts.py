"""What the physics engine says of the places where hand and object touch."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RawContacts:
    """Contact points as the physics engine reports them, in the hand frame.

    Args:
        positions: (k, 3) m, on the object's collision surface.
        normals: (k, 3) unit, into the object.
        forces: (k, 3) N, what the hand exerts on the object there.
        links: (k,) index of the hand's link, -1 for the base.
    """

    positions: Array
    normals: Array
    forces: Array
    links: NDArray[np.int64]
