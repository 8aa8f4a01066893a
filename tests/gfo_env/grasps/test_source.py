"""Grasp sources: the cache never changes a grasp, whatever its state; tables must fit."""

import copy
import multiprocessing
import os
import pickle
import subprocess
import sys
import warnings
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from gfo_env.exceptions import AcquisitionError
from gfo_env.grasps import GraspTable, GraspTableError
from gfo_env.grasps import source as grasp_source
from gfo_env.grasps.attempts import Attempts, Chunk, ChunkStore, make_chunk
from gfo_env.grasps.collection import CollectionError, CollectionPlan, collect, fill_cache
from gfo_env.grasps.source import LEAST_ROUNDS, LEAST_SLOTS, GraspSource, StoredGrasp
from gfo_env.hand import BARRETT_BH8_280
from gfo_env.objects import ObjectSet
from scripts.collect import CollectSettings, main
from tests.support.seeds import seeded

ROOT = Path(__file__).resolve().parents[3]

HELD_OUT = ObjectSet("random_urdfs", "test")
CHUNK = 5


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache of the user's, and chunks of few attempts, which are quickly made."""
    for module in ("attempts", "collection", "source"):
        monkeypatch.setattr(f"gfo_env.grasps.{module}.CHUNK", CHUNK)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "graspforce" / "grasps"


@pytest.fixture
def first_chunk(cache: Path) -> Chunk:
    """What the first chunk of the held-out objects is."""
    return make_chunk(GraspSource(HELD_OUT, BARRETT_BH8_280).attempts, 0)


@pytest.fixture
def balls(tmp_path: Path) -> Path:
    """A folder of two meshes of graspable size."""
    folder = tmp_path / "meshes"
    folder.mkdir()
    trimesh.creation.icosphere(radius=0.035).export(folder / "ball.stl")
    trimesh.creation.box((0.05, 0.06, 0.08)).export(folder / "box.ply")
    return folder


def make_source(objects: ObjectSet = HELD_OUT) -> GraspSource:
    return GraspSource(objects, BARRETT_BH8_280)


def bits(stored: StoredGrasp | None) -> tuple[bytes, ...] | None:
    """Everything in a grasp, to the last bit."""
    if stored is None:
        return None
    grasp, contacts = stored.grasp, stored.grasp.contacts
    arrays = (
        grasp.pose.position, grasp.pose.rotation, grasp.joint_angles, grasp.gravity_map,
        contacts.positions, contacts.frames, contacts.links, contacts.normal_forces,
        contacts.jacobian, np.array(stored.radius),
    )  # fmt: skip
    return (grasp.object_id.encode(), *(array.tobytes() for array in arrays))


def all_bits(source: GraspSource, count: int = 5) -> list[tuple[bytes, ...] | None]:
    return [bits(source.grasp(number)) for number in range(count)]


def never(*_: object) -> Chunk:
    raise AssertionError("a chunk was made that is in the cache")


def test_a_grasp_is_what_its_attempt_yields(first_chunk) -> None:
    source = make_source()
    grasps = [source.grasp(number) for number in range(CHUNK)]
    assert [stored is not None for stored in grasps] == [
        outcome == "grasp" for outcome in first_chunk.outcomes
    ]
    rows = iter(range(len(first_chunk.table)))
    for number, stored in enumerate(grasps):
        if stored is not None:
            row = next(rows)
            assert stored.grasp.object_id == source.attempts.object_id(number)
            assert stored.radius == HELD_OUT[stored.grasp.object_id].radius
            count = len(stored.grasp.contacts)
            np.testing.assert_array_equal(
                stored.grasp.contacts.grasp_map, first_chunk.table.grasp_map[row][:, : 3 * count]
            )
    assert source.grasp(0) is source.grasp(0)


