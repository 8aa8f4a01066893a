"""Meshes become rigid bodies with the right mass properties, and sets hold the right objects."""

import json
import os
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from gfo_env.exceptions import MeshError, ObjectSetError
from gfo_env.meshes import MAX_PART_VERTICES, SUPPORTED_SUFFIXES, Body, load_body, make_body
from gfo_env.objects import (
    DENSITY,
    RANDOM_URDFS_EXCLUDED,
    RANDOM_URDFS_SCALE,
    GraspObject,
    ObjectSet,
)
from solvers.exceptions import MissingDependencyError

FLAT_TETRAHEDRON = "OFF\n4 4 0\n0 0 0\n1 0 0\n0 1 0\n1 1 0\n3 0 1 2\n3 1 0 3\n3 2 1 3\n3 0 2 3\n"

SAMPLE = ("000", "001", "072", "121", "232", "500", "933", "999")


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
        patch.setattr("coacd.run_coacd", lambda *_, **__: pytest.fail("the cache was not used"))
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


# random_urdfs


def test_splits_share_out_the_thousand() -> None:
    train, test, everything = (ObjectSet("random_urdfs", s) for s in ("train", "test", "all"))
    assert set(train).isdisjoint(test)
    assert sorted([*train, *test]) == list(everything)
    assert len(train) + len(test) + len(everything.excluded) == 1000
    assert train.excluded | test.excluded == everything.excluded == RANDOM_URDFS_EXCLUDED
    assert all(object_id.endswith("0") for object_id in [*test, *test.excluded])
    assert not any(object_id.endswith("0") for object_id in [*train, *train.excluded])
    assert list(ObjectSet("random_urdfs")) == list(train) == sorted(train)


def test_scale_is_that_of_the_urdf_files() -> None:
    pybullet_data = pytest.importorskip("pybullet_data")
    urdf = Path(pybullet_data.getDataPath(), "random_urdfs", "007", "007.urdf").read_text()
    assert urdf.count(f'scale="{" ".join([str(RANDOM_URDFS_SCALE)] * 3)}"') == 2


def check_random_urdf(grasp_object: GraspObject) -> None:
    assert_rigid_body(grasp_object)
    assert_allclose(union_volume(grasp_object.parts), grasp_object.volume, rtol=1e-5)
    assert grasp_object.mass == DENSITY * grasp_object.volume
    assert 0.02 < grasp_object.radius < 0.15
    for part in grasp_object.parts:
        assert np.linalg.norm(part.vertices, axis=1).max() <= grasp_object.radius * (1 + 1e-9)


@pytest.mark.parametrize("object_id", SAMPLE)
def test_random_urdf_is_a_rigid_body(object_id: str) -> None:
    check_random_urdf(ObjectSet("random_urdfs", "all")[object_id])


@pytest.mark.slow
def test_every_random_urdf_is_a_rigid_body_thick_enough() -> None:
    objects = ObjectSet("random_urdfs", "all")
    for object_id in objects:
        grasp_object = objects[object_id]
        check_random_urdf(grasp_object)
        assert thickness(grasp_object.solid) > 0.012, object_id


@pytest.mark.parametrize("object_id", RANDOM_URDFS_EXCLUDED)
def test_excluded_random_urdf_has_the_defect_stated(object_id: str) -> None:
    pybullet_data = pytest.importorskip("pybullet_data")
    path = Path(pybullet_data.getDataPath(), "random_urdfs", object_id, f"{object_id}.obj")
    reason = RANDOM_URDFS_EXCLUDED[object_id]
    if "finite" in reason:
        with pytest.raises(MeshError, match="not a finite number"):
            load_body(path, RANDOM_URDFS_SCALE)
    else:
        body = load_body(path, RANDOM_URDFS_SCALE)
        millimetres = 1000 * thickness(body.solid)
        assert millimetres < 10
        assert_allclose(millimetres, float(reason.split()[1]), rtol=0, atol=0.06)


