"""A hand of three fingers, its URDF and its description spoilt in every way."""

import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from gfo_env.grasps.acquisition import attempt
from gfo_env.hand import HandDescription
from gfo_env.objects import GraspObject, ObjectSet
from gfo_env.simulation import Simulation
from tests.fuzz import hostile
from tests.fuzz.outcome import WrongAnswer, tell

CLOSING: dict[str, Any] = {
    "fingertip_links": ["outer0", "outer1", "outer2"],
    "closing_joints": ["inner0_joint", "inner1_joint", "inner2_joint"],
    "closing_speed": 1.5,
    "closing_torque": 0.8,
    "palm": 0.04,
}
"""What no URDF says, see docs/hands.md."""

_NUMBERS = ("nan", "inf", "-inf", "0", "-1", "1e300", "1e-300", "", "x", "1,5", "1 2", "0x10")
_NAMES = ("", "palm", "inner0", "no such thing", "a" * 9000, "ü", "&lt;", "../..", "outer1_joint")


def three_fingers() -> str:
    """The URDF of docs/hands.md: a palm and three fingers of two capsules each."""
    parts = [_link("palm", 0.5, 1e-3, 0.02, '<box size="0.1 0.1 0.04"/>')]
    for finger in range(3):
        yaw = 2 * np.pi * finger / 3
        foot = f"{0.05 * np.cos(yaw):.9f} {0.05 * np.sin(yaw):.9f} 0.05"
        mimic = f'<mimic joint="inner{finger}_joint" multiplier="0.5" offset="0.4"/>'
        inner, outer = f"inner{finger}", f"outer{finger}"
        parts += [
            _link(inner, 0.06, 1e-3, 0.035, '<capsule radius="0.01" length="0.07"/>'),
            _link(outer, 0.04, 3e-4, 0.0275, '<capsule radius="0.009" length="0.055"/>'),
            _joint(f"{inner}_joint", "palm", inner, foot, yaw, -0.8),
            _joint(f"{outer}_joint", inner, outer, "0 0 0.07", 0.0, 0.0, mimic),
        ]
    return f'<robot name="three_fingers">{"".join(parts)}</robot>'


def _link(name: str, mass: float, moment: float, middle: float, shape: str) -> str:
    return f"""<link name="{name}">
      <inertial><origin xyz="0 0 {0.8 * middle}"/><mass value="{mass}"/>
        <inertia ixx="{moment}" iyy="{moment}" izz="{moment}" ixy="0" ixz="0" iyz="0"/></inertial>
      <collision><origin xyz="0 0 {middle}"/><geometry>{shape}</geometry></collision>
    </link>"""


def _joint(
    name: str, parent: str, child: str, xyz: str, yaw: float, lower: float, mimic: str = ""
) -> str:
    return f"""<joint name="{name}" type="revolute">
      <parent link="{parent}"/><child link="{child}"/>
      <origin xyz="{xyz}" rpy="0 0 {yaw}"/><axis xyz="0 -1 0"/>
      <limit lower="{lower}" upper="1.4" effort="2" velocity="3"/>{mimic}
    </joint>"""


def _one(rng: np.random.Generator, pattern: str, text: str, new: Callable[[str], str]) -> str:
    """The text with one of the places that match changed."""
    places = list(re.finditer(pattern, text, re.DOTALL))
    if not places:
        return text
    place = places[rng.integers(len(places))]
    return text[: place.start()] + new(place.group()) + text[place.end() :]


def _number(rng: np.random.Generator, text: str) -> str:
    other = str(rng.choice(_NUMBERS))
    return _one(rng, r"-?\d+\.?\d*(e-?\d+)?(?=[ \"])", text, lambda _: other)


def _name(rng: np.random.Generator, text: str) -> str:
    other = str(rng.choice(_NAMES))
    return _one(rng, r'(?<=(?:link|name)=")[^"]+', text, lambda _: other)


def _less(rng: np.random.Generator, text: str) -> str:
    return _one(
        rng, r"<\w+ [^<>]*/>|<(inertial|collision|joint|link)\b.*?</\1>", text, lambda _: ""
    )


def _twice(rng: np.random.Generator, text: str) -> str:
    pattern = r"<\w+ [^<>]*/>|<(inertial|collision|joint|link)\b.*?</\1>"
    return _one(rng, pattern, text, lambda whole: whole + whole)


def _kind(rng: np.random.Generator, text: str) -> str:
    kinds = ("fixed", "prismatic", "continuous", "floating", "planar", "spherical", "", "x")
    other = f'type="{rng.choice(kinds)}"'
    return _one(rng, r'type="\w*"', text, lambda _: other)


def _shape(rng: np.random.Generator, text: str) -> str:
    shapes = (
        *('<mesh filename="missing.stl"/>', '<mesh filename="package://x/y.dae"/>', "<x/>", ""),
        *('<sphere radius="0"/>', '<cylinder radius="0.01" length="0.03"/>', "<mesh/>"),
    )
    other = f"<geometry>{rng.choice(shapes)}</geometry>"
    return _one(rng, r"<geometry>.*?</geometry>", text, lambda _: other)


def _no_xml(rng: np.random.Generator, text: str) -> str:
    forms = (
        "",
        "x",
        "<robot/>",
        "<a><b/></a>",
        text[: rng.integers(len(text) + 1)],
        text + "</robot>",
    )
    bomb = '<!DOCTYPE r [<!ENTITY a "aaaaaaaaaa">'
    for one, other in zip("bcdefghi", "abcdefgh", strict=True):
        bomb += f'<!ENTITY {one} "{f"&{other};" * 10}">'
    forms += (bomb + '] ><robot name="&i;"/>', "<a>" * 100_000)
    return forms[rng.integers(len(forms))]


_CHANGES = (_number, _number, _name, _less, _less, _twice, _kind, _shape, _no_xml)


def prepare() -> None:
    """Load the engine."""
    path = Path("whole.urdf")
    path.write_text(three_fingers())
    _grasp(HandDescription.from_urdf(path, **CLOSING), np.random.default_rng(0))


def try_hand(rng: np.random.Generator) -> str:
    """A URDF changed in one to three places, or an argument; what is accepted must load."""
    text, arguments, what = three_fingers(), dict(CLOSING), []
    if rng.random() < 0.7:
        for _ in range(rng.integers(1, 4)):
            change = _CHANGES[rng.integers(len(_CHANGES))]
            text = change(rng, text)
            what.append(change.__name__.strip("_"))
    else:
        names = [*CLOSING, "gears", "spread_joints", "spread_range", "open_angles", "max_torque"]
        argument = str(rng.choice([*names, "contact_links", "max_speed", "name"]))
        word, arguments[argument], _ = hostile.of_scalar(rng)
        what.append(f"{argument}: {word}")
    tell(", ".join(what))
    # the engine remembers files by their names
    path = Path(f"hand_{rng.integers(2**60)}.urdf")
    path.write_text(text)
    try:
        _grasp(HandDescription.from_urdf(path, **arguments), rng)
    finally:
        path.unlink()
    return ", ".join(what)


def _grasp(hand: HandDescription, rng: np.random.Generator) -> None:
    """One attempt to grasp a ball: it may fail."""
    simulation = Simulation(hand)
    try:
        result = attempt(_ball(), simulation, rng)
        angles = simulation.joint_state()[0]
    finally:
        simulation.close()
    if not np.isfinite(angles).all() and result.grasp is not None:
        raise WrongAnswer(f"a grasp with the angles {angles}")


@cache
def _ball() -> GraspObject:
    folder = Path("balls")
    folder.mkdir()
    trimesh.creation.icosphere(2, 0.035).export(folder / "ball.stl")
    return ObjectSet(folder)["ball.stl"]
