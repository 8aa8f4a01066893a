"""Meshes become rigid bodies with the right mass properties and convex parts."""

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from gfo_env.exceptions import MeshError
from gfo_env.objects.meshes import MAX_PART_VERTICES, make_body
from gfo_env.objects.overlap import overlap
from solvers.exceptions import MissingDependencyError
from tests.support.problems import random_rotation
from tests.support.seeds import SEEDS, seeded
from tests.support.shapes import (
    assert_rigid_body,
    box,
    box_inertia,
    inside_out,
    joined,
    l_shape,
    union_volume,
)


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    pytest.importorskip("coacd")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "graspforce" / "convex_parts"


# Mass properties


def test_box_matches_closed_form() -> None:
    body = make_body(box((0.1, 0.06, 0.02), centre=(3, -7, 11)))
    assert_rigid_body(body)
    assert_allclose(body.volume, 0.1 * 0.06 * 0.02, rtol=1e-12)
    assert_allclose(
        body.inertia_per_density, box_inertia(body.volume, 0.1, 0.06, 0.02), rtol=1e-9, atol=1e-18
    )
    assert len(body.parts) == 1
    assert_allclose(body.extent, 0.1, rtol=1e-9)


def test_sphere_approaches_closed_form_and_its_part_has_few_vertices() -> None:
    radius = 0.04
    body = make_body(trimesh.creation.icosphere(subdivisions=5, radius=radius))
    assert_rigid_body(body)
    assert_allclose(body.volume, 4 / 3 * np.pi * radius**3, rtol=2e-3)
    moment = 2 / 5 * body.volume * radius**2
    assert_allclose(body.inertia_per_density, np.eye(3) * moment, rtol=2e-3, atol=1e-4 * moment)
    (part,) = body.parts
    assert len(part.vertices) > MAX_PART_VERTICES / 2
    inner_radius = np.einsum("fi,fi->f", part.face_normals, part.triangles[:, 0]).min()
    assert inner_radius > 0.98 * radius


def test_overlap_of_two_boxes_counts_once() -> None:
    body = make_body(joined(box((2, 1, 1), (0, 0, 0)), box((2, 1, 1), (1, 0, 0))))
    assert_rigid_body(body)
    assert_allclose(body.volume, 3, rtol=1e-12)
    assert_allclose(body.inertia_per_density, box_inertia(3, 3, 1, 1), atol=1e-12)
    assert len(body.parts) == 2


def test_boxes_apart_are_one_body() -> None:
    body = make_body(joined(box((1, 1, 1), (-2, 0, 0)), box((1, 1, 1), (2, 0, 0))))
    assert_rigid_body(body)
    inertia = 2 * box_inertia(1, 1, 1, 1) + 2 * np.diag([0, 4, 4])  # parallel axes
    assert_allclose(body.inertia_per_density, inertia, atol=1e-12)


def test_cavity_is_hollow_but_not_touched() -> None:
    body = make_body(joined(box((2, 2, 2)), inside_out(box((1, 1, 1)))))
    assert_allclose(body.volume, 7, rtol=1e-12)
    assert_allclose(
        body.inertia_per_density, box_inertia(8, 2, 2, 2) - box_inertia(1, 1, 1, 1), atol=1e-12
    )
    assert_allclose(union_volume(body.parts), 8, rtol=1e-6)


@pytest.mark.parametrize(
    "shape",
    [
        inside_out(box((1, 1, 3))),
        joined(box((1, 1, 1)), inside_out(box((1, 1, 1), (0, 0, 2))), box((1, 1, 1), (0, 0, 1))),
    ],
    ids=["whole", "component"],
)
def test_inverted_winding_is_turned_round(shape: trimesh.Trimesh) -> None:
    body = make_body(shape)
    assert_rigid_body(body)
    assert_allclose(body.volume, 3, rtol=1e-6)
    assert_allclose(body.inertia_per_density, box_inertia(3, 1, 1, 3), atol=1e-5)


