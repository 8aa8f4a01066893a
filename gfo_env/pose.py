"""The pose of an object in the hand."""

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
        turn = start.rotation.T @ self.rotation
        skew = turn - turn.T
        # the tangent is exact for small angles, where the cosine alone is not
        sine = np.sqrt(skew[0, 1] ** 2 + skew[0, 2] ** 2 + skew[1, 2] ** 2) / 2.0
        cosine = (np.trace(turn) - 1.0) / 2.0
        return float(np.sqrt(moved @ moved)), float(np.arctan2(sine, cosine))
