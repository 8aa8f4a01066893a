"""What a URDF says of a hand: joints in the simulator's order, their limits, mimic tags.

Only what the simulation needs is read. What it cannot work with is mended in a copy, or refused:
all of it in one error.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

from gfo_env.exceptions import HandError

from .elements import listed, name_of, noted, number, refuse
from .urdf_copy import UrdfCopy

_MOVING = ("revolute", "prismatic")


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
        path: of the file for the simulator, absolute: the file itself, or a copy that it can load.
        base_link: the tree's root.
        joints: the moving joints in the order of the simulator's degrees of freedom.
        carrier: for every link, the link that it moves with: the child of the last moving joint on
            the way from the root, or the root.
        touching: links of which some part has a shape, by the names of their carriers.
        notes: what the copy leaves out, or makes up for links that move.
    """

    name: str
    path: Path
    base_link: str
    joints: tuple[UrdfJoint, ...]
    carrier: dict[str, str]
    touching: frozenset[str]
    notes: tuple[str, ...]


def read_urdf(path: Path) -> UrdfHand:
    """Read and check a URDF file, and write a copy into the user's cache if PyBullet needs one.

    Raises:
        HandError: the file is missing or no URDF, or the simulation cannot work with what it says;
            everything that is wrong is named.
    """
    robot = _parse(path)
    faults: list[str] = []
    links: dict[str, ET.Element] = {}
    joints: list[UrdfJoint] = []
    for link in robot.findall("link"):
        with noted(faults):
            if links.setdefault(name_of(link), link) is not link:
                raise HandError(f"{path} has more than one link {link.get('name')!r}.")
    for element in robot.findall("joint"):
        with noted(faults):
            joints.append(_joint(element))
    copy = UrdfCopy(robot, path)
    refuse([*faults, *copy.faults], path)
    base = _root(links, joints, path)
    carrier = {base: base}
    ordered = list(_depth_first(base, joints))
    for joint in ordered:
        carrier[joint.child] = carrier[joint.parent] if joint.kind == "fixed" else joint.child
    if len(carrier) < len(links):
        lost = sorted(set(links) - set(carrier))
        raise HandError(f"{path}: the joints above the links {listed(lost)} form a loop.")
    moving = tuple(joint for joint in ordered if joint.kind != "fixed")
    if not moving:
        raise HandError(f"{path} has no joint that moves: is it a hand?")
    made_up = [note for link, note in copy.made_up.items() if carrier[link] != base]
    return UrdfHand(
        name=robot.get("name", path.stem),
        path=copy.write(),
        base_link=base,
        joints=moving,
        carrier=carrier,
        touching=frozenset(
            carrier[name] for name, link in links.items() if link.find("collision") is not None
        ),
        notes=(*made_up, *copy.unseen),
    )


def _parse(path: Path) -> ET.Element:
    try:
        robot = ET.parse(path).getroot()
    except OSError as error:
        raise HandError(f"The URDF {path} cannot be read: {error.strerror}.") from error
    except (ET.ParseError, LookupError, ValueError) as error:  # the latter of odd encodings
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
    faults = []
    for what, found in (("joint", names), ("child link", children)):
        twice = sorted({name for name in found if found.count(name) > 1})
        if twice:
            faults.append(f"{path} has more than one joint for the {what} {listed(twice)}.")
    faults += [
        f"Joint {joint.name!r} names the link {name!r}, which {path} does not have; its links are "
        f"{listed(links)}."
        for joint in joints
        for name in (joint.parent, joint.child)
        if name not in links
    ]
    refuse(faults, path)
    roots = [name for name in links if name not in children]
    if len(roots) != 1:
        raise HandError(
            f"{path} must have one link that is no joint's child, the palm; it has "
            f"{listed(roots) or 'none'}."
        )
    return roots[0]


def _depth_first(base: str, joints: list[UrdfJoint]) -> Iterator[UrdfJoint]:
    """PyBullet's order: each joint before those beyond it, siblings as they stand in the file."""
    beyond: dict[str, list[UrdfJoint]] = {}
    for joint in reversed(joints):
        beyond.setdefault(joint.parent, []).append(joint)
    waiting = beyond.get(base, [])
    while waiting:
        joint = waiting.pop()
        yield joint
        waiting += beyond.get(joint.child, [])


def _joint(element: ET.Element) -> UrdfJoint:
    name = name_of(element)
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
        key: number(limit, key, f"<limit> of joint {name!r}")
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
        multiplier = number(tag, "multiplier", what, default=1.0)
        mimic = Mimic(tag.get("joint", ""), multiplier, number(tag, "offset", what))
    return UrdfJoint(name, kind, parent, child, mimic=mimic, **numbers)


def _find(element: ET.Element, tag: str, joint: str) -> ET.Element:
    found = element.find(tag)
    if found is None:
        raise HandError(f"Joint {joint!r} has no <{tag}>: add it to the URDF.")
    return found