def test_bits_are_the_same_made_and_read_and_damaged(cache, monkeypatch) -> None:
    expected = all_bits(make_source())
    (file,) = cache.glob("*/*")
    content = file.read_bytes()
    with monkeypatch.context() as patch:
        patch.setattr(grasp_source, "make_chunk", never)
        assert all_bits(make_source()) == expected
    for damage in (b"", b"hello", content[:1000], content[: len(content) // 2] + bytes(999)):
        file.write_bytes(damage)
        assert all_bits(make_source()) == expected
        assert file.read_bytes() == content


def test_files_with_any_byte_changed_are_read_right_or_not_at_all(cache, first_chunk) -> None:
    attempts = make_source().attempts
    store = ChunkStore(cache, attempts)
    store.write(first_chunk)
    (file,) = cache.glob("*/*")
    content = file.read_bytes()
    rng = seeded(0)
    for place in rng.integers(len(content), size=300):
        damaged = bytearray(content)
        damaged[place] ^= int(rng.integers(1, 256))
        file.write_bytes(damaged)
        chunk = store.read(0)
        assert chunk is None or chunk.outcomes == first_chunk.outcomes
        if chunk is not None:
            np.testing.assert_array_equal(chunk.table.grasp_map, first_chunk.table.grasp_map)


READ = """
import hashlib, sys
from gfo_env.grasps.source import GraspSource
from gfo_env.hand import BARRETT_BH8_280
from gfo_env.objects import ObjectSet
from scripts.collect import CollectSettings, main
from tests.gfo_env.grasps.test_source import all_bits
source = GraspSource(ObjectSet("random_urdfs", "test"), BARRETT_BH8_280)
print(hashlib.sha256(repr(all_bits(source)).encode()).hexdigest(), "pybullet" in sys.modules)
"""


def read_in_a_new_process() -> subprocess.Popen[str]:
    return subprocess.Popen([sys.executable, "-c", READ], cwd=ROOT, stdout=-1, text=True)


def result(process: subprocess.Popen[str]) -> list[str]:
    out, _ = process.communicate(timeout=300)
    assert process.returncode == 0
    return out.split()[-2:]


def test_processes_that_fill_at_once_and_later_ones_agree(cache) -> None:
    together = [read_in_a_new_process() for _ in range(2)]
    one, two = (result(process) for process in together)
    assert one[0] == two[0]
    # a full cache needs no simulator
    assert result(read_in_a_new_process()) == [one[0], "False"]
    assert [path.name for path in cache.glob("*/*")] == ["000000.npz"]


def test_sources_travel_to_other_processes(cache, balls) -> None:
    source = make_source(ObjectSet(balls))
    here = all_bits(source)
    for other in (pickle.loads(pickle.dumps(source)), copy.deepcopy(source)):
        assert len(other) == len(source)
        assert all_bits(other) == here
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        assert pool.apply(all_bits, (source,)) == here


def test_slots_are_whole_rounds_over_the_objects(cache, balls) -> None:
    for objects in (HELD_OUT, ObjectSet("random_urdfs"), ObjectSet(balls)):
        source = make_source(objects)
        rounds, rest = divmod(len(source), len(objects))
        assert rest == 0
        assert rounds >= LEAST_ROUNDS
        assert len(source) >= LEAST_SLOTS
        tries = Counter(source.attempts.object_id(number) for number in range(len(source)))
        assert set(tries.values()) == {rounds}


def test_there_is_nothing_beyond_the_last_slot(cache, balls) -> None:
    source = make_source(ObjectSet(balls))
    assert len(source) % CHUNK
    source.grasp(len(source) - 1)
    for number in (len(source), -1):
        with pytest.raises(IndexError, match=f"no grasp {number}: the source has 2048 slots"):
            source.grasp(number)


def test_the_digest_tells_of_all_that_grasps_depend_on(balls, tmp_path, monkeypatch) -> None:
    def digest(**changes: object) -> str:
        settings = {"objects": ObjectSet(balls), "seed": 0} | changes
        return Attempts(**settings).digest()  # type: ignore[arg-type]

    urdf = tmp_path / "hand.urdf"
    urdf.write_text(BARRETT_BH8_280.urdf.read_text())
    moved = replace(BARRETT_BH8_280, urdf=tmp_path / "hand.urdf")
    digests = [
        digest(),
        digest(seed=1),
        digest(fingertips=True),
        digest(objects=ObjectSet(balls, target_size=0.06)),
        digest(objects=HELD_OUT),
        digest(objects=ObjectSet("random_urdfs", "all")),
        digest(hand=replace(BARRETT_BH8_280, closing_torque=0.9)),
        digest(hand=moved),
    ]
    urdf.write_text(
        urdf.read_text().replace("</robot>", '<mesh filename="package://a/tip.stl"/></robot>')
    )
    digests.append(digest(hand=moved))
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "tip.stl").write_text("mesh of a link")
    digests.append(digest(hand=moved))
    trimesh.creation.icosphere(radius=0.03).export(balls / "ball.stl")
    digests.append(digest())
    monkeypatch.setattr("gfo_env.grasps.attempts.version", lambda name: "0")
    digests.append(digest())
    assert len(set(digests)) == len(digests)
    assert digest() == digests[-1]


def test_digests_are_of_content_not_of_time(balls) -> None:
    before = make_source(ObjectSet(balls)).attempts.digest()
    os.utime(balls / "ball.stl")
    assert make_source(ObjectSet(balls)).attempts.digest() == before


def test_meshes_edited_under_a_source_do_not_spoil_the_cache(cache, balls) -> None:
    source = make_source(ObjectSet(balls))
    trimesh.creation.icosphere(radius=0.03).export(balls / "ball.stl")
    source.grasp(0)
    assert not list(cache.glob("*/*"))
    make_source(ObjectSet(balls)).grasp(0)
    assert len(list(cache.glob("*/*"))) == 1


def test_a_cache_that_cannot_be_written_costs_time_and_one_warning(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "other"))
    expected = all_bits(make_source(), 2 * CHUNK)
    (tmp_path / "file").write_text("not a folder")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    source = make_source()
    with pytest.warns(UserWarning, match="set XDG_CACHE_HOME") as caught:
        assert all_bits(source, 2 * CHUNK) == expected
    assert len(caught) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert all_bits(source, 2 * CHUNK) == expected
    with pytest.raises(OSError, match="file"):
        fill_cache(source)