def test_set_is_made_without_opening_a_mesh_or_loading_pybullet() -> None:
    code = (
        "import sys, gfo_env.objects as o, trimesh\n"
        "trimesh.load_scene = None\n"
        "assert len(o.ObjectSet('random_urdfs')) == 889\n"
        "assert not {'pybullet', 'torch', 'coacd'} & set(sys.modules)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


# Folders


def write_all_formats(folder: Path, shape: trimesh.Trimesh) -> None:
    for suffix in SUPPORTED_SUFFIXES:
        shape.export(folder / f"shape{suffix}")


def test_folder_reads_every_format_and_keeps_equal_stems_apart(tmp_path: Path) -> None:
    shape = joined(box((0.1, 0.04, 0.03)), box((0.03, 0.09, 0.05), (0.04, 0.03, 0.01)))
    expected = make_body(shape)
    write_all_formats(tmp_path, shape)
    (tmp_path / "below" / ".hidden").mkdir(parents=True)
    shape.export(tmp_path / "below" / "UPPER.STL", file_type="stl")
    shape.export(tmp_path / "below" / ".hidden" / "shape.stl")
    (tmp_path / "notes.txt").touch()

    objects = ObjectSet(tmp_path)
    assert objects.split == "all"
    assert objects.excluded == {}
    names = [f"shape{suffix}" for suffix in SUPPORTED_SUFFIXES]
    assert list(objects) == sorted([*names, "below/UPPER.STL"])
    for object_id in objects:
        grasp_object = objects[object_id]
        assert grasp_object.object_id == object_id in objects
        assert_rigid_body(grasp_object)
        assert len(grasp_object.parts) == 2
        assert_allclose(grasp_object.mass, DENSITY * expected.volume, rtol=1e-5)
        inertia = DENSITY * expected.inertia_per_density
        assert_allclose(grasp_object.inertia, inertia, rtol=0, atol=1e-5 * np.trace(inertia))


def test_scene_is_placed_by_its_transforms(tmp_path: Path) -> None:
    scene = trimesh.Scene()
    for shift in (-1.0, 1.0):
        transform = trimesh.transformations.translation_matrix((shift, 0, 0))
        scene.add_geometry(box((1, 1, 1)), transform=transform)
    scene.export(tmp_path / "scene.glb")
    body = load_body(tmp_path / "scene.glb", scale=0.1)
    assert_rigid_body(body)
    assert_allclose(np.ptp(body.solid.vertices, axis=0), (0.3, 0.1, 0.1), rtol=1e-6)


def test_texture_seams_do_not_open_a_mesh(tmp_path: Path) -> None:
    shape = box((1, 1, 1))
    lines = [f"v {x} {y} {z}" for x, y, z in shape.vertices]
    lines += [f"vt {k / 36} {k % 7 / 7}" for k in range(36)]
    for i, face in enumerate(shape.faces):
        lines.append("f " + " ".join(f"{v + 1}/{3 * i + k + 1}" for k, v in enumerate(face)))
    (tmp_path / "seams.obj").write_text("\n".join(lines))
    assert_allclose(load_body(tmp_path / "seams.obj").volume, 1, rtol=1e-12)


def test_target_size_is_the_longest_edge_of_the_smallest_box(tmp_path: Path) -> None:
    shape = box((300, 200, 100))
    shape.apply_transform(trimesh.transformations.random_rotation_matrix(np.full(3, 0.3)))
    shape.export(tmp_path / "millimetres.ply")
    grasp_object = ObjectSet(tmp_path, target_size=0.06)["millimetres.ply"]
    assert_rigid_body(grasp_object)
    edges = sorted(trimesh.bounds.oriented_bounds(grasp_object.solid)[1])
    assert_allclose(edges, (0.02, 0.04, 0.06), rtol=1e-5)
    assert_allclose(grasp_object.radius, np.linalg.norm((0.01, 0.02, 0.03)), rtol=1e-5)
    assert_allclose(union_volume(grasp_object.parts), grasp_object.volume, rtol=1e-6)
    moments = np.linalg.eigvalsh(grasp_object.inertia)
    expected = np.diag(box_inertia(grasp_object.mass, 0.06, 0.04, 0.02))
    assert_allclose(moments, np.sort(expected), rtol=1e-5)


def test_edited_file_is_read_again(tmp_path: Path) -> None:
    path = tmp_path / "a.off"
    box((1, 1, 1)).export(path)
    objects = ObjectSet(tmp_path)
    first = objects["a.off"]
    assert objects["a.off"] is first
    box((2, 1, 1)).export(path)
    os.utime(path, ns=(1, 1))
    assert_allclose(objects["a.off"].volume, 2)


# GraspObject and pickling


def test_with_mass_keeps_the_shape() -> None:
    grasp_object = ObjectSet("random_urdfs")["001"]
    heavy = grasp_object.with_mass(2 * grasp_object.mass)
    assert heavy.mass == 2 * grasp_object.mass
    assert heavy.solid is grasp_object.solid
    assert_allclose(heavy.inertia, 2 * grasp_object.inertia, rtol=1e-15)


@pytest.mark.parametrize("mass", [0.0, -1.0, np.nan, np.inf])
def test_mass_must_be_positive(mass: float) -> None:
    with pytest.raises(MeshError, match="positive number of kilograms"):
        ObjectSet("random_urdfs")["001"].with_mass(mass)


def test_sets_and_objects_survive_pickling() -> None:
    objects = ObjectSet("random_urdfs", "test", target_size=0.1)
    grasp_object = objects["010"]
    copy = pickle.loads(pickle.dumps(objects))
    assert list(copy) == list(objects)
    assert repr(copy) == repr(objects)
    twin = pickle.loads(pickle.dumps(grasp_object))
    for other in (copy["010"], twin):
        assert other.mass == grasp_object.mass
        assert_allclose(other.inertia, grasp_object.inertia, rtol=0, atol=0)
        assert_allclose(other.solid.vertices, grasp_object.solid.vertices, rtol=0, atol=0)
        assert len(other.parts) == len(grasp_object.parts)


# Errors


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"name_or_path": "no_such_set"}, "no object set or folder 'no_such_set'"),
        ({"name_or_path": __file__}, "no object set or folder"),
        ({"name_or_path": "random_urdfs", "split": "validation"}, "train, test, all"),
        ({"name_or_path": "random_urdfs", "target_size": 0.0}, "positive length"),
        ({"name_or_path": "random_urdfs", "target_size": np.nan}, "positive length"),
        ({"name_or_path": Path(__file__).parent, "split": "test"}, "no split 'test'"),
    ],
)
def test_bad_arguments_are_named(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ObjectSetError, match=message):
        ObjectSet(**arguments)


