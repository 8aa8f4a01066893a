"""What the physics engine says of the places where hand and object touch."""

import struct
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import njit

from gfo_env.checks import CheckedArrays, Shape
from solvers.arrays import Array, Indices


@dataclass(frozen=True, eq=False)
class RawContacts(CheckedArrays):
    """Contact points as the physics engine reports them, in the hand frame.

    Args:
        positions: (k, 3) m, on the object's collision surface.
        normals: (k, 3) unit, into the object.
        forces: (k, 3) N, what the hand exerts on the object there.
        links: (k,) index of the hand's link, -1 for the base.

    Raises:
        GeometryError: an argument has another shape or is not finite.
    """

    positions: Array
    normals: Array
    forces: Array
    links: Indices

    SHAPES: ClassVar[dict[str, Shape]] = {
        "positions": ("k", 3),
        "normals": ("k", 3),
        "forces": ("k", 3),
        "links": ("k",),
    }
    NUMBERS: ClassVar[tuple[str, ...]] = ("links",)


POINT_NUMBERS = 16
"""Of a contact point in a table, see `contact_arrays`."""


def number_table(numbers: list[float], width: int) -> Array:
    """(k, width) the numbers row by row; a third of the time of `np.array`."""
    row = np.empty(len(numbers))
    struct.pack_into(f"{len(numbers)}d", row.data, 0, *numbers)
    return row.reshape(-1, width)


@njit(cache=True)
def contact_arrays(table: Array, bodies: Indices) -> tuple[Array, Array, Array, Indices]:
    """Positions, normals, forces and links of `RawContacts`.

    Args:
        table: (k, 16) the engine's link, position, normal, normal force, and twice a friction force
            with its direction.
        bodies: number of the hand's link that each of the engine's is part of, see `posture.Tree`.
    """
    count = len(table)
    positions, normals = table[:, 1:4].copy(), table[:, 4:7].copy()
    forces, links = np.empty((count, 3)), np.empty(count, np.int64)
    for k in range(count):
        links[k] = bodies[int(table[k, 0])]
        for axis in range(3):
            # the engine reports friction as it acts on the second body, the hand
            force = normals[k, axis] * table[k, 7] - table[k, 8] * table[k, 9 + axis]
            forces[k, axis] = force - table[k, 12] * table[k, 13 + axis]
    return positions, normals, forces, links
