"""The surface of a mesh as flat convex patches, on which a contact can move."""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import manifold3d
import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from solvers.arrays import Array

from .winding import outward

_CONVEX = 1e-4
"""Relative area by which a convex hull may differ from its triangles and still count as filled."""

_FLAT = 1e-6
"""m: corners of joined triangles lie this close to one plane."""

_MANY = 500
"""Coplanar triangles from which on they are joined by way of their outline, which is quicker; where
they only look coplanar, because they are small, they are not joined."""

_SMALL = 1e-6
"""m2: triangles of one plane that have less in all are not joined: a finger feels no difference,
and a finely meshed curve has a hundred thousand such pairs."""

_UNIT = 1e-4
"""m: of the coordinates of outlines, which are rounded to 1e-8 units."""

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

    Coplanar neighbouring triangles are joined as long as their union stays convex, save those of
    finely meshed curves; slivers narrower than 0.1 mm are left out.

    Args:
        mesh: watertight, object frame, m; its triangles are turned outward if they are not.
    """

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        self.patches = tuple(_patches(outward(mesh)))

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


@dataclass(frozen=True, eq=False)
class _Triangles:
    """What trimesh computes of a mesh, as plain arrays: trimesh looks at all of it at each access.

    Args:
        vertices: (v, 3) m.
        faces: (m, 3) corners.
        triangles: (m, 3, 3) m.
        area_faces: (m,) m2.
        face_normals: (m, 3) unit, outward; zero where a triangle has no area.
    """

    vertices: Array
    faces: NDArray[np.int64]
    triangles: Array
    area_faces: Array
    face_normals: Array

    @classmethod
    def of(cls, mesh: trimesh.Trimesh) -> "_Triangles":
        return cls(*(np.array(getattr(mesh, name)) for name in cls.__annotations__))


def _patches(whole: trimesh.Trimesh) -> list[Patch]:
    """Patches of what is coplanar, then those of single triangles."""
    facets = [facet.tolist() for facet in whole.facets]
    mesh = _Triangles.of(whole)
    curved = [np.arange(0)]
    patches: list[Patch | None] = []
    for facet, area, pairs in zip(
        facets, whole.facets_area, _neighbours(whole, facets), strict=True
    ):
        if area < _SMALL:
            curved.append(np.array(facet))
            continue
        plane = _plane(mesh, facet) if len(facet) > _MANY else None
        if plane is None:
            patches += [_patch(mesh, group) for group in _convex_groups(mesh, facet, pairs)]
        elif np.ptp(plane.off) > _FLAT:
            curved.append(np.array(facet))
        elif _is_convex(mesh, facet):
            patches.append(_patch(mesh, facet))
        else:
            patches += _patches(_recut(mesh, facet, plane))
    faces = np.setdiff1d(np.arange(len(mesh.faces)), np.concatenate([*facets, [-1]]))
    single = _triangles(mesh, np.concatenate([faces, *curved]))
    return [*(patch for patch in patches if patch is not None), *single]


def _recut(mesh: _Triangles, facet: list[int], plane: "_Plane") -> trimesh.Trimesh:
    """Many triangles of one plane as the few that their outline takes."""
    faces = np.asarray(mesh.faces[facet])
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    one_way, other_way = edges @ [len(mesh.vertices), 1], edges @ [1, len(mesh.vertices)]
    follow: dict[int, list[int]] = {}
    for start, end in edges[~np.isin(one_way, other_way)].tolist():
        follow.setdefault(start, []).append(end)
    loops = []
    while follow:
        loop = [next(iter(follow))]
        while ends := follow.get(loop[-1]):
            loop.append(ends.pop())
            if not ends:
                del follow[loop[-2]]
        loops.append(plane.flattened(np.asarray(mesh.vertices[loop[:-1]])) / _UNIT)
    outline = manifold3d.CrossSection(loops, manifold3d.FillRule.Positive).simplify(_FLAT / _UNIT)
    polygons = outline.to_polygons()
    triangles = np.asarray(manifold3d.triangulate(polygons), dtype=np.int64)
    corners = np.concatenate(polygons) * _UNIT @ plane.axes.T + plane.origin
    return trimesh.Trimesh(corners, triangles, process=False)


def _neighbours(mesh: trimesh.Trimesh, facets: list[list[int]]) -> list[list[list[int]]]:
    """The pairs of triangles with a common edge within each facet."""
    owner = np.full(len(mesh.faces), -1)
    for number, facet in enumerate(facets):
        owner[facet] = number
    first, second = owner[mesh.face_adjacency].T
    within = np.flatnonzero((first == second) & (first >= 0))
    by_owner = within[np.argsort(first[within], kind="stable")]
    starts = np.searchsorted(first[by_owner], np.arange(len(facets)))
    pairs = mesh.face_adjacency[by_owner]
    return [part.tolist() for part in np.split(pairs, starts)[1:]]


def _triangles(mesh: _Triangles, faces: NDArray[np.int64]) -> list[Patch]:
    """Single triangles as patches, without those too narrow for a finger."""
    corners = np.asarray(mesh.triangles[faces])
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    with np.errstate(all="ignore"):
        width = 2.0 * mesh.area_faces[faces] / edges.max(axis=1)
    normals = mesh.face_normals[faces]
    wide = (width >= _NARROWEST) & normals.any(axis=1)
    return [Patch(ring, -normal) for ring, normal in zip(corners[wide], normals[wide], strict=True)]


def _convex_groups(mesh: _Triangles, facet: list[int], pairs: list[list[int]]) -> list[list[int]]:
    """Triangles of one plane in groups, each with a convex union; pairs have a common edge."""
    if _is_convex(mesh, facet):
        return [facet]
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


def _is_convex(mesh: _Triangles, faces: list[int]) -> bool:
    area = float(mesh.area_faces[faces].sum())
    plane = _plane(mesh, faces)
    if plane is None or np.ptp(plane.off) > _FLAT:
        return False
    # a hull smaller than its triangles: they are folded, not flat
    return bool(abs(plane.hull.volume - area) <= _CONVEX * area)


def _patch(mesh: _Triangles, faces: list[int]) -> Patch | None:
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

    Axes (3, 2) and origin (3,) are those of coordinates in the plane. The hull is that of the
    corners in the plane, counterclockwise seen from outside.
    """

    corners: Array
    normal: Array
    off: Array
    origin: Array
    axes: Array
    hull: ConvexHull

    def flattened(self, points: Array) -> Array:
        """(k, 2) coordinates in the plane of points (k, 3)."""
        return (points - self.origin) @ self.axes


def _plane(mesh: _Triangles, faces: list[int]) -> _Plane | None:
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
    return _Plane(corners, normal, (corners - origin) @ normal, origin, axes, hull)
