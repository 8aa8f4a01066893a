"""From a mesh file to the geometry of a rigid body: one solid and the convex parts that collide.

Frames and units: a `Body` has its origin at the centre of mass of the solid (uniform density) and
the axes of the file; lengths are metres if the file is in metres.

The work is done by Manifold (https://github.com/elalish/manifold) in double precision: it merges
overlapping components exactly once, so that volume and inertia are those of the union.
"""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import manifold3d
import numpy as np
import trimesh
from numpy.typing import NDArray

from gfo_env.exceptions import MeshError, MeshWarning

from .decomposition import decompose
from .formats import READERS, read_polygons
from .overlap import overlap

SUPPORTED_SUFFIXES = (".glb", ".obj", ".off", ".ply", ".stl")

MAX_PART_VERTICES = 256
"""Most vertices of a convex part. Bullet's support function visits every vertex, so cost grows
with it; at 256 a ball's parts stay within 2 % of its radius."""

_MANY_CORNERS = 1000
"""Corners of a hull from which on the smallest box around it is found with a few of them."""

_CONVEX_SHARE = 1e-5
"""A component counts as convex if its hull is larger by no more than this share of the volume."""

_NEARLY_CONVEX_SHARE = 0.01
"""Where not all components are convex, what falls short of its hull by no more than this share of
the hull's volume still collides as one convex part."""

_OVERLAP_SHARE = 1e-3
"""Most of its space that a solid may enclose twice or inside out, as scanned surfaces do in their
creases; its volume is off by as much."""


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
        corners = _points(manifold3d.Manifold.hull_points(self.solid.vertices))
        if len(corners) <= _MANY_CORNERS:
            with _quiet():
                return float(max(trimesh.bounds.oriented_bounds(self.solid)[1]))
        # the box around a few of them is turned as the smallest one, or nearly so
        turn = trimesh.bounds.oriented_bounds(corners[_outermost(corners, MAX_PART_VERTICES)])[0]
        return float(np.ptp(corners @ turn[:3, :3].T, axis=0).max())

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
        return make_body(mesh, str(path))
    except MeshError as error:
        raise MeshError(f"{path}: {error}") from error


def needs_decomposition(path: Path) -> bool:
    """Whether the body of a mesh file is concave; its convex parts are not made.

    Raises:
        MeshError: as `load_body` does.
    """
    mesh = read_mesh(path)
    try:
        return _convex_pieces(_shape(mesh)) is None
    except MeshError as error:
        raise MeshError(f"{path}: {error}") from error


def read_mesh(path: Path) -> trimesh.Trimesh:
    """Read the geometry of a mesh file as it is, a scene as one mesh with its transforms applied.

    Faces of more than three corners become triangles. Materials and textures are not read.

    Raises:
        MeshError: the file cannot be read, or has no faces.
    """
    try:
        if path.suffix.lower() in READERS:
            mesh = trimesh.Trimesh(*read_polygons(path), process=False)
        else:
            with _quiet():
                # Merging vertices here would weld parts that only touch.
                scene = trimesh.load_scene(path, process=False, skip_materials=True)
                mesh = scene.to_mesh()
    except Exception as error:  # each format's reader fails in its own way
        raise MeshError(
            f"{path} cannot be read as a mesh ({error}); re-export it as one of "
            f"{', '.join(SUPPORTED_SUFFIXES)}."
        ) from error
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise MeshError(f"{path} has no faces; re-export it as a triangle mesh.")
    return mesh


def make_body(mesh: trimesh.Trimesh, name: str = "the mesh") -> Body:
    """Make a mesh a body: close it, unite its components, centre it, split it into convex parts.

    Components that overlap are united; inverted components are cavities where they lie inside
    the rest, and are turned round elsewhere. A convex component is its own part. Otherwise a solid
    that falls short of its hull by 1 % of the volume is one part, and so is each component of that
    kind; if one of them is more concave, the union is decomposed, see `decomposition`, and the
    answer is kept on disk, in `graspforce/convex_parts` below $XDG_CACHE_HOME or ~/.cache.

    Args:
        mesh: to be made a body.
        name: of it, for warnings.

    Raises:
        MeshError: a vertex is not finite, or the mesh encloses no volume even after the repair
            of triangles and quads that are missing or doubled, or passes through itself.
        MissingDependencyError: the mesh is concave, and CoACD is not installed.
    """
    shape = _shape(mesh)
    points = _convex_pieces(shape)
    if points is None:
        made = decompose(shape.envelope)
        points = made.points
        if made.made_by:
            warnings.warn(
                f"CoACD does not cope with {name}, so in collisions {made.made_by} stands for it, "
                "which is coarser; mass and contact points are those of the true surface.",
                MeshWarning,
                stacklevel=2,
            )
    solid = _to_trimesh(shape.solid)
    centre = np.asarray(solid.center_mass)
    parts = tuple(_convex_part(corners - centre) for corners in points)
    return Body(_moved(solid, -centre), parts)


@dataclass(frozen=True, eq=False)
class _Shape:
    """What a mesh encloses, about the middle of its bounding box.

    Args:
        solid: of which body there is.
        envelope: the same without cavities.
        outer: components whose union the envelope is.
    """

    solid: manifold3d.Manifold
    envelope: manifold3d.Manifold
    outer: list[manifold3d.Manifold]


