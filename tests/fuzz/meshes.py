"""Mesh files as people have them, or nobody should: a body that is right, or one clear error."""

import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from gfo_env.objects import GraspObject, ObjectSet, Patches
from gfo_env.objects.meshes import make_body
from tests.fuzz.outcome import WrongAnswer, tell

_SUFFIXES = ("stl", "obj", "ply", "off", "glb")


def _box(rng: np.random.Generator) -> trimesh.Trimesh:
    return trimesh.creation.box(rng.uniform(0.03, 0.09, 3))


def _cylinder(rng: np.random.Generator) -> trimesh.Trimesh:
    radius, height = rng.uniform(0.02, 0.05, 2)
    return trimesh.creation.cylinder(radius, 2 * height, sections=int(rng.integers(5, 40)))


def _sphere(rng: np.random.Generator) -> trimesh.Trimesh:
    return trimesh.creation.icosphere(int(rng.integers(1, 4)), rng.uniform(0.02, 0.05))


def _ring(rng: np.random.Generator) -> trimesh.Trimesh:
    inner, wall = rng.uniform(0.01, 0.03), rng.uniform(0.005, 0.02)
    return trimesh.creation.annulus(inner, inner + wall, rng.uniform(0.01, 0.05), sections=16)


def _ell(rng: np.random.Generator) -> trimesh.Trimesh:
    """An L of two boxes, its corners a hair off the straight line now and then."""
    outline = np.array([(0, 0), (4, 0), (4, 1.5), (1.5, 1.5), (1.5, 3), (0, 3)], dtype=float)
    if rng.random() < 0.5:
        outline += 10.0 ** rng.uniform(-9, -5) * rng.standard_normal(outline.shape)
    arms = [
        trimesh.creation.box((0.04, 0.015, 0.01), _moved(0.02, 0.0075)),
        trimesh.creation.box((0.015, 0.03, 0.01), _moved(0.0075, 0.015)),
    ]
    mesh = trimesh.boolean.union(arms)
    if rng.random() < 0.5:
        mesh.vertices += 10.0 ** rng.uniform(-9, -6) * rng.standard_normal(mesh.vertices.shape)
    return mesh


def _moved(x: float, y: float) -> Any:
    return trimesh.transformations.translation_matrix((x, y, 0.0))


_SHAPES = (_box, _box, _cylinder, _sphere, _ring, _ell)


