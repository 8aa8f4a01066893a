"""How much of the space that a surface encloses it encloses more than once, or inside out."""

import numpy as np
from numpy.typing import NDArray

from solvers.arrays import Array

_RAYS = 128
"""Rays in each of two directions; what is thinner than a gap between them may escape."""

_AT_ONCE = 20_000
"""Triangles, which bounds the memory."""

_TURN = np.array([[0.8, -0.36, 0.48], [0.6, 0.48, -0.64], [0.0, 0.8, 0.6]])
_SKEW = np.array([[1.0, 0.0, 0.0], [0.0317, 1.0, 0.0], [0.0173, 0.0219, 1.0]])
"""A turn of space, by which no ray runs along the faces that people make."""


def overlap(vertices: Array, faces: NDArray[np.int64]) -> float:
    """Share of the enclosed space that a closed surface does not go round once, outward.

    Measured along parallel rays: where one has entered more often than left, it is inside. Of a
    union of solids that overlap as different bodies, the share is that of the overlap.

    Args:
        vertices: (v, 3).
        faces: (m, 3), each edge of which two neighbours have in opposite directions.
    """
    turned = vertices @ (_TURN @ _SKEW)
    low, high = turned[:, :2].min(axis=0), turned[:, :2].max(axis=0)
    # rays run along z through the points of a grid with whole coordinates
    turned[:, :2] = (turned[:, :2] - low) * (_RAYS / (high - low)) - 0.5
    found = [
        _crossings(turned[faces[start : start + _AT_ONCE]])
        for start in range(0, len(faces), _AT_ONCE)
    ]
    ray, height, sign = (np.concatenate(parts) for parts in zip(*found, strict=True))
    if not len(ray):
        return 0.0
    order = np.lexsort((height, ray))
    ray, height, sign = ray[order], height[order], sign[order]
    # what has been entered and not left, from one crossing to the next; none is left after the last
    inside = np.cumsum(sign)[:-1]
    length = np.where(ray[1:] == ray[:-1], np.diff(height), 0.0)
    enclosed = length[inside != 0].sum()
    return float(length[(inside != 0) & (inside != 1)].sum() / enclosed) if enclosed > 0 else 0.0


def _crossings(triangles: Array) -> tuple[NDArray[np.int64], Array, NDArray[np.int64]]:
    """Where rays cross triangles (m, 3, 3): number of the ray, height, and 1 inward, -1 outward.

    Of the neighbours of an edge exactly one is crossed by a ray that meets the edge.
    """
    x, y, z = np.moveaxis(triangles, 2, 0)
    area = (x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (x[:, 2] - x[:, 0]) * (y[:, 1] - y[:, 0])
    first = np.ceil(y.min(axis=1)).astype(np.int64)
    triangle, row = _spread(first, np.ceil(y.max(axis=1)).astype(np.int64))
    # an edge is met at the same place whichever of its neighbours asks
    ends = np.full((2, len(row)), np.nan)
    for one, other in ((0, 1), (1, 2), (2, 0)):
        lower = np.where(y[:, one] <= y[:, other], one, other)[triangle]
        upper = one + other - lower
        y0, y1 = y[triangle, lower], y[triangle, upper]
        x0, x1 = x[triangle, lower], x[triangle, upper]
        met = (y0 <= row) & (row < y1)
        with np.errstate(all="ignore"):
            at = np.where(met, x0 + (x1 - x0) * ((row - y0) / (y1 - y0)), np.nan)
        ends = np.stack([np.fmin(ends[0], at), np.fmax(ends[1], at)])
    crossed = np.isfinite(ends[0])
    triangle, row, ends = triangle[crossed], row[crossed], ends[:, crossed]
    begin, end = np.ceil(ends).astype(np.int64)
    place, column = _spread(begin, end)
    triangle, row = triangle[place], row[place]
    a, b = np.moveaxis(triangles[triangle, 1:] - triangles[triangle, :1], 1, 0)
    dx, dy = column - x[triangle, 0], row - y[triangle, 0]
    with np.errstate(all="ignore"):
        second = (dx * b[:, 1] - dy * b[:, 0]) / area[triangle]
        third = (a[:, 0] * dy - a[:, 1] * dx) / area[triangle]
        height = z[triangle, 0] + second * a[:, 2] + third * b[:, 2]
    low, high = z[triangle].min(axis=1), z[triangle].max(axis=1)
    height = np.clip(np.where(np.isfinite(height), height, low), low, high)
    # outward normals point against a ray that enters
    return row * (_RAYS + 1) + column, height, np.where(area[triangle] < 0, 1, -1)


def _spread(begin: NDArray[np.int64], end: NDArray[np.int64]) -> tuple[NDArray[np.int64], ...]:
    """Whole numbers from each `begin` up to its `end`, and which of them each belongs to."""
    counts = np.maximum(end - begin, 0)
    owner = np.repeat(np.arange(len(begin)), counts)
    starts = np.cumsum(counts) - counts
    return owner, np.arange(len(owner)) - starts[owner] + begin[owner]