def test_small_holes_and_mixed_winding_are_repaired() -> None:
    shape = box((1, 2, 3))
    faces = shape.faces[1:].copy()
    faces[::3] = faces[::3, ::-1]
    body = make_body(trimesh.Trimesh(shape.vertices, faces, process=False))
    assert_rigid_body(body)
    assert_allclose(body.volume, 6, rtol=1e-12)


def test_triangle_soup_is_joined() -> None:
    shape = trimesh.creation.icosphere(subdivisions=2)
    soup = shape.triangles.reshape(-1, 3)
    mesh = trimesh.Trimesh(soup, np.arange(len(soup)).reshape(-1, 3), process=False)
    body = make_body(mesh)
    assert_rigid_body(body)
    assert_allclose(body.volume, shape.volume, rtol=1e-12)


@settings(max_examples=25, deadline=None)
@given(
    quaternion=st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1),
    offset=st.tuples(*[st.floats(-10, 10)] * 3),
    scale=st.floats(0.01, 100),
)
def test_mass_properties_follow_the_mesh(
    quaternion: tuple[float, ...], offset: tuple[float, ...], scale: float
) -> None:
    shape = joined(box((0.1, 0.04, 0.03)), box((0.03, 0.09, 0.05), (0.04, 0.03, 0.01)))
    reference = make_body(shape)
    rotation = Rotation.from_quat(quaternion).as_matrix()
    moved = trimesh.Trimesh(
        scale * shape.vertices @ rotation.T + offset, shape.faces, process=False
    )
    body = make_body(moved)
    assert_allclose(body.volume, scale**3 * reference.volume, rtol=1e-6)
    expected = scale**5 * rotation @ reference.inertia_per_density @ rotation.T
    assert_allclose(body.inertia_per_density, expected, rtol=0, atol=1e-6 * np.trace(expected))
    assert len(body.parts) == len(reference.parts)


def doubled(mesh: trimesh.Trimesh, rows: slice) -> trimesh.Trimesh:
    """With the other sides of some triangles, in any order."""
    faces = np.vstack([mesh.faces, mesh.faces[rows, ::-1]])
    return trimesh.Trimesh(mesh.vertices, seeded(0).permutation(faces), process=False)


def soup(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    corners = np.asarray(mesh.triangles).reshape(-1, 3)
    return trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3), process=False)


@pytest.mark.parametrize("rows", [slice(None), slice(1), slice(0, None, 3)], ids=str)
@pytest.mark.parametrize(
    "shape", [box((1, 2, 3)), trimesh.creation.icosphere(2)], ids=["box", "ball"]
)
@pytest.mark.parametrize("form", [lambda mesh: mesh, soup], ids=["joined", "soup"])
def test_triangles_that_are_there_from_both_sides_count_once(
    form: Callable[[trimesh.Trimesh], trimesh.Trimesh], shape: trimesh.Trimesh, rows: slice
) -> None:
    body = make_body(form(doubled(shape, rows)))
    assert_rigid_body(body)
    assert_allclose(body.volume, shape.volume, rtol=1e-9)
    assert len(body.parts) == 1


# Surfaces that pass through themselves


def bow(depth: float) -> trimesh.Trimesh:
    """A bar bent to a ring whose ends pass into each other by `depth`, as one surface."""
    turns = np.linspace(0, 2 * np.pi + depth, 40)
    square = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * 0.004
    rings = [
        np.stack([(0.03 + r) * np.cos(t), (0.03 + r) * np.sin(t), z + 0 * t], axis=-1)
        for t in turns
        for r, z in [square.T]
    ]
    n = len(rings)
    faces = [(0, 2, 1), (0, 3, 2)]
    faces += [(4 * n - 4, 4 * n - 3, 4 * n - 2), (4 * n - 4, 4 * n - 2, 4 * n - 1)]
    for k in range(n - 1):
        for i in range(4):
            a, b = 4 * k + i, 4 * k + (i + 1) % 4
            faces += [(a, b, b + 4), (a, b + 4, a + 4)]
    return trimesh.Trimesh(np.concatenate(rings), np.array(faces)[:, ::-1], process=False)


