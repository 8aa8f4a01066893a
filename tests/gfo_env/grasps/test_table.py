"""Tables of grasps: storage, slicing, errors; and collection: reproducible, resumable, honest."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from gfo_env.grasps import GraspTable, GraspTableError
from gfo_env.grasps.acquisition import MAX_CONTACTS
from gfo_env.grasps.attempts import ChunkStore, grasp_of, make_chunk
from gfo_env.grasps.collection import CollectionError, CollectionPlan, collect
from gfo_env.grasps.table import COLUMNS
from gfo_env.hand import BARRETT_BH8_280
from gfo_env.objects import ObjectSet

PLAN = CollectionPlan(ObjectSet("random_urdfs", "test"), 60, 3)


@pytest.fixture(scope="module")
def table() -> GraspTable:
    return collect(PLAN, workers=1)[0]


def assert_same(one: GraspTable, other: GraspTable) -> None:
    for name in COLUMNS:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


def test_bytes_do_not_depend_on_workers(table, tmp_path) -> None:
    again, report = collect(PLAN, workers=2)
    table.save(tmp_path / "one.npz")
    again.save(tmp_path / "two.npz")
    assert (tmp_path / "one.npz").read_bytes() == (tmp_path / "two.npz").read_bytes()
    figures = report.summary()
    assert figures["grasps"] == len(table) == 60
    assert sum(figures["outcomes"].values()) == figures["attempts"]
    assert figures["yield"] == 60 / figures["attempts"]
    assert 0 < figures["object_yield"] <= 1


def test_interrupted_collection_goes_on_and_gives_the_same(table, tmp_path, monkeypatch) -> None:
    output = tmp_path / "grasps.npz"
    folder = tmp_path / "grasps.npz.parts"
    made = []

    def interrupted(attempts, number):
        if number >= 1:
            raise KeyboardInterrupt
        made.append(number)
        return make_chunk(attempts, number)

    monkeypatch.setattr("gfo_env.grasps.collection.make_chunk", interrupted)
    with pytest.raises(KeyboardInterrupt):
        collect(PLAN, workers=1, output=output)
    assert made == [0]
    assert folder.is_dir()

    def counted(attempts, number):
        made.append(number)
        return make_chunk(attempts, number)

    save = GraspTable.save

    def full_disk(one, path):
        if path == output:
            raise OSError("disk full")
        save(one, path)

    monkeypatch.setattr("gfo_env.grasps.collection.make_chunk", counted)
    monkeypatch.setattr(GraspTable, "save", full_disk)
    with pytest.raises(OSError, match="full"):
        collect(PLAN, workers=1, output=output)
    monkeypatch.undo()
    monkeypatch.setattr("gfo_env.grasps.collection.make_chunk", counted)
    # what was collected outlives a table that could not be written, and damage costs one chunk
    (damaged,) = folder.glob("*/000000.npz")
    damaged.write_bytes(damaged.read_bytes()[:1000])
    resumed, _ = collect(PLAN, workers=1, output=output)
    assert made.count(0) == 2
    assert_same(resumed, table)
    assert_same(GraspTable.load(output), table)
    assert [path.name for path in tmp_path.iterdir()] == ["grasps.npz"]


def test_parts_of_objects_of_another_size_do_not_mix(tmp_path) -> None:
    meshes = tmp_path / "meshes"
    meshes.mkdir()
    trimesh.creation.icosphere(radius=1.0).export(meshes / "ball.stl")
    folders = {
        ChunkStore(tmp_path, CollectionPlan(objects, 5, 0).attempts()).folder
        for objects in (ObjectSet(meshes, target_size=size) for size in (0.06, 0.08))
    }
    assert len(folders) == 2


@pytest.mark.parametrize(("grasps", "seed"), [(0, 0), (-3, 0), (5, -1)])
def test_plans_that_make_no_sense_are_refused(grasps, seed) -> None:
    with pytest.raises(CollectionError, match="must be"):
        CollectionPlan(PLAN.objects, grasps, seed)


@pytest.mark.parametrize("workers", [0, -1])
def test_collecting_takes_a_worker_and_a_file(workers, tmp_path) -> None:
    with pytest.raises(CollectionError, match="workers"):
        collect(PLAN, workers=workers)
    with pytest.raises(CollectionError, match="folder"):
        collect(PLAN, output=tmp_path)


def test_another_seed_gives_other_grasps_and_a_larger_plan_the_same_first_ones(table) -> None:
    fewer, _ = collect(CollectionPlan(PLAN.objects, 10, 3))
    assert_same(fewer, table[:10])
    other, _ = collect(CollectionPlan(PLAN.objects, 10, 4))
    assert not np.array_equal(other.object_id, fewer.object_id)


def test_every_object_is_tried_once_a_round() -> None:
    ids = PLAN.objects.object_ids
    attempts = PLAN.attempts()
    for turn in range(3):
        seen = [attempts.object_id(turn * len(ids) + i) for i in range(len(ids))]
        assert sorted(seen) == sorted(ids)


def test_rows_are_grasps(table) -> None:
    for index in (0, 17, 59):
        grasp = grasp_of(table, index)
        count = len(grasp.contacts)
        assert 3 <= count <= MAX_CONTACTS
        used = np.repeat(table.contact_mask[index], 3)
        np.testing.assert_array_equal(grasp.contacts.grasp_map, table.grasp_map[index][:, used])
        assert not table.grasp_map[index][:, ~used].any()
        assert not table.hand_jacobian[index][~used].any()


def test_tables_of_fingertip_grasps_and_other_hands_say_so(tmp_path) -> None:
    hand = replace(BARRETT_BH8_280, name="strong hand", max_torque=(3.0,) * 8)
    plan = CollectionPlan(PLAN.objects, 5, 0, hand, fingertips=True)
    tips = {hand.link_names.index(link) for link in hand.fingertip_links}
    collect(plan, output=tmp_path / "t.npz")
    table = GraspTable.load(tmp_path / "t.npz")
    assert (table.hand, table.fingertips) == ("strong hand", True)
    assert table.max_torque.tolist() == [3.0] * 8
    assert all(set(grasp_of(table, row).contacts.links.tolist()) <= tips for row in range(5))


def test_save_and_load_are_exact(table, tmp_path) -> None:
    table.save(tmp_path / "t.npz")
    back = GraspTable.load(tmp_path / "t.npz")
    assert_same(back, table)
    assert (back.object_set, back.split, back.seed) == ("random_urdfs", "test", 3)
    assert (back.hand, back.fingertips, back.target_size) == ("barrett_bh8_280", False, None)
    np.testing.assert_array_equal(back.max_torque, table.max_torque)
    assert [path.name for path in tmp_path.iterdir()] == ["t.npz"]


def test_bad_files_have_clear_errors(table, tmp_path) -> None:
    with pytest.raises(GraspTableError, match=r"no grasps at .*collect\.py"):
        GraspTable.load(tmp_path / "missing.npz")
    (tmp_path / "text.npz").write_text("hello")
    with pytest.raises(GraspTableError, match="not a table of grasps"):
        GraspTable.load(tmp_path / "text.npz")
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    with pytest.raises(GraspTableError, match="not a table of grasps"):
        GraspTable.load(tmp_path / "other.npz")
    table[:0].save(tmp_path / "empty.npz")
    with pytest.raises(GraspTableError, match="holds no grasp"):
        GraspTable.load(tmp_path / "empty.npz")
    whole = tmp_path / "whole.npz"
    table.save(whole)
    data = whole.read_bytes()
    (tmp_path / "cut.npz").write_bytes(data[:2000])
    middle = len(data) // 2
    (tmp_path / "wiped.npz").write_bytes(data[:middle] + bytes(200) + data[middle + 200 :])
    with (tmp_path / "array.npz").open("wb") as stream:
        np.save(stream, np.zeros(3))
    with np.load(whole) as archive:
        columns = dict(archive)
    np.savez(tmp_path / "list.npz", **columns | {"header": np.array("[1]")})
    for name in ("cut", "wiped", "array", "list"):
        with pytest.raises(GraspTableError, match="not a table of grasps"):
            GraspTable.load(tmp_path / f"{name}.npz")
    for old, new in (("max_torque", "strength"), ("graspforce-grasps-2", "graspforce-grasps-1")):
        header = str(columns["header"]).replace(old, new)
        np.savez(tmp_path / "header.npz", **columns | {"header": np.array(header)})
        with pytest.raises(GraspTableError, match="another format"):
            GraspTable.load(tmp_path / "header.npz")


@pytest.mark.parametrize(
    ("column", "wrong"),
    [
        ("positions", lambda array: array[:, :, :2]),
        ("positions", lambda array: array * np.nan),
        ("object_id", lambda array: np.arange(len(array))),
        ("attempt", lambda array: array[:-1]),
        ("grasp_map", lambda array: array.astype(np.complex128)),
        ("hand_jacobian", lambda array: array[0]),
        ("contact_mask", lambda array: array.astype(np.float64)),
        ("contact_mask", lambda array: array[..., None]),
    ],
)
def test_columns_that_cannot_be_are_named(table, tmp_path, column, wrong) -> None:
    path = tmp_path / "t.npz"
    table.save(path)
    with np.load(path) as archive:
        columns = dict(archive)
    np.savez(path, **columns | {column: wrong(columns[column])})
    with pytest.raises(GraspTableError, match=f"{column}.* of {path} cannot be"):
        GraspTable.load(path)


@pytest.mark.parametrize(
    "change",
    [{"seed": "0"}, {"hand": 3}, {"max_torque": "2"}, {"max_torque": [1.0]}, {"fingertips": 1}],
)
def test_headers_that_cannot_be_are_named(table, tmp_path, change) -> None:
    path = tmp_path / "t.npz"
    table.save(path)
    with np.load(path) as archive:
        columns = dict(archive)
    header = json.loads(str(columns["header"])) | change
    np.savez(path, **columns | {"header": np.array(json.dumps(header))})
    with pytest.raises(GraspTableError, match=f"{next(iter(change))} of {path} cannot be"):
        GraspTable.load(path)


def test_objects_that_cannot_be_grasped_are_not_tried_for_ever(tmp_path: Path) -> None:
    trimesh.creation.icosphere(radius=0.001).export(tmp_path / "crumb.stl")
    plan = CollectionPlan(ObjectSet(tmp_path), 5, 0)
    with pytest.raises(GraspTableError, match="graspable size"):
        collect(plan)
