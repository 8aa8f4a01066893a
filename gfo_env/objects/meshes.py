"""From a mesh file to the geometry of a rigid body: one solid and the convex parts that collide.

Frames and units: a `Body` has its origin at the centre of mass of the solid (uniform density) and
the axes of the file; lengths are metres if the file is in metres.

The work is done by Manifold (https://github.com/elalish/manifold) in double precision: it merges
overlapping components exactly once, so that volume and inertia are those of the union.
"""

import hashlib
import warnings
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import manifold3d
import numpy as np
import trimesh
from numpy.typing import NDArray

from gfo_env.cache import cache_folder
from gfo_env.exceptions import MeshError
from solvers.exceptions import MissingDependencyError
from solvers.files import write_atomically

SUPPORTED_SUFFIXES = (".glb", ".obj", ".off", ".ply", ".stl")

MAX_PART_VERTICES = 256
"""Most vertices of a convex part. Bullet's support function visits every vertex, so cost grows
with it; at 256 a ball's parts stay within 2 % of its radius."""

_CONVEX_SHARE = 1e-5
"""A component counts as convex if its hull is larger by no more than this share of the volume."""

_COACD_SETTINGS = {"threshold": 0.05, "preprocess_mode": "auto", "seed": 0}
"""CoACD's own default concavity (Wei et al. 2022, section 5), relative to the mesh's size."""


@dataclass(frozen=True, eq=False)
class Body:
    """A uniform solid and the convex parts that stand for it in collisions.

    Both are in the body's frame: origin at the centre of mass, axes of the file.

    Attributes:
        solid: watertight mesh, its triangles outward.
        parts: convex hulls of at most `MAX_PART_VERTICES` vertices each, whose union is the solid:
            exactly so for convex components of few vertices, nearly so for others. Cavities that
            are closed off are filled, since nothing can touch them from outside.
    """

    solid: trimesh.Trimesh
    parts: tuple[trimesh.Trimesh, ...]

    @property
    def volume(self) -> float:
        """Volume of the solid, m3."""
        return float(self.solid.volume)

    @property
    def inertia_per_density(self) -> NDArray[np.float64]:
        """Inertia tensor (3, 3) about the centre of mass over the density, m5."""
        inertia = np.asarray(self.solid.moment_inertia, dtype=np.float64)
        return (inertia + inertia.T) / 2 / self.solid.density

    @property
    def extent(self) -> float:
        """Longest edge of the smallest box of any orientation around the solid, m."""
        with _quiet():
            return float(max(trimesh.bounds.oriented_bounds(self.solid)[1]))

    def scaled(self, factor: float) -> "Body":
        """The same body, `factor` times as long, wide and high."""
        return Body(
            _scaled(self.solid, factor), tuple(_scaled(part, factor) for part in self.parts)
        )


def load_body(path: Path, scale: float = 1.0) -> Body:
    """Read a mesh file and make it a body.

    Args:
        path: a file with one of `SUPPORTED_SUFFIXES`; a scene becomes one mesh, its transforms
            applied.
        scale: metres per unit of the file.

    Raises:
        MeshError: the file is unreadable, has no faces or encloses no volume.
        MissingDependencyError: the mesh is concave, and CoACD is not installed.
    """
    mesh = read_mesh(path)
    mesh.vertices = mesh.vertices * scale
    try:
        return make_body(mesh)
    except MeshError as error:
        raise MeshError(f"{path}: {error}") from error


def read_mesh(path: Path) -> trimesh.Trimesh:
    """Read a mesh file as it is, a scene as one mesh with its transforms applied.

    Raises:
        MeshError: the file cannot be read, or has no faces.
    """
    try:
        with _quiet():
            # Merging vertices here would weld parts that only touch.
            mesh = trimesh.load_scene(path, process=False).to_mesh()
    except Exception as error:  # each format's reader fails in its own way
        raise MeshError(
            f"{path} cannot be read as a mesh ({error}); re-export it as one of "
            f"{', '.join(SUPPORTED_SUFFIXES)}."
        ) from error
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise MeshError(f"{path} has no faces; re-export it as a triangle mesh.")
    return mesh


def make_body(mesh: trimesh.Trimesh) -> Body:
    """Make a mesh a body: close it, unite its components, centre it, split it into convex parts.

    Components that overlap are united; inverted components are cavities where they lie inside
    the rest, and are turned round elsewhere. A convex component is its own part; if one of them
    is concave, CoACD (Wei et al. 2022) decomposes the union, and the answer is kept on disk, in
    `graspforce/convex_parts` below $XDG_CACHE_HOME or ~/.cache.

    Raises:
        MeshError: a vertex is not finite, or the mesh encloses no volume even after the repair
            of triangles and quads that are missing.
        MissingDependencyError: the mesh is concave, and CoACD is not installed.
    """
    if not np.isfinite(mesh.vertices).all():
        raise MeshError("a vertex is not a finite number; re-export the mesh.")
    # Far from the origin, the sums behind volume and inertia would lose digits.
    middle = mesh.bounds.mean(axis=0)
    components = _closed(np.asarray(mesh.vertices) - middle, np.asarray(mesh.faces)).decompose()
    # Volumes without sign: a shell within a shell must not cancel the outer one.
    largest = max((abs(component.volume()) for component in components), default=0.0)
    if largest <= 1e-12 * mesh.scale**3:
        raise MeshError("the mesh is flat and encloses no volume; give it a thickness.")
    components = [c for c in components if abs(c.volume()) > 1e-12 * largest]

    if sum(component.volume() for component in components) < 0:
        components = [_inside_out(component) for component in components]
    outer = [component for component in components if component.volume() > 0]
    inverted = [_inside_out(component) for component in components if component.volume() < 0]
    envelope, cavities = _union(outer), []
    if inverted:
        cavities = [c for c in inverted if (envelope ^ c).volume() > (1 - 1e-6) * c.volume()]
        outer += [c for c in inverted if c not in cavities]
        envelope = _union(outer)
    solid = _to_trimesh(envelope - _union(cavities) if cavities else envelope)

    if all(c.volume() >= (1 - _CONVEX_SHARE) * c.hull().volume() for c in outer):
        points = [_points(component) for component in outer]
    else:
        points = _decompose(_to_trimesh(envelope))
    centre = np.asarray(solid.center_mass)
    parts = tuple(_convex_part(corners - centre) for corners in points)
    return Body(_moved(solid, -centre), parts)