def test_surface_that_passes_through_itself_is_refused() -> None:
    with pytest.raises(MeshError, match=r"passes through itself: 1\d\.\d% .*Remesh"):
        make_body(bow(1.0))
    with pytest.raises(MeshError, match="passes through itself"):
        make_body(inside_out(bow(1.0)))


@settings(max_examples=10, deadline=None)
@given(seed=SEEDS, depth=st.floats(0.3, 3.0))
def test_overlap_is_the_share_of_space_that_is_enclosed_twice(seed: int, depth: float) -> None:
    mesh = bow(depth)
    assert mesh.is_volume
    vertices = np.asarray(mesh.vertices) @ random_rotation(seeded(seed)).T
    assert overlap(vertices, mesh.faces) == pytest.approx(depth / (2 * np.pi), abs=0.01)
    assert overlap(vertices, mesh.faces[:, ::-1]) == 1.0


@settings(max_examples=5, deadline=None)
@given(seed=SEEDS)
def test_solids_do_not_overlap_themselves(seed: int) -> None:
    rng = seeded(seed)
    for mesh in (box((1, 2, 3)), bow(-0.5), trimesh.creation.annulus(1, 2, 1), l_shape()):
        vertices = np.asarray(mesh.vertices) @ random_rotation(rng).T * 10 ** rng.uniform(-3, 3)
        assert overlap(vertices, np.asarray(mesh.faces)) == 0.0


# Convex parts of concave meshes


def test_concave_mesh_is_decomposed_in_silence(
    cache: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    body = make_body(l_shape())
    assert_rigid_body(body)
    assert_allclose(body.volume, (0.1**2 - 0.07**2) * 0.02, rtol=1e-6)
    assert len(body.parts) > 1
    assert_allclose(union_volume(body.parts), body.volume, rtol=0.01)
    assert capfd.readouterr() == ("", "")


def test_decomposition_is_kept_and_made_anew_if_damaged(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    parts = make_body(l_shape()).parts
    (kept,) = cache.iterdir()
    whole = kept.read_bytes()

    with monkeypatch.context() as patch:
        unused = "gfo_env.objects.decomposition._run"
        patch.setattr(unused, lambda *_: pytest.fail("the cache was not used"))
        again = make_body(l_shape()).parts
    kept.write_bytes(whole[:100])
    mended = make_body(l_shape()).parts
    assert len(parts) == len(again) == len(mended)
    for part, *others in zip(parts, again, mended, strict=True):
        for other in others:
            assert_allclose(part.vertices, other.vertices, rtol=0, atol=0)
    assert list(cache.iterdir()) == [kept]
    assert len(kept.read_bytes()) == len(whole)


def test_cache_that_cannot_be_written_is_no_obstacle(
    cache: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert len(make_body(l_shape()).parts) > 1


def test_coacd_that_is_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "coacd", None)
    with pytest.raises(MissingDependencyError, match=r"graspforce\[decomposition\]") as caught:
        make_body(l_shape())
    assert isinstance(caught.value.__cause__, ImportError)
    assert_rigid_body(make_body(box((1, 2, 3))))  # which needs none


def test_overlapping_concave_components_are_united_first(cache: Path) -> None:
    second = l_shape()
    second.apply_translation((0, 0, 0.02 / 2))
    body = make_body(joined(l_shape(), second))
    assert_rigid_body(body)
    assert_allclose(body.volume, (0.1**2 - 0.07**2) * 0.03, rtol=1e-6)
    assert_allclose(union_volume(body.parts), body.volume, rtol=0.01)