def _shape(mesh: trimesh.Trimesh) -> _Shape:
    if not np.isfinite(mesh.vertices).all():
        raise MeshError("a vertex is not a finite number; re-export the mesh.")
    if len(mesh.faces) and not 0 <= mesh.faces.min() <= mesh.faces.max() < len(mesh.vertices):
        raise MeshError("a face has a corner that is none of the vertices; re-export the mesh.")
    # Far from the origin, the sums behind volume and inertia would lose digits.
    middle = mesh.bounds.mean(axis=0)
    components = _components(np.asarray(mesh.vertices) - middle, np.asarray(mesh.faces))
    if sum(component.volume() for component in components) < 0:
        components = [_inside_out(component) for component in components]
    outer = [component for component in components if component.volume() > 0]
    inverted = [_inside_out(component) for component in components if component.volume() < 0]
    envelope, cavities = _union(outer), []
    if inverted:
        cavities = [c for c in inverted if (envelope ^ c).volume() > (1 - 1e-6) * c.volume()]
        outer += [c for c in inverted if c not in cavities]
        envelope = _union(outer)
    solid = envelope - _union(cavities) if cavities else envelope
    twice = overlap(_points(solid), _faces(solid))
    if twice > _OVERLAP_SHARE:
        raise MeshError(
            f"the surface passes through itself: {twice:.1%} of what it encloses is enclosed more "
            "than once, or inside out; unite it in a mesh editor (Blender's 'Remesh', MeshLab's "
            "'Uniform Mesh Resampling')."
        )
    return _Shape(solid, envelope, outer)


def _convex_pieces(shape: _Shape) -> list[NDArray[np.float64]] | None:
    """Corners (m_i, 3) of the convex parts of a shape that has some without being decomposed."""
    if all(_short_of_hull(component) <= _CONVEX_SHARE for component in shape.outer):
        return [_points(component) for component in shape.outer]
    if _short_of_hull(shape.envelope) <= _NEARLY_CONVEX_SHARE:
        return [_points(shape.envelope)]
    if all(_short_of_hull(component) <= _NEARLY_CONVEX_SHARE for component in shape.outer):
        return [_points(component) for component in shape.outer]
    return None


def _short_of_hull(shape: manifold3d.Manifold) -> float:
    """Share of its hull's volume that a shape lacks."""
    hull = shape.hull().volume()
    return float(1.0 - shape.volume() / hull)


def _components(
    vertices: NDArray[np.float64], faces: NDArray[np.int64]
) -> list[manifold3d.Manifold]:
    """The closed components of a mesh that enclose something; repaired only if it has none."""
    size = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    shell = _to_manifold(vertices, faces)
    if shell.status() == manifold3d.Error.NoError:
        # what encloses nothing may be of two sides of each triangle, of which one is enough
        components = _voluminous(shell.decompose(), size)
        if components:
            return components
    shell = _repaired(vertices, faces)
    if shell.status() != manifold3d.Error.NoError:
        raise MeshError(
            "the mesh is not watertight, and filling its small holes did not close it; close it "
            "in a mesh editor (Blender's 3D Print toolbox, MeshLab's 'Close Holes')."
        )
    components = _voluminous(shell.decompose(), size)
    if not components:
        raise MeshError("the mesh is flat and encloses no volume; give it a thickness.")
    return components


def _voluminous(components: list[manifold3d.Manifold], size: float) -> list[manifold3d.Manifold]:
    # Volumes without sign: a shell within a shell must not cancel the outer one.
    largest = max((abs(component.volume()) for component in components), default=0.0)
    if largest <= 1e-12 * size**3:
        return []
    return [c for c in components if abs(c.volume()) > 1e-12 * largest]


def _repaired(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> manifold3d.Manifold:
    """The mesh with vertices of one place merged, doubled triangles once, small holes closed."""
    with _quiet():
        mesh = trimesh.Trimesh(vertices, faces, process=False)
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
        mesh.update_faces(mesh.nondegenerate_faces() & mesh.unique_faces())
        trimesh.repair.fix_winding(mesh)
        trimesh.repair.fill_holes(mesh)
    return _to_manifold(np.asarray(mesh.vertices), np.asarray(mesh.faces))


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


def _faces(shape: manifold3d.Manifold) -> NDArray[np.int64]:
    return np.array(shape.to_mesh64().tri_verts, dtype=np.int64)


def _to_trimesh(shape: manifold3d.Manifold) -> trimesh.Trimesh:
    return trimesh.Trimesh(_points(shape), _faces(shape), process=False)


def _inside_out(shape: manifold3d.Manifold) -> manifold3d.Manifold:
    return _to_manifold(_points(shape), _faces(shape)[:, ::-1])


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
        corners = _points(hull)
        hull = manifold3d.Manifold.hull_points(corners[_outermost(corners, MAX_PART_VERTICES)])
    return _to_trimesh(hull)


def _outermost(points: NDArray[np.float64], count: int) -> NDArray[np.intp]:
    """The extreme point in each of evenly spread directions (a Fibonacci lattice on the sphere)."""
    k = np.arange(count) + 0.5
    z = 1 - 2 * k / count
    azimuth = np.pi * (1 + np.sqrt(5)) * k
    ring = np.sqrt(1 - z**2)
    directions = np.stack([ring * np.cos(azimuth), ring * np.sin(azimuth), z])
    return np.unique((points @ directions).argmax(axis=0))


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence numpy's complaints inside trimesh about triangles without area."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield
