"""Convex parts come whatever the library does, and are made once."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import manifold3d
import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose, assert_array_equal

from gfo_env.exceptions import MeshWarning
from gfo_env.objects import decomposition
from gfo_env.objects.decomposition import Decomposition, decompose
from gfo_env.objects.meshes import make_body
from tests.support.seeds import seeded
from tests.support.shapes import assert_rigid_body, box, joined, l_shape, union_volume

pytest.importorskip("coacd")


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "graspforce" / "convex_parts"


def solid(mesh: trimesh.Trimesh) -> manifold3d.Manifold:
    return manifold3d.Manifold(
        manifold3d.Mesh64(np.array(mesh.vertices), np.array(mesh.faces, dtype=np.uint64))
    )


def slow() -> trimesh.Trimesh:
    """A lumpy ball of many concave places, which takes CoACD much longer than a second."""
    ball = trimesh.creation.icosphere(subdivisions=4)
    lumps = 1.0 + 0.2 * np.sin(9.0 * ball.vertices).sum(axis=1)
    return trimesh.Trimesh(0.04 * lumps[:, None] * ball.vertices, ball.faces, process=False)


def crossed() -> trimesh.Trimesh:
    """Two bars, one askew through the other."""
    bars = [box((0.1, 0.02, 0.03)), box((0.02, 0.09, 0.04), (0.02, 0.01, 0.01))]
    turn = trimesh.transformations.rotation_matrix(0.4, (1, 2, 3))
    return trimesh.boolean.union([bars[0], bars[1].apply_transform(turn)])


def same(one: Decomposition, other: Decomposition) -> bool:
    assert len(one.points) == len(other.points)
    for first, second in zip(one.points, other.points, strict=True):
        assert_array_equal(first, second)
    return one.made_by == other.made_by


def plate(seed: int) -> trimesh.Trimesh:
    """An L-shaped plate whose outline has corners a hair off its straight lines."""
    rng = np.random.default_rng(seed)
    corners = np.array([(0, 0), (4, 0), (4, 1.5), (1.5, 1.5), (1.5, 3), (0, 3)])
    hair, extra, ring = 10.0 ** rng.uniform(-9, -6.5), rng.integers(1, 4), []
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        along = (end - start) / np.linalg.norm(end - start)
        ring.append(start)
        for share in np.sort(rng.uniform(0.1, 0.9, extra)):
            off = hair * rng.uniform(-1, 1) * np.array([-along[1], along[0]])
            ring.append(start + share * (end - start) + off)
    points = np.array(ring) * 0.01
    if rng.random() < 0.7:
        turn = rng.uniform(0, 2 * np.pi)
        cos, sin = np.cos(turn), np.sin(turn)
        points = points @ np.array([[cos, sin], [-sin, cos]]) + rng.uniform(-0.02, 0.02, 2)
    outline = np.asarray(manifold3d.triangulate([points]))
    return trimesh.creation.extrude_triangulation(points, outline, 0.01)


@pytest.mark.filterwarnings("ignore::gfo_env.exceptions.MeshWarning")
@pytest.mark.parametrize("seed", [16, 21, 30])
def test_a_library_that_aborts_leaves_a_body(seed: int) -> None:
    body = make_body(plate(seed))
    assert_rigid_body(body)
    assert_allclose(body.volume, 8.25e-6, rtol=1e-6)
    assert 0.9 < union_volume(body.parts) / body.volume < 1.5


def attempts(monkeypatch: pytest.MonkeyPatch, *failing: str) -> None:
    """Make attempts fail: their settings are none that the methods know."""
    for name in failing:
        attempt = getattr(decomposition, name)
        broken = decomposition._Attempt(
            attempt.name, attempt.package, attempt.method, {"nonsense": 1}, attempt.seconds
        )
        monkeypatch.setattr(decomposition, name, broken)


@pytest.mark.parametrize(
    ("failing", "made_by"),
    [
        (("_FINE",), "CoACD with coarser settings"),
        (("_FINE", "_COARSE"), "V-HACD"),
        (("_FINE", "_COARSE", "_OTHER"), "its convex hull"),
    ],
)
def test_what_stands_in_is_named_each_time(
    monkeypatch: pytest.MonkeyPatch, cache: Path, failing: tuple[str, ...], made_by: str
) -> None:
    attempts(monkeypatch, *failing)
    for _ in range(2):  # made, and from the cache
        with pytest.warns(MeshWarning, match=f"CoACD does not cope with the cross.*{made_by}"):
            body = make_body(crossed(), "the cross")
        assert_rigid_body(body)
        assert union_volume(body.parts) >= 0.95 * body.volume
        assert len(list(cache.iterdir())) == 1
    hull = crossed().convex_hull.volume
    assert union_volume(body.parts) <= (1.0 + 1e-9) * hull


def test_time_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    endless = decomposition._Attempt("CoACD", "coacd", "coacd", {"mcts_iterations": 10_000}, 1)
    monkeypatch.setattr(decomposition, "_FINE", endless)
    attempts(monkeypatch, "_COARSE", "_OTHER")
    assert decompose(solid(slow())).made_by == "its convex hull"


def test_process_dies_with_the_one_that_waits_for_it(tmp_path: Path) -> None:
    slow().export(tmp_path / "slow.stl")
    code = (
        "import sys, gfo_env.objects.decomposition as d\n"
        "d._FINE = d._Attempt('CoACD', 'coacd', 'coacd', {'mcts_iterations': 10000}, 500)\n"
        "from gfo_env.objects import load_body\n"
        "load_body(__import__('pathlib').Path(sys.argv[1]))\n"
    )
    command = [sys.executable, "-c", code, str(tmp_path / "slow.stl")]
    with subprocess.Popen(command) as parent:
        children = Path(f"/proc/{parent.pid}/task/{parent.pid}/children")
        deadline = time.monotonic() + 120
        while not (found := children.read_text().split()) and time.monotonic() < deadline:
            time.sleep(0.1)
        (child,) = found
        time.sleep(1.0)  # the child has to have begun
        assert Path(f"/proc/{child}").exists()
        parent.send_signal(signal.SIGKILL)
    while Path(f"/proc/{child}").exists() and time.monotonic() < deadline:
        if "(zombie)" in Path(f"/proc/{child}/status").read_text():
            break
        time.sleep(0.1)
    else:
        assert not Path(f"/proc/{child}").exists()


@pytest.mark.filterwarnings("error")
def test_any_flipped_bit_in_the_cache_is_mended(cache: Path) -> None:
    made = decompose(solid(l_shape()))
    (kept,) = cache.iterdir()
    whole = kept.read_bytes()
    rng = seeded(0)
    for place in rng.integers(0, len(whole), 300):
        damaged = bytearray(whole)
        damaged[place] ^= 1 << int(rng.integers(8))
        kept.write_bytes(damaged)
        known = decomposition._read(kept)
        assert known is None or same(known, made)
    for content in (b"", whole[: len(whole) // 2], bytes(100)):
        kept.write_bytes(content)
        assert decomposition._read(kept) is None
    assert same(decompose(solid(l_shape())), made)
    assert len(kept.read_bytes()) == len(whole)


def test_nothing_is_made_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    made = decompose(solid(l_shape()))
    monkeypatch.setattr(decomposition, "_run", lambda *_: pytest.fail("the cache was not used"))
    assert same(decompose(solid(l_shape())), made)


# What is nearly convex


def bevelled_cube() -> trimesh.Trimesh:
    """20 mm, its edges rounded, of some ten thousand triangles."""
    ball = manifold3d.Manifold.sphere(2.0, 32)
    return _mesh(manifold3d.Manifold.cube((16.0, 16.0, 16.0), True).minkowski_sum(ball))


def _mesh(shape: manifold3d.Manifold) -> trimesh.Trimesh:
    mesh = shape.to_mesh64()
    return trimesh.Trimesh(
        1e-3 * np.array(mesh.vert_properties)[:, :3], np.array(mesh.tri_verts), process=False
    )


def test_what_is_convex_to_a_percent_is_one_part(cache: Path) -> None:
    dent = box((0.06, 0.003, 0.002), (0, 0, 0.02))
    dented = trimesh.boolean.difference([box((0.06, 0.05, 0.04)), dent])
    assert 0.99 < dented.volume / dented.convex_hull.volume < 1.0 - 1e-4
    for mesh in (dented, bevelled_cube()):
        body = make_body(mesh)
        assert_rigid_body(body)
        assert_allclose(body.volume, mesh.volume, rtol=1e-6)
        (part,) = body.parts
        assert_allclose(part.volume, mesh.convex_hull.volume, rtol=0.02)
    assert not cache.exists()


def test_components_are_nearly_convex_one_by_one(cache: Path) -> None:
    dent = box((0.06, 0.003, 0.002), (0, 0, 0.02))
    dented = trimesh.boolean.difference([box((0.06, 0.05, 0.04)), dent])
    body = make_body(joined(dented, box((0.02, 0.02, 0.2))))
    assert_rigid_body(body)
    assert len(body.parts) == 2
    assert not cache.exists()


def test_many_faces_take_no_longer_than_few(cache: Path) -> None:
    fine = l_shape()
    while len(fine.faces) < 60_000:
        fine = fine.subdivide()
    parts = make_body(fine).parts
    assert 2 <= len(parts) <= 4
    assert_allclose(union_volume(parts), l_shape().volume, rtol=0.01)
