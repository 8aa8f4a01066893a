"""The pose of an object in the hand."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]


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

    def to_object(self, points: Array) -> Array:
        """(..., 3) points of the hand frame, in the object frame."""
        return (points - self.position) @ self.rotation

    def to_hand(self, points: Array) -> Array:
        """(..., 3) points of the object frame, in the hand frame."""
        return points @ self.rotation.T + self.position

    def motion_from(self, start: "Pose") -> tuple[float, float]:
        """Displacement (m) and rotation (rad) from a start to this pose."""
        moved = self.position - start.position
        (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = (start.rotation.T @ self.rotation).tolist()
        # the tangent is exact for small angles, where the cosine alone is not
        sine = math.sqrt((xy - yx) ** 2 + (xz - zx) ** 2 + (yz - zy) ** 2) / 2.0
        cosine = (xx + yy + zz - 1.0) / 2.0
        return math.sqrt(moved @ moved), math.atan2(sine, cosine)


def rotation_matrix(quaternion: Sequence[float]) -> Array:
    """(3, 3) rotation of a quaternion x, y, z, w that is of unit length but for rounding."""
    x, y, z, w = quaternion
    size = math.sqrt(x * x + y * y + z * z + w * w)
    x, y, z, w = x / size, y / size, z / size, w / size
    return np.array(
        [
            [x * x - y * y - z * z + w * w, 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), -x * x + y * y - z * z + w * w, 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), -x * x - y * y + z * z + w * w],
        ]
    )
