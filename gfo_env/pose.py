"""The pose of an object in the hand."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.spatial.transform import Rotation

from solvers.arrays import Array


@dataclass(frozen=True, eq=False)
class Pose:
    """Pose of the object frame in the hand frame.

    Args:
        position: (3,) m, the centre of mass.
        rotation: (3, 3), columns are the object's axes.
    """

    position: Array
    rotation: Array

    def quaternion(self) -> Array:
        """(4,) x, y, z, w."""
        return Rotation.from_matrix(self.rotation).as_quat()

    def to_hand(self, points: Array) -> Array:
        """(..., 3) points of the object frame, in the hand frame."""
        return points @ self.rotation.T + self.position

    def motion_from(self, start: "Pose") -> tuple[float, float]:
        """Displacement (m) and rotation (rad) from a start to this pose."""
        return motion_between(start.position, start.rotation, self.position, self.rotation)


def rotation_of(quaternion: Sequence[float], axes: Array) -> Array:
    """(3, 3) rotation of the object frame of a body.

    Args:
        quaternion: x, y, z, w of the body's own frame, of unit length but for rounding.
        axes: (3, 3), columns are the axes of the body's own frame in the object frame.
    """
    x, y, z, w = quaternion
    return _rotation(x, y, z, w, axes)


@njit(cache=True, fastmath={"contract"})
def turned(vectors: Array, rotation: Array) -> Array:
    """(k, 3) `vectors @ rotation`, for compiled code; the bits are those of numpy."""
    result = np.empty((len(vectors), 3))
    for k in range(len(vectors)):
        for column in range(3):
            total = 0.0
            for axis in range(3):
                total += vectors[k, axis] * rotation[axis, column]
            result[k, column] = total
    return result


@njit(cache=True)
def motion_between(
    old_position: Array, old_rotation: Array, position: Array, rotation: Array
) -> tuple[float, float]:
    """`Pose.motion_from` for compiled code."""
    square = 0.0
    for axis in range(3):
        moved = position[axis] - old_position[axis]
        square += moved * moved
    between = turned(old_rotation.T, rotation)
    # the tangent is exact for small angles, where the cosine alone is not
    xy, xz = between[0, 1] - between[1, 0], between[0, 2] - between[2, 0]
    yz = between[1, 2] - between[2, 1]
    sine = math.sqrt(xy * xy + xz * xz + yz * yz) / 2.0
    cosine = (between[0, 0] + between[1, 1] + between[2, 2] - 1.0) / 2.0
    return math.sqrt(square), math.atan2(sine, cosine)


@njit(cache=True)
def _rotation(x: float, y: float, z: float, w: float, axes: Array) -> Array:
    size = math.sqrt(x * x + y * y + z * z + w * w)
    x, y, z, w = x / size, y / size, z / size, w / size
    body = np.empty((3, 3))
    body[0, 0], body[0, 1] = x * x - y * y - z * z + w * w, 2 * (x * y - z * w)
    body[0, 2], body[1, 0] = 2 * (x * z + y * w), 2 * (x * y + z * w)
    body[1, 1], body[1, 2] = -x * x + y * y - z * z + w * w, 2 * (y * z - x * w)
    body[2, 0], body[2, 1] = 2 * (x * z - y * w), 2 * (y * z + x * w)
    body[2, 2] = -x * x - y * y + z * z + w * w
    return turned(body, axes.T)
