"""Sets hold the right objects, folders are read in every format, errors are clear."""

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
from numpy.testing import assert_allclose

from gfo_env.exceptions import MeshError, MeshWarning, ObjectSetError
from gfo_env.objects import DENSITY, GraspObject, ObjectSet, load_body
from gfo_env.objects.meshes import SUPPORTED_SUFFIXES, make_body
from gfo_env.objects.sets import RANDOM_URDFS_EXCLUDED, RANDOM_URDFS_SCALE
from solvers.exceptions import MissingDependencyError
from tests.support.shapes import (
    FLAT_TETRAHEDRON,
    assert_rigid_body,
    box,
    box_inertia,
    joined,
    l_shape,
    thickness,
    union_volume,
)

SAMPLE = ("000", "001", "072", "121", "232", "500", "933", "999")

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


# Files that are no objects


def write_cup(path: Path) -> None:
    """A cylinder without its lid."""
    cup = trimesh.creation.cylinder(0.03, 0.1, sections=32)
    lid = np.isclose(cup.triangles[:, :, 2], 0.05).all(axis=1)
    trimesh.Trimesh(cup.vertices, cup.faces[~lid]).export(path)


@pytest.fixture
def dataset(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Objects with two files each, a point cloud beside them, and one cup that is open."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    root = tmp_path / "meshes"
    for k, name in enumerate(("004_sugar", "025_mug", "036_block")):
        (root / name / "clouds").mkdir(parents=True)
        shape = box((0.04, 0.05, 0.06 + 0.01 * k))
        shape.export(root / name / "nontextured.ply")
        shape.export(root / name / "textured.obj")
        trimesh.PointCloud(shape.sample(30)).export(root / name / "clouds" / "cloud.ply")
    write_cup(root / "cup.stl")
    return root


def test_what_is_no_solid_is_left_out_with_its_reason(dataset: Path) -> None:
    for _ in range(2):  # examined, and remembered
        with pytest.warns(MeshWarning, match="4 of 10 files.*no solids.*cloud.ply has no faces"):
            objects = ObjectSet(dataset)
        assert len(objects) == 6
        assert set(objects.excluded) == {
            "cup.stl",
            *(f"{name}/clouds/cloud.ply" for name in ("004_sugar", "025_mug", "036_block")),
        }
        assert "cup.stl: the mesh is not watertight" in objects.excluded["cup.stl"]
        for object_id in objects:
            assert_rigid_body(objects[object_id])
    with pytest.raises(MeshError, match=r"cup\.stl: the mesh is not watertight"):
        objects["cup.stl"]
    assert list(pickle.loads(pickle.dumps(objects))) == list(objects)


def test_verdicts_are_of_the_content_wherever_it_lies(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.warns(MeshWarning):
        ObjectSet(dataset)
    moved = dataset.rename(tmp_path / "elsewhere")
    examine = "gfo_env.objects.sets.needs_decomposition"
    monkeypatch.setattr(examine, lambda _: pytest.fail("the cache was not used"))
    with pytest.warns(MeshWarning, match="elsewhere/cup.stl: the mesh is not|elsewhere/0.*cloud"):
        objects = ObjectSet(moved)
    assert objects.excluded["cup.stl"].startswith(f"{moved}/cup.stl: ")
    monkeypatch.undo()
    for kept in (tmp_path / "cache" / "graspforce" / "solids").iterdir():
        kept.write_bytes(kept.read_bytes()[:-2])  # damaged
    again = moved.rename(dataset)
    with pytest.warns(MeshWarning, match="4 of 10"):
        assert len(ObjectSet(again)) == 6


def test_only_what_is_asked_for_is_examined(dataset: Path) -> None:
    objects = ObjectSet(dataset, object_ids=["025_mug/textured.obj"])
    assert list(objects) == ["025_mug/textured.obj"]
    assert objects.excluded == {}
    with pytest.raises(MeshError, match=r"cup\.stl: the mesh is not watertight"):
        ObjectSet(dataset, object_ids=["cup.stl", "025_mug/textured.obj"])


def test_set_of_no_solid_is_an_error(tmp_path: Path) -> None:
    for name in ("a.stl", "b.stl"):
        write_cup(tmp_path / name)
    with pytest.raises(
        MeshError, match=r"a\.stl: .*not watertight.*and 1 more files are no solids"
    ):
        ObjectSet(tmp_path)


def test_coacd_is_asked_for_before_anything_starts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    l_shape().export(tmp_path / "ell.stl")
    monkeypatch.setitem(sys.modules, "coacd", None)
    with pytest.raises(MissingDependencyError, match=r"graspforce\[decomposition\]"):
        ObjectSet(tmp_path)


# Several files an object, and units


@pytest.mark.parametrize(
    ("pattern", "count"), [("**/nontextured.ply", 3), ("*/textured.obj", 3), ("025*/*.ply", 1)]
)
def test_pattern_chooses_files(dataset: Path, pattern: str, count: int) -> None:
    objects = ObjectSet(dataset, pattern=pattern)
    assert len(objects) == count
    assert all(Path(object_id).match(pattern) for object_id in objects)


@pytest.mark.parametrize(
    ("pattern", "message"),
    [("*.step", r"no mesh files that match '\*.step'"), ("", "pattern"), ("/*", "pattern")],
)
def test_pattern_that_chooses_nothing_is_named(dataset: Path, pattern: str, message: str) -> None:
    with pytest.raises(ObjectSetError, match=message):
        ObjectSet(dataset, pattern=pattern)


def test_scale_keeps_the_sizes_of_objects(tmp_path: Path) -> None:
    box((40, 60, 80)).export(tmp_path / "box.stl")
    box((15, 15, 40)).export(tmp_path / "pin.stl")
    objects = ObjectSet(tmp_path, scale=0.001)
    lengths = [max(objects[object_id].solid.extents) for object_id in objects]
    assert_allclose(lengths, [0.08, 0.04], rtol=1e-6)
    assert_allclose(objects["pin.stl"].mass, DENSITY * 0.015**2 * 0.04, rtol=1e-6)
    assert objects.advice_on_size() == ""
    assert objects.fingerprint() != ObjectSet(tmp_path).fingerprint()
    advice = ObjectSet(tmp_path).advice_on_size()
    assert "40 to 80 m long" in advice
    assert "0.001 for millimetres" in advice


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
        ({"name_or_path": "random_urdfs", "scale": 0.001}, "for folders of meshes"),
        ({"name_or_path": "random_urdfs", "pattern": "*"}, "for folders of meshes"),
        ({"name_or_path": Path(__file__).parent, "scale": -1.0}, "positive number of metres"),
        ({"name_or_path": Path(__file__).parent, "scale": "mm"}, "positive number of metres"),
        ({"name_or_path": Path(__file__).parent, "scale": 1.0, "target_size": 1.0}, "not both"),
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
