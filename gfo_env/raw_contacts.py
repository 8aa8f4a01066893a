"""What the physics engine says of the places where hand and object touch."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


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
    links: Indices


def engine_table(rows: Iterable[Iterable[float]], width: int, count: int) -> Array:
    """(count, width) numbers that the engine tells in tuples; half the time of `np.array`."""
    numbers = np.fromiter(chain.from_iterable(rows), np.float64, width * count)
    return numbers.reshape(count, width)


def read_points(points: Sequence[tuple[Any, ...]], bodies: Indices) -> RawContacts:
    """What `getContactPoints` tells of an object and a hand.

    Args:
        points: the object is the first body, the hand the second.
        bodies: number of the hand's link that each of the engine's is part of, see `posture.Tree`.
    """
    rows = [(p[4], *p[5], *p[7], p[9], p[10], *p[11], p[12], *p[13]) for p in points]
    return RawContacts(*_contact_arrays(engine_table(rows, 16, len(rows)), bodies))


@njit(cache=True)
def _contact_arrays(table: Array, bodies: Indices) -> tuple[Array, Array, Array, Indices]:
    """Positions, normals, forces and links of `RawContacts`.

    Args:
        table: (k, 16) the engine's link, position, normal, normal force, and twice a friction force
            with its direction.
        bodies: see `read_points`.
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