def test_empty_folder_is_named_with_the_formats_read(tmp_path: Path) -> None:
    with pytest.raises(ObjectSetError, match=", ".join(SUPPORTED_SUFFIXES)):
        ObjectSet(tmp_path)


@pytest.mark.parametrize(
    ("object_id", "message"),
    [("168", "excluded: no vertex"), ("010", "has no object '010'"), ("x", "has no object 'x'")],
)
def test_object_that_is_not_in_the_split_is_named(object_id: str, message: str) -> None:
    objects = ObjectSet("random_urdfs", "train")
    assert object_id not in objects
    with pytest.raises(ObjectSetError, match=message):
        objects[object_id]


def test_file_that_is_gone_is_named(tmp_path: Path) -> None:
    box((1, 1, 1)).export(tmp_path / "a.stl")
    objects = ObjectSet(tmp_path)
    (tmp_path / "a.stl").unlink()
    with pytest.raises(MeshError, match="gone") as caught:
        objects["a.stl"]
    assert isinstance(caught.value.__cause__, OSError)


@pytest.mark.parametrize("suffix", SUPPORTED_SUFFIXES)
@pytest.mark.parametrize("content", [b"", b"\x00\xff not a mesh \x80" * 20], ids=["empty", "noise"])
def test_corrupt_file_is_one_clear_error(tmp_path: Path, suffix: str, content: bytes) -> None:
    (tmp_path / f"bad{suffix}").write_bytes(content)
    with pytest.raises(MeshError, match=f"bad{suffix} (cannot be read|has no faces)"):
        ObjectSet(tmp_path)[f"bad{suffix}"]


def test_unreadable_file_keeps_its_cause(tmp_path: Path) -> None:
    (tmp_path / "bad.glb").write_bytes(json.dumps({"asset": {}}).encode())
    with pytest.raises(MeshError, match="cannot be read") as caught:
        load_body(tmp_path / "bad.glb")
    assert caught.value.__cause__ is not None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("OFF\n3 0 0\n0 0 0\n1 0 0\n0 1 0\n", "no faces"),
        ("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", "not watertight|encloses no volume"),
        (FLAT_TETRAHEDRON, "encloses no volume"),
        ("OFF\n3 1 0\nnan 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", "not a finite number"),
    ],
    ids=["points", "open", "flat", "nan"],
)
def test_mesh_without_a_volume_is_one_clear_error(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "bad.off").write_text(text)
    with pytest.raises(MeshError, match=f"bad.off.*({message})"):
        ObjectSet(tmp_path)["bad.off"]


def test_large_hole_is_not_guessed_at() -> None:
    shape = trimesh.creation.icosphere(subdivisions=2)
    open_bowl = shape.submesh([np.flatnonzero(shape.triangles_center[:, 2] < 0.3)], append=True)
    with pytest.raises(MeshError, match=r"not watertight.*mesh editor"):
        make_body(open_bowl)


def test_pybullet_that_is_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pybullet_data", None)
    with pytest.raises(MissingDependencyError, match="pip install pybullet"):
        ObjectSet("random_urdfs")