def _as_it_is(_: np.random.Generator, mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    return mesh


def _with(mesh: trimesh.Trimesh, vertices: Any, faces: Any) -> trimesh.Trimesh:
    return trimesh.Trimesh(vertices, faces, process=False)


def _inverted(_: np.random.Generator, mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    return _with(mesh, mesh.vertices, mesh.faces[:, ::-1])


def _doubled(_: np.random.Generator, mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    return _with(mesh, mesh.vertices, np.vstack([mesh.faces, mesh.faces[:, ::-1]]))


def _repeated(rng: np.random.Generator, mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    some = rng.integers(0, len(mesh.faces), max(len(mesh.faces) // 3, 1))
    return _with(mesh, mesh.vertices, np.vstack([mesh.faces, mesh.faces[some]]))


def _soup(_: np.random.Generator, mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Every triangle with corners of its own."""
    vertices = mesh.vertices[mesh.faces].reshape(-1, 3)
    return _with(mesh, vertices, np.arange(len(vertices)).reshape(-1, 3))


def _mixed_winding(rng: np.random.Generator, mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    faces = mesh.faces.copy()
    chosen = rng.random(len(faces)) < 0.3
    faces[chosen] = faces[chosen, ::-1]
    return _with(mesh, mesh.vertices, faces)


def _degenerate(rng: np.random.Generator, mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Triangles without an area beside the others."""
    some = mesh.faces[rng.integers(0, len(mesh.faces), 5)]
    flat = np.column_stack([some[:, 0], some[:, 1], some[:, 1]])
    return _with(mesh, mesh.vertices, np.vstack([mesh.faces, flat]))


def _stray(rng: np.random.Generator, mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Corners that no triangle has, some of them no numbers."""
    more = rng.standard_normal((4, 3))
    more[0] = rng.choice([np.nan, np.inf, 1e30, 0.0])
    return _with(mesh, np.vstack([mesh.vertices, more]), mesh.faces)


SAME: tuple[Callable[..., trimesh.Trimesh], ...] = (
    *(_as_it_is, _inverted, _doubled, _repeated, _soup, _mixed_winding, _degenerate, _stray),
)
"""The solid is what it was: its volume is known."""

MAY_BE_REFUSED = (_stray,)
"""A corner that is no number says that something is wrong with the file."""


def _flipped_coordinate(rng: np.random.Generator, mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    vertices = np.array(mesh.vertices)
    vertices[rng.integers(len(vertices)), rng.integers(3)] *= -1.0
    return _with(mesh, vertices, mesh.faces)


def _noise(rng: np.random.Generator, mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    size = 10.0 ** rng.uniform(-6, -1)
    return _with(mesh, mesh.vertices + size * rng.standard_normal(mesh.vertices.shape), mesh.faces)


def _holes(rng: np.random.Generator, mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    kept = rng.random(len(mesh.faces)) > rng.choice([0.05, 0.5])
    return _with(mesh, mesh.vertices, mesh.faces[kept])


def _overlap(rng: np.random.Generator, mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    other = mesh.copy()
    other.apply_translation(rng.uniform(-0.03, 0.03, 3))
    return trimesh.util.concatenate([mesh, other])


def _welded(rng: np.random.Generator, mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Two solids that share a corner, or a face, and all their other corners."""
    other = mesh.copy()
    shift = np.zeros(3)
    shift[rng.integers(3)] = np.ptp(mesh.bounds, axis=0)[0]
    other.apply_translation(shift)
    both = trimesh.util.concatenate([mesh, other])
    both.merge_vertices()
    return both


def _scaled(rng: np.random.Generator, mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    factor = 10.0 ** rng.choice([-160, -30, -9, -3, 3, 6, 30, 150])
    return _with(mesh, mesh.vertices * factor, mesh.faces)


def _far(rng: np.random.Generator, mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    return _with(mesh, mesh.vertices + 10.0 ** rng.uniform(0, 9), mesh.faces)


def _flat(rng: np.random.Generator, mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    factor = rng.choice([0.0, 1e-12, 1e-6, 1e-3])
    return _with(mesh, mesh.vertices * [1.0, 1.0, factor], mesh.faces)


def _shuffled(rng: np.random.Generator, mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    return _with(mesh, mesh.vertices, rng.permuted(mesh.faces, axis=0))


def _random(rng: np.random.Generator, mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    count = int(rng.choice([1, 4, 40, 400]))
    faces = rng.integers(0, len(mesh.vertices), (count, 3))
    return _with(mesh, mesh.vertices, faces)


def _empty(rng: np.random.Generator, mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    return _with(mesh, mesh.vertices, mesh.faces[:0])


def _not_numbers(rng: np.random.Generator, mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    vertices = np.array(mesh.vertices)
    vertices[rng.integers(len(vertices)), rng.integers(3)] = rng.choice([np.nan, np.inf, 1e308])
    return _with(mesh, vertices, mesh.faces)


def _fine(rng: np.random.Generator, mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Many faces."""
    fine = mesh
    while len(fine.faces) < rng.choice([2_000, 20_000]):
        fine = fine.subdivide()
    return fine


CHANGED: tuple[Callable[..., trimesh.Trimesh], ...] = (
    *(_flipped_coordinate, _flipped_coordinate, _noise, _holes, _overlap, _welded, _scaled, _far),
    *(_flat, _shuffled, _random, _empty, _not_numbers, _fine),
)


def prepare() -> None:
    """Load what makes bodies."""
    make_body(_box(np.random.default_rng(0)))


def try_mesh(rng: np.random.Generator) -> str:
    """A shape, changed, written in some format and read back as an object."""
    shape = _SHAPES[rng.integers(len(_SHAPES))](rng)
    same = rng.random() < 0.4
    change = (SAME if same else CHANGED)[rng.integers(len(SAME if same else CHANGED))]
    mesh = change(rng, shape)
    suffix = str(rng.choice(_SUFFIXES))
    what = f"{shape.metadata.get('shape', 'solid')}, {change.__name__.strip('_')}, {suffix}"
    tell(what)
    path = Path(f"it.{suffix}")
    try:
        mesh.export(path)
    # not every mesh can be written in every format, and that is not ours
    except Exception as error:  # noqa: BLE001
        return f"{what}: not written ({type(error).__name__})"
    try:
        body = read_and_checked(path)
    finally:
        path.unlink()
    if same:
        error = abs(body.volume / abs(shape.volume) - 1.0)
        if error > 1e-3:
            raise WrongAnswer(f"a volume of {body.volume:.3e}, right {shape.volume:.3e} m3")
    if rng.random() < 0.3:
        Patches(body.solid)
    return what


def read_and_checked(path: Path) -> GraspObject:
    """The object in a file, of which everything is true that is true of every object."""
    # a folder of its own: a set holds all files of its folder
    with tempfile.TemporaryDirectory() as folder:
        shutil.copy(path, folder)
        body = ObjectSet(folder)[path.name]
    _check(body)
    return body


def _check(body: GraspObject) -> None:
    numbers = np.array([body.mass, body.volume, *body.inertia.ravel()])
    if not np.isfinite(numbers).all() or body.volume <= 0.0 or body.mass <= 0.0:
        raise WrongAnswer(f"mass {body.mass}, volume {body.volume}")
    if not body.solid.is_watertight or not body.parts:
        raise WrongAnswer("an open solid, or no parts")
    if np.linalg.norm(body.solid.center_mass) > 1e-6 * body.radius:
        raise WrongAnswer(f"the centre of mass is {body.solid.center_mass}")
    moments = np.linalg.eigvalsh(body.inertia)
    if moments[0] <= 0.0 or moments[2] > (moments[0] + moments[1]) * (1 + 1e-6):
        raise WrongAnswer(f"moments of inertia {moments}")
    parts = sum(part.volume for part in body.parts)
    unit = trimesh.PointCloud(body.solid.vertices / body.radius).convex_hull.volume
    largest = max(part.volume for part in body.parts)
    if parts < 0.9 * body.volume or largest > 1.01 * unit * body.radius**3:
        raise WrongAnswer(f"parts of {parts:.3e} m3 for a solid of {body.volume:.3e} m3")