def test_a_user_without_a_home_has_a_cache(monkeypatch) -> None:
    def homeless() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", homeless)
    assert make_source().store.folder is not None


def test_filling_gives_the_bytes_of_single_use_and_goes_on(cache, balls, monkeypatch) -> None:
    monkeypatch.setattr(grasp_source, "LEAST_SLOTS", 4 * CHUNK - 2)
    source = make_source(ObjectSet(balls))
    all_bits(source, len(source))
    single = {path.name: path.read_bytes() for path in cache.glob("*/*")}
    assert len(single) == 4
    for name in ("000001.npz", "000003.npz"):
        next(cache.glob(f"*/{name}")).unlink()
    resumed = fill_cache(source, workers=1)
    assert {path.name: path.read_bytes() for path in cache.glob("*/*")} == single
    assert len(resumed.attempt_ms) == 2 * CHUNK
    grasps = [source.grasp(number) for number in range(len(source))]
    assert resumed.attempts == len(source)
    assert resumed.grasps == sum(stored is not None for stored in grasps)
    full = fill_cache(source, workers=2).summary()
    assert full["attempt_ms_median"] is None
    assert full["grasps"] == resumed.grasps
    with pytest.raises(CollectionError, match="workers is 0"):
        fill_cache(source, workers=0)


def test_draws_are_seeded_and_cover_the_slots_evenly(cache, balls, monkeypatch) -> None:
    monkeypatch.setattr(grasp_source, "LEAST_SLOTS", 4 * CHUNK)
    source = make_source(ObjectSet(balls))
    rng = seeded(0)
    numbers = [source.draw(rng)[0] for _ in range(4000)]
    again = seeded(0)
    fresh = make_source(ObjectSet(balls))
    assert numbers[:100] == [fresh.draw(again)[0] for _ in range(100)]
    full = [number for number in range(len(source)) if source.grasp(number) is not None]
    counts = Counter(numbers)
    assert sorted(counts) == full
    expected = len(numbers) / len(full)
    assert max(abs(count - expected) for count in counts.values()) < 6 * expected**0.5


def test_draws_obey_what_is_accepted(cache, balls, monkeypatch) -> None:
    monkeypatch.setattr(grasp_source, "LEAST_SLOTS", 4 * CHUNK)
    source = make_source(ObjectSet(balls))
    rng = seeded(1)
    for _ in range(20):
        number, stored = source.draw(rng, lambda stored: stored.grasp.object_id == "box.ply")
        assert stored is source.grasp(number)
        assert stored.grasp.object_id == "box.ply"


def test_draws_that_nothing_satisfies_end_with_the_reasons(cache, balls, monkeypatch) -> None:
    monkeypatch.setattr(grasp_source, "LEAST_SLOTS", CHUNK)
    source = make_source(ObjectSet(balls))
    refused = r"None of 200 .* x a grasp that the settings rule out.*max_contacts"
    with pytest.raises(AcquisitionError, match=refused):
        source.draw(seeded(0), lambda stored: False)


@pytest.mark.parametrize(
    ("radius", "reason"), [(0.0003, "fewer than three links"), (2.0, "metres")]
)
def test_objects_that_cannot_be_grasped_are_named_soon(radius, reason, cache, tmp_path) -> None:
    folder = tmp_path / "hopeless"
    folder.mkdir()
    trimesh.creation.icosphere(radius=radius).export(folder / "ball.stl")
    source = make_source(ObjectSet(folder))
    with pytest.raises(AcquisitionError, match=rf"None of 200 .*hopeless.*{reason}.*3 to 15 cm"):
        source.draw(seeded(0))
    assert len(list(cache.glob("*/*"))) == 200 // CHUNK


@pytest.fixture(scope="module")
def table() -> GraspTable:
    return collect(CollectionPlan(HELD_OUT, 20, 3))[0]


def test_tables_are_sources(table, tmp_path) -> None:
    table.save(tmp_path / "t.npz")
    source = GraspSource(HELD_OUT, BARRETT_BH8_280, path=tmp_path / "t.npz")
    assert len(source) == 20
    for number in range(20):
        stored = source.grasp(number)
        assert stored is not None
        assert stored is source.grasp(number)
        assert stored.radius == table.object_radius[number]
        assert stored.grasp.object_id == table.object_id[number]
    (tmp_path / "t.npz").unlink()
    assert all_bits(pickle.loads(pickle.dumps(source)), 20) == all_bits(source, 20)
    number, stored = source.draw(seeded(0))
    assert stored is source.grasp(number)
    with pytest.raises(IndexError, match="no grasp 20"):
        source.grasp(20)
    with pytest.raises(AcquisitionError, match="settings rule out"):
        source.draw(seeded(0), lambda stored: False)


def test_tables_that_do_not_fit_are_refused(table, tmp_path) -> None:
    path = tmp_path / "t.npz"

    def read(objects: ObjectSet = HELD_OUT, **changes: object) -> None:
        fingertips = bool(changes.pop("ask_fingertips", False))
        replace(table, **changes).save(path)  # type: ignore[arg-type]
        GraspSource(objects, BARRETT_BH8_280, fingertips=fingertips, path=path)

    read()
    with pytest.raises(GraspTableError, match=r"other_hand.*not by 'barrett_bh8_280'"):
        read(hand="other_hand")
    with pytest.raises(GraspTableError, match="torque limits"):
        read(max_torque=table.max_torque * 2)
    with pytest.raises(GraspTableError, match="joint"):
        read(joint_angles=table.joint_angles[:, :7])
    with pytest.raises(GraspTableError, match="collected with --contacts hand"):
        read(ask_fingertips=True)
    with pytest.raises(GraspTableError, match="collected with --contacts fingertips"):
        read(fingertips=True)
    with pytest.raises(GraspTableError, match=r"target_size=0\.1"):
        read(target_size=0.1)
    with pytest.raises(GraspTableError, match=r"objects that are not in .*split='train'"):
        read(ObjectSet("random_urdfs", "train"))
    with pytest.raises(GraspTableError, match="no grasps at"):
        GraspSource(HELD_OUT, BARRETT_BH8_280, path=tmp_path / "missing.npz")


def test_the_command_fills_the_cache_or_writes_a_table(cache, balls, monkeypatch, capsys) -> None:
    monkeypatch.setattr(grasp_source, "LEAST_SLOTS", 2 * CHUNK)
    for settings in (CollectSettings(), CollectSettings(output=Path("x.npz"), cache=True)):
        with pytest.raises(CollectionError, match="--output FILE, or --cache"):
            main(settings)
    settings = CollectSettings(cache=True, objects=str(balls), workers=1)
    for _ in range(2):
        main(settings)
        assert "of 10 attempts" in capsys.readouterr().out
    (folder,) = cache.iterdir()
    assert folder == make_source(ObjectSet(str(balls))).store.folder
    assert len(list(folder.iterdir())) == 2
