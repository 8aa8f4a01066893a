"""Collision shapes of a URDF's links: where their meshes are, and what they weigh.

PyBullet looks for a mesh below the URDF's folder and the four above it, whatever package the name
begins with; it reads binary STL, OBJ and DAE, loads nothing at all of a file whose mesh has another
ending, a visual one included, and leaves out the shape of a text STL without a word.
"""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gfo_env.exceptions import HandError

from .elements import listed, number, origin, sizes, vector

if TYPE_CHECKING:
    import trimesh

_SEARCHED_PARENTS = 5
"""Folders above the URDF in which PyBullet looks for meshes, its own included."""

_STL_HEADER, _STL_FACET = 84, 50
"""Bytes of a binary STL before its facets, and of a facet."""


@dataclass(frozen=True)
class MeshFile:
    """A mesh that a URDF names.

    Attributes:
        path: of the file, absolute.
        found: whether PyBullet finds it under the name in the URDF.
        known: whether PyBullet reads its format.
    """

    path: Path
    found: bool
    known: bool


def find_mesh(name: str, urdf: Path) -> MeshFile | None:
    """The file that a URDF means: absolute, below a folder above it, or in a package there."""
    below = name.split("://")[-1]
    if not below:
        return None
    folders = urdf.resolve().parents[:_SEARCHED_PARENTS]
    places = [folder / below for folder in folders]
    if name.startswith("package://"):
        # the folder of a package need not bear its name
        places += [folder / below.partition("/")[2] for folder in folders]
    for place, path in enumerate(places):
        if path.is_file():
            return MeshFile(path.absolute(), place < len(folders), _is_known(path))
    return None


def _is_known(path: Path) -> bool:
    suffix = path.suffix.lower()
    if suffix == ".obj":
        with path.open("rb") as stream:
            return any(line.lstrip().startswith(b"f ") for line in stream)
    if suffix != ".stl":
        return suffix == ".dae"
    with path.open("rb") as stream:
        header = stream.read(_STL_HEADER)
    facets = int.from_bytes(header[-4:], "little")
    return path.stat().st_size == _STL_HEADER + _STL_FACET * facets


def as_obj(path: Path, what: str, *, convex: bool) -> str:
    """A mesh of any format that trimesh reads as text of an OBJ file.

    Args:
        path: of the mesh; each of its bodies becomes an object of the OBJ file.
        what: it is stands in the error.
        convex: whether the bodies' convex hulls are wanted, which is what PyBullet makes of them.

    Raises:
        HandError: it cannot be read, or has no faces.
    """
    import trimesh

    try:
        with _quiet():
            bodies = [
                body.convex_hull if convex else _bare(body)
                for body in trimesh.load_scene(path, process=False).dump()
                if isinstance(body, trimesh.Trimesh) and len(body.faces)
            ]
            text = trimesh.Scene(bodies).export(file_type="obj") if bodies else ""
    except Exception as error:  # each format's reader fails in its own way
        raise HandError(
            f"{what} cannot be read ({error}): give it as OBJ or binary STL."
        ) from error
    if not bodies:
        raise HandError(f"{what} has no faces: give it as OBJ or binary STL.")
    return str(text)


def _bare(mesh: "trimesh.Trimesh") -> "trimesh.Trimesh":
    """Without colours and textures."""
    import trimesh

    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


_SIZES = {
    "box": (("size", 3),),
    "sphere": (("radius", 1),),
    "cylinder": (("radius", 1), ("length", 1)),
    "capsule": (("radius", 1), ("length", 1)),
    "mesh": (),
}
"""Attributes of a geometry and how many numbers they have."""


def check_geometry(element: ET.Element, link: str) -> None:
    """A shape is one of those that PyBullet knows, of a size.

    Raises:
        HandError: it is not.
    """
    shape, what = element.find("geometry/*"), f"<geometry> of link {link!r}"
    if shape is None or shape.tag not in _SIZES:
        found = "empty" if shape is None else f"a <{shape.tag}>"
        raise HandError(f"The {what} is {found}: it must be one of {', '.join(_SIZES)}.")
    for key, count in _SIZES[shape.tag]:
        sizes(shape, key, count, what)
    if shape.get("scale"):
        vector(shape, "scale", what)
    origin(element, f"link {link!r}")


