"""The surface of an object as triangles, and the point of it that is nearest to another."""

from typing import TYPE_CHECKING

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from gfo_env.checks import checked_array
from gfo_env.exceptions import GeometryError
from solvers.arrays import Array

if TYPE_CHECKING:
    import trimesh

_MARGIN = 1e-9
"""Relative; the bound of a box and the distance of a triangle are rounded differently."""


class Surface:
    """The triangles of a mesh, ready for nearest points.

    Args:
        mesh: of the surface, m.

    Attributes:
        triangles: (t, 3, 3) m, corners.
        low, high: (3, t) m, of the boxes around them.

    Raises:
        GeometryError: the mesh has no triangles, or corners that are not finite.
    """

    def __init__(self, mesh: "trimesh.Trimesh") -> None:
        corners = checked_array("triangles", mesh.triangles, ("t", 3, 3))
        if not len(corners):
            raise GeometryError("a mesh without triangles has no surface.")
        self.triangles: Array = np.require(corners, np.float64, ["C", "W"])
        self.low: Array = np.ascontiguousarray(self.triangles.min(axis=1).T)
        self.high: Array = np.ascontiguousarray(self.triangles.max(axis=1).T)

    def nearest(self, points: ArrayLike) -> Array:
        """(k, 3) m: the points of the surface that are nearest to `points` (k, 3).

        Raises:
            GeometryError: the points have another shape or are not finite.
        """
        plain = np.require(checked_array("points", points, ("k", 3)), None, ["C", "W"])
        return nearest_points(plain, self.triangles, self.low, self.high)


@njit(cache=True)
def nearest_points(points: Array, triangles: Array, low: Array, high: Array) -> Array:
    """`Surface.nearest` for compiled code."""
    result, here = np.empty_like(points), np.empty(3)
    bound = np.empty(len(triangles))
    for k in range(len(points)):
        # no triangle is nearer than the box around it
        for t in range(len(triangles)):
            x = max(low[0, t] - points[k, 0], points[k, 0] - high[0, t], 0.0)
            y = max(low[1, t] - points[k, 1], points[k, 1] - high[1, t], 0.0)
            z = max(low[2, t] - points[k, 2], points[k, 2] - high[2, t], 0.0)
            bound[t] = x * x + y * y + z * z
        promising = triangles[np.argmin(bound)]
        limit = (1.0 + _MARGIN) * _nearest_of_triangle(points[k], promising, here)
        # stands where rounding puts a point a digit outside of all boxes and yet on the triangle
        result[k] = here
        best = np.inf
        for t in range(len(triangles)):
            if bound[t] <= limit and bound[t] < best:
                square = _nearest_of_triangle(points[k], triangles[t], here)
                if square < best:
                    best = square
                    result[k] = here
    return result


@njit(cache=True)
def _nearest_of_triangle(point: Array, triangle: Array, out: Array) -> float:
    """Write the nearest point of a triangle; returns the square of its distance.

    By the regions of Ericson, Real-Time Collision Detection (2005), section 5.1.5. Corners may
    coincide: an edge without length, whose d are equal, is left to the other two.
    """
    a, b, c = triangle[0], triangle[1], triangle[2]
    d1 = d2 = d3 = d4 = d5 = d6 = 0.0
    for axis in range(3):
        ab, ac = b[axis] - a[axis], c[axis] - a[axis]
        d1 += ab * (point[axis] - a[axis])
        d2 += ac * (point[axis] - a[axis])
        d3 += ab * (point[axis] - b[axis])
        d4 += ac * (point[axis] - b[axis])
        d5 += ab * (point[axis] - c[axis])
        d6 += ac * (point[axis] - c[axis])
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if d1 <= 0.0 and d2 <= 0.0:
        v, w = 0.0, 0.0
    elif d3 >= 0.0 and d4 <= d3:
        v, w = 1.0, 0.0
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0 and d1 > d3:
        v, w = d1 / (d1 - d3), 0.0
    elif d6 >= 0.0 and d5 <= d6:
        v, w = 0.0, 1.0
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0 and d2 > d6:
        v, w = 0.0, d2 / (d2 - d6)
    elif va <= 0.0 and d4 >= d3 and d5 >= d6:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        v = 1.0 - w
    else:
        total = va + vb + vc
        v, w = vb / total, vc / total
    square = 0.0
    for axis in range(3):
        out[axis] = a[axis] + v * (b[axis] - a[axis]) + w * (c[axis] - a[axis])
        apart = out[axis] - point[axis]
        square += apart * apart
    return float(square)
