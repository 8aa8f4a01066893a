"""A copy of a URDF that PyBullet can load, in the user's cache, where the file itself is not one.

Its frames have a little mass, its tensors are those of rigid bodies, its meshes are absolute paths
of files that PyBullet reads, and no line is longer than its reader takes.
"""

import hashlib
from functools import partial
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from gfo_env.cache import cache_folder
from gfo_env.exceptions import HandError
from solvers.files import write_bytes

from .elements import noted, text_of, vector
from .inertia import mend_inertia
from .shapes import MeshFile, as_obj, check_geometry, find_mesh, weigh

_LONGEST_LINE = 8191
"""Bytes that PyBullet takes of a line."""

_ROUNDING = 1e-6
"""By which the length of an axis may differ from 1."""


class UrdfCopy:
    """A URDF whose links are mended, as far as that can be done; nothing is written yet.

    Args:
        robot: the root of the parsed file; it is changed.
        path: of the file.

    Attributes:
        faults: what cannot be mended.
        made_up: what was made up for links, by name.
        unseen: visual meshes that are left out, and why.
    """

    def __init__(self, robot: ET.Element, path: Path) -> None:
        self.faults: list[str] = []
        self.made_up: dict[str, str] = {}
        self.unseen: list[str] = []
        self._robot, self._path = robot, path
        # elements, the files that they mean, and texts of OBJ files in place of other formats
        self._meshes: list[tuple[ET.Element, MeshFile, str | None]] = []
        before = ET.tostring(robot)
        for link in robot.findall("link"):
            self._mend(link, link.get("name", ""))
        for joint in robot.findall("joint"):
            with noted(self.faults):
                _normalise_axis(joint)
        self._mended = ET.tostring(robot) != before

    def _mend(self, link: ET.Element, name: str) -> None:
        shapes = link.findall("collision")
        known = len(self.faults)
        for shape in shapes:
            with noted(self.faults):
                check_geometry(shape, name)
                for mesh in shape.iterfind("geometry/mesh"):
                    self._refer(mesh, f"The collision mesh {{}} of link {name!r}", convex=True)
        if len(self.faults) == known:
            with noted(self.faults):
                note = mend_inertia(link, partial(weigh, shapes, name, self._path))
                if note is not None:
                    self.made_up[name] = note
        for visual in link.findall("visual"):
            for mesh in visual.iterfind("geometry/mesh"):
                with noted(self.unseen):
                    self._refer(mesh, f"The visual mesh {{}} of link {name!r}", convex=False)
                    continue
                link.remove(visual)

    def _refer(self, mesh: ET.Element, what: str, *, convex: bool) -> None:
        file = mesh.get("filename", "")
        what = what.format(repr(file))
        found = find_mesh(file, self._path)
        if found is None:
            raise HandError(f"{what} is not below the folder of {self._path} or the four above it.")
        text = None if found.known else as_obj(found.path, what, convex=convex)
        self._meshes.append((mesh, found, text))

    def write(self) -> Path:
        """The path of a file for PyBullet: the URDF itself if that will do, or its copy.

        Raises:
            HandError: the user's cache cannot be written.
        """
        fit = all(found.found and found.known for _, found, _ in self._meshes)
        if fit and not self._mended and _is_plain(self._path.read_bytes()):
            return self._path.resolve()
        folder = cache_folder("hands")
        try:
            for mesh, found, text in self._meshes:
                path = found.path
                if text is not None:
                    path = _keep(folder, found.path.stem, ".obj", text.encode())
                mesh.set("filename", str(path))
            ET.indent(self._robot)
            content = ET.tostring(self._robot, encoding="utf-8", xml_declaration=True)
            return _keep(folder, self._path.stem, ".urdf", content)
        except OSError as error:
            raise HandError(
                f"PyBullet needs a copy of {self._path} in which links and meshes are as it takes "
                f"them, and {folder} cannot be written ({error}): set XDG_CACHE_HOME to a folder "
                "that can."
            ) from error


def _normalise_axis(joint: ET.Element) -> None:
    """Give an axis the length 1: PyBullet would move a slide by its length, not by a metre."""
    element = joint.find("axis")
    if element is None or joint.get("type") == "fixed":
        return
    axis = vector(element, "xyz", f"<axis> of joint {joint.get('name')!r}")
    length = float(np.linalg.norm(axis))
    if not length > 0:
        raise HandError(f"The <axis> of joint {joint.get('name')!r} has no direction: give it one.")
    if abs(length - 1.0) > _ROUNDING:
        element.set("xyz", text_of(axis / length))


def _is_plain(content: bytes) -> bool:
    """Whether PyBullet reads a file of this content."""
    try:
        content.decode()
    except UnicodeDecodeError:
        return False
    return all(len(line) <= _LONGEST_LINE for line in content.split(b"\n"))


def _keep(folder: Path, stem: str, suffix: str, content: bytes) -> Path:
    """Write a file under a name that its content determines, unless it is there already."""
    path = folder / f"{stem}-{hashlib.sha256(content).hexdigest()[:16]}{suffix}"
    if not (path.is_file() and path.read_bytes() == content):
        write_bytes(path, content)
    return path.absolute()
