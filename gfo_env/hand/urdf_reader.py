"""What a URDF says of a hand: joints in the simulator's order, their limits, mimic tags.

Only what the simulation needs is read, and what it cannot work with is refused: PyBullet gives a
link without inertia 1 kg, sets tensors of no rigid body to zero, ignores mimic tags, and reports
wrong contact forces for a link whose only collision shape has the frame of its inertia.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from gfo_env.exceptions import HandError

_MOVING = ("revolute", "prismatic")
_TENSOR = ("ixx", "ixy", "ixz", "ixy", "iyy", "iyz", "ixz", "iyz", "izz")
_SEARCHED_PARENTS = 5
"""Folders above the URDF in which PyBullet looks for meshes, its own included."""


@dataclass(frozen=True)
class Mimic:
    """A joint follows another: angle = `multiplier` * angle of `joint` + `offset`."""

    joint: str
    multiplier: float
    offset: float


@dataclass(frozen=True)
class UrdfJoint:
    """A joint that moves or a fixed one; what its `<limit>` does not say is 0.

    Attributes:
        name: of the joint.
        kind: "revolute", "prismatic" or "fixed".
        parent: the link that it stands on.
        child: the link that it moves.
        lower: limit [rad, m].
        upper: limit [rad, m].
        effort: largest torque [N·m] or force [N].
        velocity: largest speed [rad/s, m/s].
        mimic: the joint that this one follows.
    """

    name: str
    kind: str
    parent: str
    child: str
    lower: float
    upper: float
    effort: float
    velocity: float
    mimic: Mimic | None


@dataclass(frozen=True)
class UrdfHand:
    """A URDF file's tree.

    Attributes:
        name: of the robot.
        base_link: the tree's root.
        joints: the moving joints in the order of the simulator's degrees of freedom.
        carrier: for every link, the link that it moves with: the child of the last moving joint on
            the way from the root, or the root.
    """

    name: str
    base_link: str
    joints: tuple[UrdfJoint, ...]
    carrier: dict[str, str]


def read_urdf(path: Path) -> UrdfHand:
    """Read and check a URDF file.

    Raises:
        HandError: the file is missing or no URDF, or the simulation cannot work with what it says.
    """
    robot = _parse(path)
    links = {_name(link): link for link in robot.findall("link")}
    joints = [_joint(element) for element in robot.findall("joint")]
    base = _root(links, joints, path)
    carrier = {base: base}
    ordered = list(_depth_first(base, joints))
    for joint in ordered:
        carrier[joint.child] = carrier[joint.parent] if joint.kind == "fixed" else joint.child
    if len(carrier) < len(links):
        lost = sorted(set(links) - set(carrier))
        raise HandError(f"{path}: the joints above the links {_list(lost)} form a loop.")
    moving = tuple(joint for joint in ordered if joint.kind != "fixed")
    if not moving:
        raise HandError(f"{path} has no joint that moves: is it a hand?")
    for name, link in links.items():
        if carrier[name] != base:
            _check_inertia(name, link, moves=carrier[name] == name)
        _check_frames(name, link)
        _check_meshes(name, link, path)
    return UrdfHand(robot.get("name", path.stem), base, moving, carrier)


def _parse(path: Path) -> ET.Element:
    try:
        robot = ET.parse(path).getroot()
    except OSError as error:
        raise HandError(f"The URDF {path} cannot be read: {error.strerror}.") from error
    except ET.ParseError as error:
        raise HandError(f"{path} is no XML file: {error}.") from error
    if robot.tag != "robot":
        raise HandError(f"{path} is no URDF: its root is <{robot.tag}>, not <robot>.")
    if any("xacro" in element.tag for element in robot.iter()):
        raise HandError(f"{path} has xacro macros: expand them with `xacro {path.name}` first.")
    return robot


def _root(links: dict[str, ET.Element], joints: list[UrdfJoint], path: Path) -> str:
    """The one link that no joint moves."""
    names = [joint.name for joint in joints]
    children = [joint.child for joint in joints]
    for what, found in (("joint", names), ("child link", children)):
        twice = sorted({name for name in found if found.count(name) > 1})
        if twice:
            raise HandError(f"{path} has more than one joint for the {what} {_list(twice)}.")
    for joint in joints:
        for name in (joint.parent, joint.child):
            if name not in links:
                raise HandError(
                    f"Joint {joint.name!r} names the link {name!r}, which {path} does not have; "
                    f"its links are {_list(links)}."
                )
    roots = [name for name in links if name not in children]
    if len(roots) != 1:
        raise HandError(
            f"{path} must have one link that is no joint's child, the palm; it has "
            f"{_list(roots) or 'none'}."
        )
    return roots[0]


def _depth_first(link: str, joints: list[UrdfJoint]) -> Iterator[UrdfJoint]:
    """PyBullet's order: each joint before those beyond it, siblings as they stand in the file."""
    for joint in joints:
        if joint.parent == link:
            yield joint
            yield from _depth_first(joint.child, joints)


def _joint(element: ET.Element) -> UrdfJoint:
    name = _name(element)
    kind = element.get("type", "")
    if kind not in (*_MOVING, "fixed"):
        cure = " with limits" if kind == "continuous" else ""
        raise HandError(
            f"Joint {name!r} is of type {kind!r}: a hand's joints must be revolute{cure}, "
            "prismatic or fixed."
        )
    parent, child = (_find(element, tag, name).get("link", "") for tag in ("parent", "child"))
    limit = ET.Element("limit") if kind == "fixed" else _find(element, "limit", name)
    numbers = {
        key: _number(limit, key, f"<limit> of joint {name!r}")
        for key in ("lower", "upper", "effort", "velocity")
    }
    if kind != "fixed" and not numbers["lower"] < numbers["upper"]:
        raise HandError(
            f"Joint {name!r} cannot move: its <limit> goes from lower={numbers['lower']:g} to "
            f"upper={numbers['upper']:g}. Make it fixed, or give both limits."
        )
    tag = element.find("mimic")
    mimic = None
    if tag is not None and kind != "fixed":
        what = f"<mimic> of joint {name!r}"
        multiplier = _number(tag, "multiplier", what, default=1.0)
        mimic = Mimic(tag.get("joint", ""), multiplier, _number(tag, "offset", what))
    return UrdfJoint(name, kind, parent, child, mimic=mimic, **numbers)


def _check_inertia(name: str, link: ET.Element, *, moves: bool) -> None:
    """A link that moves has a mass, and one that a joint moves by itself is a rigid body."""
    mass, inertia = link.find("inertial/mass"), link.find("inertial/inertia")
    if mass is None or inertia is None:
        raise HandError(
            f"Link {name!r} has no <inertial> with <mass> and <inertia>, and PyBullet would give "
            "it 1 kg: add them; a frame that weighs nothing may have 0.001 kg."
        )
    if _number(mass, "value", f"<mass> of link {name!r}") <= 0:
        raise HandError(f"Link {name!r} moves and must have a mass above 0 kg.")
    tensor = [_number(inertia, key, f"<inertia> of link {name!r}") for key in _TENSOR]
    moments = np.linalg.eigvalsh(np.reshape(tensor, (3, 3)))
    if moves and not (moments[0] > 0 and moments[2] <= (moments[0] + moments[1]) * (1 + 1e-6)):
        raise HandError(
            f"The <inertia> of link {name!r} is that of no rigid body, and PyBullet would set it "
            f"to zero: its principal moments {', '.join(f'{m:.3g}' for m in moments)} kg·m² must "
            "be positive, none of them more than the sum of the others."
        )


def _check_frames(name: str, link: ET.Element) -> None:
    """A link's shape is not its inertia's frame: the engine then leaves a layer out, and errs."""
    shapes = link.findall("collision")
    if len(shapes) == 1 and np.allclose(
        _origin(shapes[0], name), _origin(link.find("inertial"), name), rtol=0, atol=1e-9
    ):
        raise HandError(
            f"The only <collision> of link {name!r} has the <origin> of its <inertial>, and "
            "PyBullet would report wrong contact forces: move the inertia by 1e-6 m."
        )


def _origin(element: ET.Element | None, link: str) -> list[float]:
    """Position [m] and angles [rad] of an inertia's or a shape's frame in the link's."""
    origin = None if element is None else element.find("origin")
    words = " ".join(
        "0 0 0" if origin is None else origin.get(key, "0 0 0") for key in ("xyz", "rpy")
    ).split()
    try:
        return np.array(words, dtype=np.float64).reshape(6).tolist()
    except ValueError:
        raise HandError(
            f"An <origin> of link {link!r} is {' '.join(words)!r}: it must be three numbers for "
            "each of xyz and rpy."
        ) from None


def _check_meshes(name: str, link: ET.Element, path: Path) -> None:
    for mesh in link.iterfind("collision/geometry/mesh"):
        file = mesh.get("filename", "")
        below = file.split("://")[-1]
        parents = path.resolve().parents[:_SEARCHED_PARENTS]
        if not below or not any((folder / below).is_file() for folder in parents):
            raise HandError(
                f"The collision mesh {file!r} of link {name!r} is not below the folder of {path} "
                "or the four above it, where PyBullet looks for it."
            )


def _find(element: ET.Element, tag: str, joint: str) -> ET.Element:
    found = element.find(tag)
    if found is None:
        raise HandError(f"Joint {joint!r} has no <{tag}>: add it to the URDF.")
    return found


def _name(element: ET.Element) -> str:
    name = element.get("name")
    if not name:
        raise HandError(f"A <{element.tag}> of the URDF has no name: name it.")
    return name


def _number(element: ET.Element, key: str, what: str, default: float = 0.0) -> float:
    text = element.get(key)
    try:
        value = default if text is None else float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise HandError(f"The {what} has {key}={text!r}: it must be a number.")
    return value


def _list(names: Iterable[str]) -> str:
    return ", ".join(map(repr, names))
