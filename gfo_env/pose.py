"""The pose of an object in the hand.

What is for compiled code checks nothing, as all compiled code.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import njit
from scipy.spatial.transform import Rotation

from gfo_env.checks import CheckedArrays, Shape, checked_array
from gfo_env.exceptions import GeometryError
from solvers.arrays import Array

_TOLERANCE = 1e-5
"""Of rotations, which may have gone through single precision."""


@dataclass(frozen=True, eq=False)
class Pose(CheckedArrays):
    """Pose of the object frame in the hand frame.

    Args:
        position: (3,) m, the centre of mass.
        rotation: (3, 3), columns are the object's axes.

    Raises:
        GeometryError: an argument has another shape or is not finite, or the rotation is none.
    """

    position: Array
    rotation: Array

    SHAPES: ClassVar[dict[str, Shape]] = {"position": (3,), "rotation": (3, 3)}

    def __post_init__(self) -> None:
        super().__post_init__()
        off = np.abs(self.rotation.T @ self.rotation - np.eye(3)).max()
        if not (off <= _TOLERANCE and np.linalg.det(self.rotation) > 0.0):
            raise GeometryError(
                "rotation must be one: columns of unit length, at right angles, right-handed."
            )

    def quaternion(self) -> Array:
        """(4,) x, y, z, w."""
        return Rotation.from_matrix(self.rotation).as_quat()

    def to_hand(self, points: Array) -> Array:
        """(..., 3) points of the object frame, in the hand frame.

        Raises:
            GeometryError: the points have another shape or are not finite.
        """
        there: Array = checked_array("points", points, (3,), batched=True) @ self.rotation.T
        return there + self.position

    def motion_from(self, start: "Pose") -> tuple[float, float]:
        """Displacement (m) and rotation (rad) from a start to this pose."""
        return motion_between(start.position, start.rotation, self.position, self.rotation)


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
def rotation_of(quaternion: tuple[float, float, float, float], axes: Array) -> Array:
    """(3, 3) rotation of the object frame of a body, for compiled code and loops.

    Args:
        quaternion: x, y, z, w of the body's own frame, of unit length but for rounding.
        axes: (3, 3), columns are the axes of the body's own frame in the object frame.
    """
    x, y, z, w = quaternion
    size = math.sqrt(x * x + y * y + z * z + w * w)
    x, y, z, w = x / size, y / size, z / size, w / size
    body = np.empty((3, 3))
    body[0, 0], body[0, 1] = x * x - y * y - z * z + w * w, 2 * (x * y - z * w)
    body[0, 2], body[1, 0] = 2 * (x * z + y * w), 2 * (x * y + z * w)
    body[1, 1], body[1, 2] = -x * x + y * y - z * z + w * w, 2 * (y * z - x * w)
    body[2, 0], body[2, 1] = 2 * (x * z - y * w), 2 * (y * z + x * w)
    body[2, 2] = -x * x - y * y + z * z + w * w
    return turned(body, axes.T)