@dataclass(frozen=True, eq=False)
class Uniform:
    """Mass properties of uniform bodies of density 1 kg/m3, each one's convex hull.

    Attributes:
        volume: m3; what overlaps counts twice.
        centre: (3,) m, link frame.
        tensor: (3, 3) m5 about the centre, link axes.
    """

    volume: float
    centre: NDArray[np.float64]
    tensor: NDArray[np.float64]


def weigh(shapes: list[ET.Element], link: str, urdf: Path) -> Uniform | None:
    """What the shapes of a link would weigh, or None if they have no volume.

    Raises:
        HandError: a mesh cannot be read.
    """
    with _quiet():
        solids = [_solid(shape, link, urdf) for shape in shapes]
        volume = float(sum(solid.volume for solid in solids))
        if not volume > 0:
            return None
        centre = np.sum([solid.volume * solid.center_mass for solid in solids], axis=0) / volume
        tensor = np.zeros((3, 3))
        for solid in solids:
            arm = solid.center_mass - centre
            tensor += solid.moment_inertia
            tensor += solid.volume * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return Uniform(volume, centre, (tensor + tensor.T) / 2)


def _solid(element: ET.Element, link: str, urdf: Path) -> "trimesh.Trimesh":
    """A shape's convex hull in the frame of its link."""
    import trimesh

    shape, what = element.find("geometry/*"), f"<geometry> of link {link!r}"
    assert shape is not None
    if shape.tag == "mesh":
        solid = _hull(shape, what, urdf)
    elif shape.tag == "box":
        solid = trimesh.creation.box(sizes(shape, "size", 3, what))
    elif shape.tag == "sphere":
        solid = trimesh.creation.icosphere(radius=number(shape, "radius", what))
    else:
        make = getattr(trimesh.creation, shape.tag)
        solid = make(radius=number(shape, "radius", what), height=number(shape, "length", what))
    place = origin(element, f"link {link!r}")
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("xyz", place[3:]).as_matrix()
    pose[:3, 3] = place[:3]
    solid.apply_transform(pose)
    return solid


def _hull(shape: ET.Element, what: str, urdf: Path) -> "trimesh.Trimesh":
    """A mesh's convex hull in the frame of its shape."""
    import trimesh

    found = find_mesh(shape.get("filename", ""), urdf)
    assert found is not None
    try:
        hull = trimesh.load_scene(found.path, process=False).to_mesh().convex_hull
    except Exception as error:  # each format's reader fails in its own way
        raise HandError(
            f"{found.path} in the {what}, which has no <inertial> that PyBullet could use, "
            f"cannot be weighed ({error}): add <mass> and <inertia>."
        ) from error
    if shape.get("scale"):
        hull.apply_transform(np.diag([*vector(shape, "scale", what), 1.0]))
    return hull


def check_shapes(bullet: ModuleType, client: int, hand: int, urdf: Path) -> None:
    """Whether each link of a loaded hand has collision shapes if its URDF says so.

    PyBullet leaves out the shape of a mesh in which it finds nothing, and loads the rest.

    Raises:
        HandError: some have none.
    """
    count = bullet.getNumJoints(hand, physicsClientId=client)
    names = {
        bullet.getJointInfo(hand, i, physicsClientId=client)[12].decode(): i for i in range(count)
    }
    lost = [
        name
        for link in ET.parse(urdf).iterfind("link")
        if link.find("collision") is not None
        and (name := link.get("name", "")) in names
        and not bullet.getCollisionShapeData(hand, names[name], physicsClientId=client)
    ]
    if lost:
        raise HandError(
            f"PyBullet reads no shape from the collision meshes of links {listed(lost)} in "
            f"{urdf}: give them as OBJ or binary STL, and the file another name."
        )


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence numpy's complaints inside trimesh about triangles without area."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield
