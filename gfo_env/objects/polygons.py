"""Polygons of a mesh cut into triangles that cover them and nothing else."""

from collections.abc import Iterator, Sequence

import manifold3d
import numpy as np
from numpy.typing import NDArray

from solvers.arrays import Array

Polygons = Sequence[Sequence[int]] | NDArray[np.int64]
"""Indices of the corners of each polygon, in order around it."""


def triangulate(vertices: Array, polygons: Polygons) -> NDArray[np.int64]:
    """Triangles (m, 3) of polygons; these may be hollow, and hardly flat.

    Triangles come first, in their order, then polygons by their number of corners. Those that a
    fan from their first corner covers are cut that way.

    Args:
        vertices: (v, 3).
        polygons: those of fewer than three corners are left out.

    Raises:
        ValueError: there is no such vertex.
    """
    triangles = [np.zeros((0, 3), np.int64)]
    for number, same in _by_number(polygons):
        if same.min() < 0 or same.max() >= len(vertices):
            raise ValueError(f"a face has a corner that is none of the {len(vertices)} vertices")
        triangles.append(same if number == 3 else _cut(vertices, same))
    return np.concatenate(triangles)


def _by_number(polygons: Polygons) -> Iterator[tuple[int, NDArray[np.int64]]]:
    """Numbers of corners from three on, and the polygons (k, n) that have so many."""
    if isinstance(polygons, np.ndarray):
        if len(polygons) and polygons.shape[1] >= 3:
            yield polygons.shape[1], polygons.astype(np.int64)
        return
    numbers = np.fromiter(map(len, polygons), np.int64, len(polygons))
    for number in np.unique(numbers[numbers >= 3]).tolist():
        chosen = np.flatnonzero(numbers == number).tolist()
        yield number, np.array([polygons[k] for k in chosen], dtype=np.int64)


def _cut(vertices: Array, polygons: NDArray[np.int64]) -> NDArray[np.int64]:
    """Triangles of polygons (k, n) of one number of corners."""
    fans = _fans(polygons)
    hollow = _turned(vertices, polygons, fans)
    if polygons.shape[1] == 4:
        # one of the two diagonals of a quadrilateral is inside
        fans[hollow] = _fans(np.roll(polygons[hollow], -1, axis=1))
        return fans.reshape(-1, 3)
    cut = [_ears(vertices, polygon) for polygon in polygons[hollow]]
    return np.concatenate([fans[~hollow].reshape(-1, 3), *cut])


def _fans(polygons: NDArray[np.int64]) -> NDArray[np.int64]:
    """(k, n - 2, 3) triangles from the first corner of polygons (k, n)."""
    first = np.broadcast_to(polygons[:, :1], polygons[:, 2:].shape)
    return np.stack([first, polygons[:, 1:-1], polygons[:, 2:]], axis=2)


def _turned(
    vertices: Array, polygons: NDArray[np.int64], triangles: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Whether a triangle of polygons (k, n) is wound against its polygon; (k,)."""
    with np.errstate(all="ignore"):  # whether vertices are numbers is asked elsewhere
        a, b, c = np.moveaxis(vertices[triangles], 2, 0)
        areas = np.cross(b - a, c - a)
        normals = areas.sum(axis=1)  # twice the polygon's area, however it is cut
        against = np.einsum("kti,ki->kt", areas, normals)
        return np.asarray(against.min(axis=1) < -1e-9 * np.einsum("ki,ki->k", normals, normals))


def _ears(vertices: Array, polygon: NDArray[np.int64]) -> NDArray[np.int64]:
    """Triangles of one polygon (n,), cut in the plane of two coordinates that shows most of it."""
    (fan,) = _fans(polygon[None])
    a, b, c = np.moveaxis(vertices[fan], 1, 0)
    normal = np.cross(b - a, c - a).sum(axis=0)
    axis = int(np.argmax(abs(normal)))
    shown = [(axis + 1) % 3, (axis + 2) % 3]
    order = polygon if normal[axis] > 0 else polygon[::-1]
    triangles = np.asarray(manifold3d.triangulate([vertices[order][:, shown]]), dtype=np.int64)
    return order[triangles] if normal[axis] > 0 else order[triangles][:, ::-1]
