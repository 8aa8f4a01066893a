"""Nearest points of a surface, against trimesh."""

from functools import cache

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from gfo_env.contacts import Surface
from tests.support.seeds import seeded
from tests.support.shapes import box, l_shape, off_surface
from tests.support.world import held_out_objects

SHAPES = {
    "box": lambda: box((0.05, 0.06, 0.07)),
    "l shape": l_shape,
    "ball": lambda: trimesh.creation.icosphere(subdivisions=3, radius=0.04),
    "needle": lambda: trimesh.creation.cone(radius=0.001, height=0.3, sections=5),
    "urdf object": lambda: held_out_objects()[held_out_objects().object_ids[0]].solid,
    "another": lambda: held_out_objects()[held_out_objects().object_ids[7]].solid,
}


@cache
def mesh(name: str) -> trimesh.Trimesh:
    return SHAPES[name]()


@pytest.mark.parametrize("name", SHAPES)
def test_as_near_as_trimesh_finds_and_on_the_surface(name: str) -> None:
    """Where nearest points are not unique the two may differ, and distances alone compare."""
    shape = mesh(name)
    rng = seeded(0)
    size = np.ptp(shape.bounds, axis=0).max()
    on = shape.vertices[rng.integers(len(shape.vertices), size=20)]
    points = np.vstack(
        [
            on,
            shape.triangles_center[:20],
            on + rng.normal(0.0, 1e-3 * size, on.shape),
            rng.uniform(*shape.bounds, (40, 3)),
            rng.normal(0.0, 2.0 * size, (20, 3)),
            shape.center_mass[None],
        ]
    )
    surface = Surface(shape)
    found = surface.nearest(points)
    distance = np.linalg.norm(found - points, axis=1)
    _, reference, _ = trimesh.proximity.closest_point(shape, points)
    assert (distance <= reference + 1e-9 * size).all()
    # up to 1e-4 m nearer than trimesh, so it must be told apart from points off the surface
    assert off_surface(shape, found).max() <= 1e-9 * size
    known = len(on) + len(shape.triangles_center[:20])
    np.testing.assert_allclose(distance[:known], 0.0, atol=1e-12)
    # a point of the surface is its own nearest point
    np.testing.assert_allclose(surface.nearest(found), found, atol=1e-9 * size)


coordinate = st.floats(-1.0, 1.0, width=32)


@given(st.tuples(*[coordinate] * 3), st.tuples(*[coordinate] * 9))
def test_any_triangle(point, corners) -> None:
    """Against the definition: no point of the triangle is nearer, slivers and points included."""
    triangle = np.array(corners).reshape(3, 3)
    shape = trimesh.Trimesh(triangle, [[0, 1, 2]], process=False, validate=False)
    found = Surface(shape).nearest(np.array([point]))[0]
    assert np.isfinite(found).all()
    share = seeded(0).dirichlet(np.ones(3), 50)
    inside = np.vstack([share @ triangle, triangle])
    nearest = np.linalg.norm(inside - point, axis=1).min()
    assert np.linalg.norm(found - point) <= nearest + 1e-7
    # and it is a convex combination of the corners
    affine = np.vstack([triangle.T, np.ones(3)])
    weights = np.linalg.lstsq(affine, np.append(found, 1.0), rcond=None)[0]
    np.testing.assert_allclose(weights @ triangle, found, atol=1e-6)


@pytest.mark.parametrize("corners", [(0, 0, 1), (0, 1, 0), (1, 0, 0), (0, 0, 0)])
def test_triangles_without_area_are_edges_and_points(corners: tuple[int, int, int]) -> None:
    rng = seeded(3)
    for _ in range(200):
        ends = rng.integers(-2, 3, (2, 3)).astype(float)
        point = rng.integers(-2, 3, 3).astype(float)
        shape = trimesh.Trimesh(ends[list(corners)], [[0, 1, 2]], process=False, validate=False)
        (found,) = Surface(shape).nearest(point[None])
        start, along = ends[0], (ends[1] - ends[0]) * max(corners)
        length = max(along @ along, 1e-300)
        share = np.clip((point - start) @ along / length, 0.0, 1.0)
        np.testing.assert_allclose(found, start + share * along, atol=1e-12)


def test_a_point_a_digit_above_a_face_finds_it() -> None:
    """Rounding puts some of these on the triangle, though outside of the box around it."""
    points = seeded(2).uniform([-0.02, 0.03, -0.03], [0.02, 0.03, 0.035], (2000, 3))
    points[::2, 2] = 0.035
    points[:, 1] = np.nextafter(0.03, 1.0)
    found = Surface(mesh("box")).nearest(points)
    np.testing.assert_allclose(found, points, atol=1e-15)


def test_no_points_and_one() -> None:
    surface = Surface(mesh("box"))
    assert surface.nearest(np.zeros((0, 3))).shape == (0, 3)
    np.testing.assert_allclose(surface.nearest(np.array([[1.0, 0, 0]])), [[0.025, 0, 0]])
    # a slice that is not contiguous in memory
    points = seeded(1).normal(size=(3, 5)).T
    np.testing.assert_array_equal(surface.nearest(points), surface.nearest(points.copy()))


def test_a_mesh_is_left_as_it_was() -> None:
    shape = box((0.1, 0.1, 0.1))
    before = shape.vertices.copy()
    surface = Surface(shape)
    points = np.array([[0.3, 0.2, 0.1]])
    surface.nearest(points)
    np.testing.assert_array_equal(shape.vertices, before)
    np.testing.assert_array_equal(points, [[0.3, 0.2, 0.1]])
