"""Shapes, and the strongest statement about any body, for the tests of meshes and objects."""

import numpy as np
import trimesh
from numpy.testing import assert_allclose

from gfo_env.objects import Body, GraspObject
from gfo_env.objects.meshes import MAX_PART_VERTICES

FLAT_TETRAHEDRON = "OFF\n4 4 0\n0 0 0\n1 0 0\n0 1 0\n1 1 0\n3 0 1 2\n3 1 0 3\n3 2 1 3\n3 0 2 3\n"


def box(extents: tuple[float, ...], centre: tuple[float, ...] = (0, 0, 0)) -> trimesh.Trimesh:
    return trimesh.creation.box(extents, trimesh.transformations.translation_matrix(centre))


def box_inertia(mass: float, x: float, y: float, z: float) -> np.ndarray:
    return mass / 12 * np.diag([y**2 + z**2, z**2 + x**2, x**2 + y**2])


def joined(*shapes: trimesh.Trimesh) -> trimesh.Trimesh:
    mesh = trimesh.util.concatenate(list(shapes))
    assert isinstance(mesh, trimesh.Trimesh)
    return mesh


def inside_out(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, mesh.faces[:, ::-1], process=False)


def l_shape() -> trimesh.Trimesh:
    """A concave mesh of one component, 0.1 x 0.1 x 0.02 with a square of 0.07 missing."""
    arms = [box((0.1, 0.03, 0.02), (0.05, 0.015, 0)), box((0.03, 0.1, 0.02), (0.015, 0.05, 0))]
    return trimesh.boolean.union(arms)


def union_volume(parts: tuple[trimesh.Trimesh, ...]) -> float:
    return float(trimesh.boolean.union(list(parts)).volume) if parts[1:] else parts[0].volume


def assert_rigid_body(body: GraspObject | Body) -> None:
    """The strongest statement about any body: closed, centred, of convex parts, physical."""
    solid = body.solid
    assert solid.is_volume
    assert solid.volume > 0
    size = np.linalg.norm(solid.vertices, axis=1).max()
    assert_allclose(solid.center_mass, 0, atol=1e-9 * size)
    for part in body.parts:
        assert part.is_volume
        assert len(part.vertices) <= MAX_PART_VERTICES
        offsets = np.einsum("fi,fi->f", part.face_normals, part.triangles[:, 0])
        heights = part.vertices @ part.face_normals.T - offsets
        # The normal of a sliver is ill-conditioned; of others no vertex may lie in front.
        heights = heights[:, part.area_faces > 1e-6 * part.area]
        assert heights.max() < 1e-5 * size, "a part is not convex"
    inertia = body.inertia if isinstance(body, GraspObject) else body.inertia_per_density
    assert_allclose(inertia, inertia.T, rtol=0, atol=0)
    moments = np.linalg.eigvalsh(inertia)
    assert moments[0] > 0
    assert moments[2] <= (moments[0] + moments[1]) * (1 + 1e-9)


def thickness(mesh: trimesh.Trimesh) -> float:
    """Least width of the convex hull across one of its faces."""
    hull = mesh.convex_hull
    return float(np.ptp(hull.vertices @ hull.face_normals.T, axis=0).min())


def off_surface(shape: trimesh.Trimesh, points: np.ndarray) -> np.ndarray:
    """(k,) m: how far points are from the plane of the triangle that they are inside of."""
    off = np.full(len(points), np.inf)
    for triangle, normal in zip(shape.triangles, shape.face_normals, strict=True):
        edges = np.roll(triangle, -1, axis=0) - triangle
        inward = np.cross(normal, edges)
        inward /= np.linalg.norm(inward, axis=1, keepdims=True)
        depth = np.einsum("kei,ei->ke", points[:, None] - triangle, inward).min(axis=1)
        height = np.abs((points - triangle[0]) @ normal)
        off = np.minimum(off, np.maximum(height, -depth))
    return off
