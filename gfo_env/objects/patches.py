"""The surface of a mesh as flat convex patches, on which a contact can move."""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from solvers.arrays import Array

_CONVEX = 1e-4
"""Relative area by which a convex hull may differ from its triangles and still count as filled."""

_FLAT = 1e-6
"""m: corners of joined triangles lie this close to one plane."""

_NARROWEST = 1e-4
"""m: patches narrower than this are no place for a finger, and too thin to compute with."""

_SHORTEST = 1e-5
"""m: of two corners closer than this one is left out; the direction between them is noise."""


@dataclass(frozen=True, eq=False)
class Patch:
    """A flat convex piece of a surface.

    Args:
        corners: (k, 3) m, in order around the patch, counterclockwise seen from outside.
        normal: (3,) unit, into the object.
    """

    corners: Array
    normal: Array


class Patches:
    """A mesh cut into flat convex patches.

    Coplanar neighbouring triangles are joined as long as their union stays convex; slivers
    narrower than 0.1 mm are left out.

    Args:
        mesh: watertight, object frame, m.
    """

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        groups: list[list[int]] = []
        coplanar = [list(facet) for facet in mesh.facets]
        alone = np.setdiff1d(np.arange(len(mesh.faces)), np.concatenate([*coplanar, [-1]]))
        for facet in [*coplanar, *([int(face)] for face in alone)]:
            groups += _convex_groups(mesh, facet)
        self.patches = tuple(
            patch for group in groups if (patch := _patch(mesh, group)) is not None
        )

    def __len__(self) -> int:
        return len(self.patches)

    def __getitem__(self, index: int) -> Patch:
        return self.patches[index]

    @cached_property
    def _fans(self) -> tuple[Array, NDArray[np.int64]]:
        """Triangles of all patches (m, 3, 3), and the patch of each (m,)."""
        fans, owner = [], []
        for index, patch in enumerate(self.patches):
            first, *others = patch.corners
            fans += [(first, second, third) for second, third in pairwise(others)]
            owner += [index] * (len(others) - 1)
        return np.array(fans), np.array(owner)

    def near(self, point: Array, radius: float) -> dict[int, Array]:
        """Patches within `radius` [m] of a point (3,), each with its closest point (3,)."""
        fans, owner = self._fans
        closest = trimesh.triangles.closest_point(fans, np.repeat(point[None], len(fans), 0))
        distance = np.linalg.norm(closest - point, axis=1)
        found: dict[int, Array] = {}
        for triangle in np.argsort(distance, kind="stable"):
            if distance[triangle] > radius:
                break
            found.setdefault(int(owner[triangle]), closest[triangle])
        return found


def _convex_groups(mesh: trimesh.Trimesh, facet: list[int]) -> list[list[int]]:
    """Triangles of one plane in groups, each with a convex union."""
    if len(facet) == 1 or _is_convex(mesh, facet):
        return [facet]
    inside = set(facet)
    pairs = [pair for pair in mesh.face_adjacency.tolist() if inside.issuperset(pair)]
    group = {face: [face] for face in facet}
    merged = True
    while merged:
        merged = False
        for first, second in pairs:
            one, other = group[first], group[second]
            if one is not other and _is_convex(mesh, one + other):
                for face in other:
                    group[face] = one
                one += other
                merged = True
    return list({id(members): members for members in group.values()}.values())


def _is_convex(mesh: trimesh.Trimesh, faces: list[int]) -> bool:
    area = float(mesh.area_faces[faces].sum())
    plane = _plane(mesh, faces)
    if plane is None or np.ptp(plane.off) > _FLAT:
        return False
    # a hull smaller than its triangles: they are folded, not flat
    return bool(abs(plane.hull.volume - area) <= _CONVEX * area)


def _patch(mesh: trimesh.Trimesh, faces: list[int]) -> Patch | None:
    """The union of triangles as a patch; None if it is too narrow for a finger."""
    plane = _plane(mesh, faces)
    if plane is None:
        return None
    hull = plane.hull
    width = -(hull.equations[:, :2] @ hull.points.T + hull.equations[:, 2:]).min(axis=1)
    if width.min() < _NARROWEST:
        return None
    flat = plane.corners - (plane.off - plane.off.mean())[:, None] * plane.normal
    ring = flat[hull.vertices]
    ring = ring[np.linalg.norm(ring - np.roll(ring, 1, axis=0), axis=1) > _SHORTEST]
    return Patch(ring, -plane.normal) if len(ring) >= 3 else None


@dataclass(frozen=True, eq=False)
class _Plane:
    """Corners (k, 3) of triangles, their plane's outward normal, and their distances from it (k,).

    The hull is that of the corners in the plane, counterclockwise seen from outside.
    """

    corners: Array
    normal: Array
    off: Array
    hull: ConvexHull


def _plane(mesh: trimesh.Trimesh, faces: list[int]) -> _Plane | None:
    corners = np.asarray(mesh.vertices[np.unique(mesh.faces[faces])])
    largest = faces[int(np.argmax(mesh.area_faces[faces]))]
    origin, second, _ = mesh.triangles[largest]
    normal = np.asarray(mesh.face_normals[largest])
    if not normal.any():  # two corners of every triangle are in one place
        return None
    first = (second - origin) / np.linalg.norm(second - origin)
    axes = np.stack([first, np.cross(normal, first)], axis=1)
    try:
        hull = ConvexHull((corners - origin) @ axes)
    except QhullError:  # corners on a line
        return None
    return _Plane(corners, normal, (corners - origin) @ normal, hull)