def _closed(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> manifold3d.Manifold:
    """The mesh as a closed, consistently wound manifold; repaired only if it is none."""
    shell = _to_manifold(vertices, faces)
    if shell.status() == manifold3d.Error.NoError:
        return shell
    with _quiet():
        mesh = trimesh.Trimesh(vertices, faces, process=False)
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
        mesh.update_faces(mesh.nondegenerate_faces() & mesh.unique_faces())
        trimesh.repair.fix_winding(mesh)
        trimesh.repair.fill_holes(mesh)
    shell = _to_manifold(np.asarray(mesh.vertices), np.asarray(mesh.faces))
    if shell.status() != manifold3d.Error.NoError:
        raise MeshError(
            "the mesh is not watertight, and filling its small holes did not close it; close it "
            "in a mesh editor (Blender's 3D Print toolbox, MeshLab's 'Close Holes')."
        )
    return shell


def _to_manifold(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> manifold3d.Manifold:
    mesh = manifold3d.Mesh64(
        np.ascontiguousarray(vertices, dtype=np.float64),
        np.ascontiguousarray(faces, dtype=np.uint64),
    )
    # Joins triangle soup (STL) and texture seams (OBJ) along open edges; closed parts stay apart.
    mesh.merge()
    return manifold3d.Manifold(mesh)


def _points(shape: manifold3d.Manifold) -> NDArray[np.float64]:
    return np.array(shape.to_mesh64().vert_properties)[:, :3]


def _to_trimesh(shape: manifold3d.Manifold) -> trimesh.Trimesh:
    faces = np.array(shape.to_mesh64().tri_verts, dtype=np.int64)
    return trimesh.Trimesh(_points(shape), faces, process=False)


def _inside_out(shape: manifold3d.Manifold) -> manifold3d.Manifold:
    return _to_manifold(
        _points(shape), np.array(shape.to_mesh64().tri_verts, dtype=np.int64)[:, ::-1]
    )


def _union(shapes: list[manifold3d.Manifold]) -> manifold3d.Manifold:
    return manifold3d.Manifold.batch_boolean(shapes, manifold3d.OpType.Add)


def _moved(mesh: trimesh.Trimesh, offset: NDArray[np.float64]) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices + offset, mesh.faces, process=False)


def _scaled(mesh: trimesh.Trimesh, factor: float) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices * factor, mesh.faces, process=False)


def _convex_part(points: NDArray[np.float64]) -> trimesh.Trimesh:
    """Convex hull of points (m, 3), at most `MAX_PART_VERTICES` of them."""
    hull = manifold3d.Manifold.hull_points(points)
    if hull.num_vert() > MAX_PART_VERTICES:
        # The extreme point in each of evenly spread directions (a Fibonacci lattice on the sphere).
        k = np.arange(MAX_PART_VERTICES) + 0.5
        z = 1 - 2 * k / MAX_PART_VERTICES
        azimuth = np.pi * (1 + np.sqrt(5)) * k
        ring = np.sqrt(1 - z**2)
        directions = np.stack([ring * np.cos(azimuth), ring * np.sin(azimuth), z])
        corners = _points(hull)
        hull = manifold3d.Manifold.hull_points(
            corners[np.unique((corners @ directions).argmax(axis=0))]
        )
    return _to_trimesh(hull)


def _decompose(mesh: trimesh.Trimesh) -> list[NDArray[np.float64]]:
    """Corner points (m_i, 3) of convex parts that together stand for a concave mesh."""
    try:
        import coacd
    except ImportError as error:
        raise MissingDependencyError(
            "A concave mesh needs CoACD to become convex parts: "
            "pip install 'graspforce[decomposition]'."
        ) from error
    content = hashlib.sha256(repr((version("coacd"), sorted(_COACD_SETTINGS.items()))).encode())
    content.update(np.asarray(mesh.vertices, dtype=np.float64).tobytes())
    content.update(np.asarray(mesh.faces, dtype=np.int64).tobytes())
    cached = cache_folder("convex_parts") / f"{content.hexdigest()}.npz"
    # A file that is missing or cut short is made anew.
    unreadable = (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile)
    with suppress(*unreadable), cached.open("rb") as file, np.load(file) as archive:
        return np.split(archive["points"], archive["ends"][:-1])

    coacd.set_log_level("error")
    parts = coacd.run_coacd(coacd.Mesh(mesh.vertices, mesh.faces), **_COACD_SETTINGS)
    points = [np.asarray(vertices, dtype=np.float64) for vertices, _ in parts]
    with suppress(OSError):  # a home that cannot be written costs time at the next use, no more
        ends = np.cumsum([len(corners) for corners in points])
        corners = np.concatenate(points)
        write_atomically(cached, lambda file: np.savez_compressed(file, points=corners, ends=ends))
    return points


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence numpy's complaints inside trimesh about triangles without area."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield
