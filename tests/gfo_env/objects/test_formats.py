"""Readers take every face for what it is, and refuse what is damaged in one way."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from gfo_env.exceptions import MeshError
from gfo_env.objects.formats import READERS, read_polygons
from gfo_env.objects.meshes import SUPPORTED_SUFFIXES, make_body, read_mesh
from gfo_env.objects.polygons import triangulate
from solvers.arrays import Array
from tests.support.problems import random_rotation
from tests.support.seeds import SEEDS, seeded
from tests.support.shapes import box, union_volume

ELL = np.array([(4, 1.5), (1.5, 1.5), (1.5, 3), (0, 3), (0, 0), (4, 0)]) * 0.01
DART = np.array([(0, 0), (4, 1), (0, 2), (1, 1)]) * 0.01
Polygons = list[list[int]]


def prism(ring: Array, height: float = 0.02) -> tuple[Array, Polygons]:
    """Vertices and faces of a prism over a ring (n, 2) that runs counterclockwise."""
    n = len(ring)
    bottom, top = np.c_[ring, np.zeros(n)], np.c_[ring, np.full(n, height)]
    sides = [[i, (i + 1) % n, (i + 1) % n + n, i + n] for i in range(n)]
    ends = [list(range(n))[::-1], list(range(n, 2 * n))]
    return np.vstack([bottom, top]), [*ends, *sides]


def area(ring: Array) -> float:
    x, y = ring.T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2


def perimeter(ring: Array) -> float:
    return float(np.linalg.norm(ring - np.roll(ring, 1, axis=0), axis=1).sum())


def star(rng: np.random.Generator, corners: int) -> Array:
    """A ring (n, 2) that is hollow at will, and seen whole from the origin."""
    gaps = 0.3 / corners + 0.7 * rng.dirichlet(np.ones(corners))
    angles = 2 * np.pi * np.cumsum(gaps)
    reach = rng.uniform(0.01, 0.05, corners)
    return reach[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)


# Polygons


@settings(max_examples=60)
@given(seed=SEEDS, corners=st.integers(3, 12))
def test_triangles_cover_a_hollow_polygon_and_nothing_else(seed: int, corners: int) -> None:
    rng = seeded(seed)
    ring = star(rng, corners)
    rotation = random_rotation(rng)
    vertices, faces = prism(ring)
    faces = [list(np.roll(face, rng.integers(len(face)))) for face in faces]
    triangles = triangulate(vertices @ rotation.T, faces)
    mesh = trimesh.Trimesh(vertices, triangles, process=False)
    assert mesh.is_volume
    assert len(triangles) == sum(len(face) - 2 for face in faces)
    assert_allclose(mesh.volume, area(ring) * 0.02, rtol=1e-9)
    # triangles outside, or over one another, would have more area than the polygon
    assert_allclose(mesh.area, 2 * area(ring) + perimeter(ring) * 0.02, rtol=1e-9)


def test_convex_polygons_are_cut_from_their_first_corner() -> None:
    hexagon = np.array([(np.cos(t), np.sin(t), 0) for t in np.arange(6) * np.pi / 3])
    assert_array_equal(
        triangulate(hexagon, [[1, 2, 3, 4, 5, 0]]), [[1, 2, 3], [1, 3, 4], [1, 4, 5], [1, 5, 0]]
    )


def test_face_of_no_area_and_faces_of_two_corners_are_no_trouble() -> None:
    line = np.array([(0.0, 0, 0), (1, 0, 0), (2, 0, 0), (3, 0, 0), (4, 0, 0)])
    assert len(triangulate(line, [[0, 1, 2, 3, 4], [0, 1], [2]])) == 3


@pytest.mark.parametrize("corner", [-1, 3])
def test_corner_that_is_no_vertex_is_an_error(corner: int) -> None:
    with pytest.raises(ValueError, match="none of the 3 vertices"):
        triangulate(np.eye(3), [[0, 1, corner]])


# Files


def obj(vertices: Array, faces: Polygons) -> bytes:
    lines = ["v {:.17g} {:.17g} {:.17g}".format(*tuple(v)) for v in vertices]
    return "\n".join([*lines, *("f " + " ".join(str(k + 1) for k in f) for f in faces)]).encode()


def off(vertices: Array, faces: Polygons) -> bytes:
    lines = [f"OFF\n{len(vertices)} {len(faces)} 0"]
    lines += ["{:.17g} {:.17g} {:.17g}".format(*tuple(v)) for v in vertices]
    return "\n".join([*lines, *(" ".join(map(str, [len(f), *f])) for f in faces)]).encode()


def ply(vertices: Array, faces: Polygons, order: str = "") -> bytes:
    name = {"": "ascii", "<": "binary_little_endian", ">": "binary_big_endian"}[order]
    head = f"""ply
format {name} 1.0
comment made by hand
element vertex {len(vertices)}
property double x
property double y
property double z
property uchar red
element face {len(faces)}
property list uchar int vertex_indices
property float quality
end_header
"""
    if not order:
        rows = ["{:.17g} {:.17g} {:.17g} 7".format(*tuple(v)) for v in vertices]
        rows += [" ".join(map(str, [len(f), *f, 0.5])) for f in faces]
        return (head + "\n".join(rows) + "\n").encode()
    colour, quality = np.array(7, "u1").tobytes(), np.array(0.5, f"{order}f4").tobytes()
    body = [v.astype(f"{order}f8").tobytes() + colour for v in vertices]
    body += [bytes([len(f)]) + np.array(f, f"{order}i4").tobytes() + quality for f in faces]
    return head.encode() + b"".join(body)


WRITERS = {
    "obj": (".obj", obj),
    "off": (".off", off),
    "ply, text": (".ply", ply),
    "ply, little endian": (".ply", lambda v, f: ply(v, f, "<")),
    "ply, big endian": (".ply", lambda v, f: ply(v, f, ">")),
}
every_format = pytest.mark.parametrize("kind", WRITERS)


@every_format
@pytest.mark.parametrize("ring", [ELL, DART], ids=["six corners", "four corners"])
def test_hollow_faces_are_read_as_they_are(tmp_path: Path, kind: str, ring: Array) -> None:
    suffix, write = WRITERS[kind]
    path = tmp_path / f"hollow{suffix}"
    path.write_bytes(write(*prism(ring)))
    mesh = read_mesh(path)
    assert mesh.is_volume
    assert_allclose(mesh.area, 2 * area(ring) + perimeter(ring) * 0.02, rtol=1e-12)
    assert_allclose(mesh.volume, area(ring) * 0.02, rtol=1e-12)


def test_ell_of_polygons_becomes_two_boxes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("coacd")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    (tmp_path / "ell.obj").write_bytes(obj(*prism(ELL)))
    body = make_body(read_mesh(tmp_path / "ell.obj"))
    assert len(body.parts) == 2
    assert_allclose(union_volume(body.parts), body.volume, rtol=1e-3)


@pytest.mark.parametrize("suffix", READERS)
def test_triangles_are_those_that_were_written(tmp_path: Path, suffix: str) -> None:
    shape = trimesh.creation.icosphere(subdivisions=2)
    shape.export(tmp_path / f"ball{suffix}")
    vertices, triangles = read_polygons(tmp_path / f"ball{suffix}")
    assert_allclose(vertices, shape.vertices, atol=1e-7)
    assert_array_equal(triangles, shape.faces)


def test_obj_with_all_that_it_may_have() -> None:
    text = b"""# a tetrahedron
mtllib none.mtl
o thing
v 0 0 0 0.1 0.2 0.3
v 1 0 0\r
v 0 \\
1 0
vt 0 0
vn 0 0 1
usemtl red
f 1/1/1 3/1/1 2/1/1 # the bottom
v 0 0 1
s off
f -4//1 -3//1 -1//1
f 2 3 4
f 3 1 4
l 1 2
v 9 9 9
"""
    vertices, faces = READERS[".obj"](text)
    assert_array_equal(vertices, [*np.vstack([np.zeros(3), np.eye(3)]), [9, 9, 9]])
    assert faces == [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]


def test_vertices_that_no_face_has_are_left_out(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_bytes(obj(*prism(DART)) + b"\nv 99 99 99\n")
    assert np.abs(read_mesh(tmp_path / "a.obj").vertices).max() < 1


def test_off_with_counts_beside_the_keyword_and_colours() -> None:
    text = b"COFF 3 1 0 # counts\n\n0 0 0 255 0 0\n1 0 0 255 0 0\n0 1 0 255 0 0\n3 0 1 2 0.5 0.5\n"
    vertices, faces = READERS[".off"](text)
    assert_array_equal(vertices, [[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    assert faces == [[0, 1, 2]]


@every_format
@settings(max_examples=40)
@given(data=st.data())
def test_damaged_files_are_read_or_refused(
    kind: str, data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    suffix, write = WRITERS[kind]
    content = bytearray(write(*prism(ELL)))
    if data.draw(st.booleans(), "cut"):
        del content[data.draw(st.integers(0, len(content) - 1), "length") :]
    else:
        place = data.draw(st.integers(0, len(content) - 1), "place")
        content[place] ^= 1 << data.draw(st.integers(0, 7), "bit")
    path = tmp_path_factory.mktemp("damaged") / f"file{suffix}"
    path.write_bytes(content)
    try:
        mesh = read_mesh(path)
    except MeshError:
        return  # anything else is a failure
    assert mesh.faces.min() >= 0
    assert mesh.faces.max() < len(mesh.vertices)


TEXT = "ply\nformat ascii 1.0\n"


@pytest.mark.parametrize(
    ("suffix", "text", "message"),
    [
        (
            ".ply",
            "ply\nformat ascii 1.0\nelement vertex 9999999999\nproperty float x\nend_header\n",
            "ends",
        ),
        (".ply", "ply\nformat ascii 1.0\nelement vertex -1\nend_header\n", "makes no sense"),
        (".ply", "ply\nformat 7 1.0\nend_header\n", "makes no sense"),
        (".off", "OFF\n9999999999 1 0\n", "ends before"),
        (".off", "OFF BINARY\n", "text file"),
        (".obj", "v 1 2\nf 1 1 1\n", "three coordinates"),
        (".obj", "v 0 0 0\nf 0 1 1\n", "number 0"),
    ],
)
def test_what_is_wrong_with_a_file_is_said(
    tmp_path: Path, suffix: str, text: str, message: str
) -> None:
    path = tmp_path / f"bad{suffix}"
    path.write_text(text)
    with pytest.raises(MeshError, match=rf"bad{suffix} cannot be read.*{message}"):
        read_mesh(path)


def test_textures_of_a_scene_are_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    image = pytest.importorskip("PIL.Image")
    scene = trimesh.Scene()
    for k in range(2):
        part = box((0.04, 0.05, 0.06), (0.1 * k, 0, 0))
        part.visual = trimesh.visual.TextureVisuals(
            uv=seeded(k).random((len(part.vertices), 2)), image=image.new("RGB", (8, 8))
        )
        scene.add_geometry(part)
    scene.export(tmp_path / "boxes.glb")
    monkeypatch.setattr(image, "open", lambda *_, **__: pytest.fail("a texture was read"))
    assert set(READERS) < set(SUPPORTED_SUFFIXES)
    assert_allclose(make_body(read_mesh(tmp_path / "boxes.glb")).volume, 240e-6, rtol=1e-6)
