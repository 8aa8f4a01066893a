"""Hands of one's own: the tutorial runs, a URDF is read as the simulator reads it or refused."""

import contextlib
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pybullet as p
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gfo_env.contacts import contact_frames
from gfo_env.exceptions import HandError
from gfo_env.grasps.acquisition import Grasp, attempt
from gfo_env.hand import BARRETT_BH8_280, Gear, HandDescription, PalmRegion
from gfo_env.simulation import Simulation
from tests.support.seeds import seeded
from tests.support.world import held_out_objects

TEXT = (Path(__file__).parents[3] / "docs" / "hands.md").read_text()
BLOCKS = re.findall(r"```python\n(.*?)```", TEXT, flags=re.S)
FINGERS = range(3)
INNER = [f"inner{finger}_joint" for finger in FINGERS]
SAID = {
    "fingertip_links": [f"outer{finger}" for finger in FINGERS],
    "closing_joints": INNER,
    "closing_speed": 1.5,
    "closing_torque": 0.8,
    "palm": 0.04,
}
"""What the tutorial says of its hand beside the URDF."""


def run(blocks: list[str], folder: Path) -> dict[str, Any]:
    """Run blocks of the tutorial, one after the other."""
    names: dict[str, Any] = {}
    with contextlib.chdir(folder):
        for block in blocks:
            exec(compile(block, "docs/hands.md", "exec"), names)
    return names


@pytest.fixture(scope="module")
def urdf(tmp_path_factory) -> str:
    """The tutorial's URDF."""
    path: Path = run(BLOCKS[:1], folder := tmp_path_factory.mktemp("hand"))["path"]
    return (folder / path).read_text()


Save = Callable[[str], Path]


@pytest.fixture
def save(tmp_path) -> Save:
    """Writes a URDF to a file whose name the engine has not seen."""
    numbers = count()

    def write(text: str) -> Path:
        path = tmp_path / f"hand{next(numbers)}.urdf"
        path.write_text(text)
        return path

    return write


def with_fixed_joints(urdf: str) -> str:
    """The hand on a mount, and with what touches on pads that are fixed to the outer links."""
    robot = ET.fromstring(urdf)

    def fix(name: str, parent: str, child: str) -> None:
        joint = ET.SubElement(robot, "joint", name=name, type="fixed")
        ET.SubElement(joint, "parent", link=parent)
        ET.SubElement(joint, "child", link=child)

    ET.SubElement(robot, "link", name="mount")
    fix("mounting", "mount", "palm")
    for finger in FINGERS:
        pad = ET.SubElement(robot, "link", name=f"pad{finger}")
        outer = robot.find(f"link[@name='outer{finger}']")
        assert outer is not None
        pad.append(outer[0])
        pad.append(outer[1])
        outer.remove(outer[1])
        fix(f"padding{finger}", f"outer{finger}", f"pad{finger}")
    return ET.tostring(robot, encoding="unicode")


def with_closing_downwards(urdf: str) -> str:
    """The same hand with the sense of its inner joints turned round."""
    inner = re.compile(r'(name="inner\d_joint".*?)0 -1 0(".*?)lower="-0.8" upper="1.4"', re.S)
    urdf = inner.sub(r'\g<1>0 1 0\g<2>lower="-1.4" upper="0.8"', urdf)
    return urdf.replace('multiplier="0.5"', 'multiplier="-0.5"')


HANDS: dict[str, tuple[Callable[[str], str], dict[str, Any]]] = {
    "tutorial": (str, {}),
    "fixed joints": (with_fixed_joints, {"fingertip_links": ["pad0", "pad1", "pad2"]}),
    "closing downwards": (
        with_closing_downwards,
        {"open_angles": {f"inner{finger}_joint": 0.8 for finger in FINGERS}},
    ),
}


@pytest.fixture(scope="module", params=HANDS)
def simulation(request, urdf, tmp_path_factory) -> Iterator[Simulation]:
    """A simulation of each hand."""
    change, said = HANDS[request.param]
    path = tmp_path_factory.mktemp("hand") / "hand.urdf"
    path.write_text(change(urdf))
    simulation = Simulation(HandDescription.from_urdf(path, **SAID | said))
    yield simulation
    simulation.close()


def test_tutorial_runs_and_its_figures_are_right(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    names = run(BLOCKS, tmp_path)
    figures = re.search(
        r"(\d+) of 100 attempts are grasps, (\d+) of (\d+) that can be carried hold", TEXT
    )
    assert figures is not None
    measured = names["grasps"], sum(names["held"]), len(names["held"])
    # another processor may round another way, and a grasp or two with it
    np.testing.assert_allclose(measured, [int(figure) for figure in figures.groups()], atol=4)


def test_tutorial_hand_is_what_its_urdf_says(urdf, save) -> None:
    hand = HandDescription.from_urdf(path := save(urdf), **SAID)
    joints = [f"{part}{finger}_joint" for finger in FINGERS for part in ("inner", "outer")]
    assert (hand.name, hand.base_link, hand.urdf) == ("three_fingers", "palm", path)
    assert hand.joint_names == tuple(joints)
    assert hand.link_names == tuple(joint.removesuffix("_joint") for joint in joints)
    assert hand.contact_links == ("palm", *hand.link_names)
    assert hand.joint_lower == (-0.8, 0.0) * 3
    assert hand.joint_upper == (1.4,) * 6
    assert hand.max_torque == (2.0,) * 6
    assert hand.max_speed == (3.0,) * 6
    assert hand.gears == tuple(
        Gear(f"inner{finger}_joint", f"outer{finger}_joint", 0.5, 0.4) for finger in FINGERS
    )
    assert hand.palm == (PalmRegion(-np.inf, 0.04),)
    assert (hand.held_joints, hand.spread_range) == ((), (0.0, 0.0))
    np.testing.assert_allclose(hand.open_angles(0.0), [-0.8, 0.0] * 3)


def test_what_is_said_comes_before_the_urdf(urdf, save) -> None:
    gear = Gear("inner0_joint", "outer0_joint", 1.0, 0.9)
    hand = HandDescription.from_urdf(
        save(urdf),
        **SAID | {"closing_joints": ["inner0_joint", "inner1_joint"]},
        gears=[gear],
        max_torque={"outer2_joint": 1.5},
        max_speed=4,
        open_angles={"inner2_joint": -0.2},
        contact_links=["outer0"],
        name="mine",
    )
    assert hand.gears[0] == gear
    assert len(hand.gears) == 3
    assert hand.max_torque == (2.0,) * 5 + (1.5,)
    assert hand.max_speed == (4.0,) * 6
    np.testing.assert_allclose(hand.open_angles(0.3), [-0.8, 0.1, -0.8, 0, -0.2, 0.3])
    assert hand.held_joints == ("inner2_joint",)
    assert hand.contact_links == ("outer0",)
    assert hand.name == "mine"


def test_gears_of_gears_lead_to_the_motor(urdf, save) -> None:
    chain = [
        Gear("outer0_joint", "outer1_joint", -0.5, 0.1),
        Gear("outer1_joint", "outer2_joint", 2),
    ]
    hand = HandDescription.from_urdf(
        save(urdf), **SAID | {"closing_joints": INNER[:1]}, gears=chain
    )
    gears = {gear.driven: gear for gear in hand.gears}
    assert gears["outer0_joint"] == Gear("inner0_joint", "outer0_joint", 0.5, 0.4)
    for name, ratio, offset in (("outer1_joint", -0.25, -0.1), ("outer2_joint", -0.5, -0.2)):
        assert gears[name].driver == "inner0_joint"
        np.testing.assert_allclose([gears[name].ratio, gears[name].offset], [ratio, offset])


def test_joints_close_with_a_speed_and_torque_of_their_own(urdf, save) -> None:
    speeds = {"inner2_joint": 1.0, "inner0_joint": 0.5, "inner1_joint": -0.25}
    torques = {"inner2_joint": 0.1, "inner0_joint": 0.2, "inner1_joint": 0.3}
    hand = HandDescription.from_urdf(
        save(urdf),
        **SAID | {"closing_speed": speeds, "closing_torque": torques},
        open_angles={"inner1_joint": 0.0},
    )
    assert hand.closing_speeds.tolist() == [0.5, -0.25, 1.0]
    assert hand.closing_torques.tolist() == [0.2, 0.3, 0.1]
    np.testing.assert_allclose(hand.closing_times, [4.4, 3.2, 2.2])


def test_everything_that_is_wrong_is_named_at_once(urdf, save) -> None:
    capsule = '<capsule radius="0.01" length="0.07"/>'
    text = urdf.replace(capsule, '<mesh filename="gone.stl"/>').replace(
        'type="revolute"', 'type="ball"'
    )
    with pytest.raises(HandError) as caught:
        HandDescription.from_urdf(save(text), **SAID)
    for finger in FINGERS:
        assert f"'gone.stl' of link 'inner{finger}'" in str(caught.value)
        assert f"Joint 'outer{finger}_joint' is of type 'ball'" in str(caught.value)
    wrong = {"fingertip_links": ["a"], "closing_speed": {"b": 1.0}, "max_torque": {"c": 1.0}}
    with pytest.raises(HandError, match=r"(?s)no link 'a'.*no joint 'c'.*numbers for 'b'"):
        HandDescription.from_urdf(save(urdf), **SAID | wrong)


def test_spread_joints_may_take_the_angles_that_all_of_them_can(urdf, save) -> None:
    said = SAID | {"closing_joints": ["inner0_joint"]}
    spread = ["inner1_joint", "inner2_joint"]
    text = urdf.replace('upper="1.4"', 'upper="0.7"', 3)
    hand = HandDescription.from_urdf(save(text), **said, spread_joints=spread)
    assert hand.spread_range == (-0.8, 0.7)
    assert hand.held_joints == tuple(spread)


def test_barrett_hand_from_its_urdf() -> None:
    hand = BARRETT_BH8_280
    read = HandDescription.from_urdf(
        hand.urdf,
        fingertip_links=hand.fingertip_links,
        closing_joints=hand.closing_joints,
        closing_speed=hand.closing_speed,
        closing_torque=hand.closing_torque,
        palm=hand.palm,
        gears=hand.gears,
        spread_joints=hand.spread_joints,
        spread_range=hand.spread_range,
    )
    for field in ("joint_lower", "joint_upper", "max_torque", "max_speed"):
        # the file has twelve digits
        np.testing.assert_allclose(getattr(read, field), getattr(hand, field), rtol=1e-11)
        read = replace(read, **{field: getattr(hand, field)})
    assert replace(read, joint_open=None) == hand
    assert hand.held_joints == hand.spread_joints
    assert hand.closing_speeds.tolist() == [hand.closing_speed] * 3


@settings(max_examples=25, deadline=None)
@given(data=st.data(), size=st.integers(2, 12))
def test_joints_are_in_the_order_of_the_simulator(data, size, tmp_path_factory) -> None:
    inertia = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    shape = '<origin xyz="0 0 1"/><geometry><sphere radius="1"/></geometry>'
    inertial = f'<inertial><mass value="1"/>{inertia}</inertial><collision>{shape}</collision>'
    limit = '<limit lower="0" upper="1" effort="1" velocity="1"/>'
    lines = [f'<link name="l{link}">{inertial}</link>' for link in range(size)]
    for link in data.draw(st.permutations(range(1, size))):
        kind = data.draw(st.sampled_from(["revolute", "prismatic", "fixed"])) if link > 1 else ""
        lines.append(
            f'<joint name="j{link}" type="{kind or "revolute"}"><parent link="l'
            f'{data.draw(st.integers(0, link - 1))}"/><child link="l{link}"/>{limit}</joint>'
        )
    path = tmp_path_factory.mktemp("tree") / "tree.urdf"
    path.write_text(f'<robot name="tree">{"".join(lines)}</robot>')
    hand = HandDescription.from_urdf(
        path, **SAID | {"fingertip_links": ["l1"], "closing_joints": ["j1"]}
    )
    client = p.connect(p.DIRECT)
    body = p.loadURDF(str(path), useFixedBase=True, physicsClientId=client)
    infos = [p.getJointInfo(body, joint, physicsClientId=client) for joint in range(size - 1)]
    p.disconnect(client)
    moving = [info for info in infos if info[2] != p.JOINT_FIXED]
    assert [info[1].decode() for info in moving] == list(hand.joint_names)
    assert [info[12].decode() for info in moving] == list(hand.link_names)
    assert hand.base_link == "l0"


def grasps(simulation: Simulation, number: int) -> Iterator[tuple[Grasp, Any]]:
    """The first grasps of held-out objects; the simulation is left in each."""
    objects = held_out_objects()
    made = 0
    for seed in range(2 * number):
        body = objects[objects.object_ids[seed]]
        grasp = attempt(body, simulation, seeded([17, seed])).grasp
        if grasp is not None and made < number:
            made += 1
            yield grasp, body
    assert made == number


def test_hand_grasps_and_keeps_its_gears_and_limits(simulation) -> None:
    hand = simulation.hand
    seen = set()
    for grasp, _ in grasps(simulation, 6):
        angles = dict(zip(hand.joint_names, grasp.joint_angles, strict=True))
        for gear in hand.gears:
            expected = gear.ratio * angles[gear.driver] + gear.offset
            assert angles[gear.driven] == pytest.approx(expected, abs=0.11)
        assert np.all(grasp.joint_angles >= np.array(hand.joint_lower) - 0.02)
        assert np.all(grasp.joint_angles <= np.array(hand.joint_upper) + 0.02)
        links = set(grasp.contacts.links.tolist())
        assert len(links) >= 3
        seen |= {("palm", *hand.link_names)[link + 1] for link in links}
    # pads are part of the links that they are fixed to
    assert hand.fingertip_links == ("outer0", "outer1", "outer2")
    assert seen > set(hand.fingertip_links)


def test_hand_jacobian_maps_contact_forces_to_the_motors_torques(simulation) -> None:
    """Locked joints carry object and links: J_h' f + tau_ext is what the engine's motors report."""
    gravity = np.array([2.0, 3.0, -9.0])
    names = simulation.hand.joint_names
    compared = 0
    for grasp, body in grasps(simulation, 12):
        simulation.load(body, grasp.pose, grasp.joint_angles, friction=0.8)
        simulation.drive(names, 0.0, 50.0)
        simulation.set_gravity(gravity)
        client = simulation.client
        p.setPhysicsEngineParameter(
            numSolverIterations=1000, solverResidualThreshold=1e-30, physicsClientId=client
        )
        for _ in range(480):
            simulation.step()
        raw = simulation.contacts()
        # locked joints do not press: some objects fall out, and some turn for seconds
        if not len(raw.links) or np.linalg.norm(simulation.object_velocity()) > 1e-5:
            continue
        compared += 1
        # the engine applies the force to the hand on the hand's side of the gap
        points = p.getContactPoints(
            simulation.object_id, simulation.hand_id, physicsClientId=client
        )
        frames = contact_frames(raw.normals)
        posture = simulation.posture()
        motion = posture.jacobians(np.array([point[6] for point in points]), raw.links)
        jacobian = (frames.transpose(0, 2, 1) @ motion).reshape(-1, len(names))
        forces = np.einsum("nij,ni->nj", frames, raw.forces).ravel()
        torque = jacobian.T @ forces + posture.gravity_map() @ gravity
        infos = [
            p.getJointInfo(simulation.hand_id, joint, physicsClientId=client)
            for joint in range(p.getNumJoints(simulation.hand_id, physicsClientId=client))
        ]
        number = {info[1].decode(): info[0] for info in infos}
        states = p.getJointStates(
            simulation.hand_id, [number[name] for name in names], physicsClientId=client
        )
        motor = np.array([state[3] for state in states])
        np.testing.assert_allclose(torque, motor, atol=1e-5 * np.abs(motor).max(), rtol=0)
        if compared == 4:
            break
    assert compared == 4


BAD_FILES: dict[str, tuple[str, str, str]] = {
    "no XML": ("<robot ", "<robot <", "no XML"),
    "no robot": ("robot", "sdf", "not <robot>"),
    "macros": (
        "<link ",
        '<x:macro xmlns:x="http://www.ros.org/wiki/xacro"/><link ',
        "`xacro hand0",
    ),
    "continuous": ('type="revolute"', 'type="continuous"', "revolute with limits"),
    "floating": ('type="revolute"', 'type="floating"', "revolute, prismatic or fixed"),
    "no limit": ("<limit ", "<limits ", "no <limit>"),
    "no upper limit": ('upper="1.4"', "", "cannot move"),
    "limit of words": ('lower="-0.8"', 'lower="open"', "lower='open'"),
    "limit NaN": ('lower="-0.8"', 'lower="nan"', "must be a number"),
    "no effort": ('effort="2"', "", "give effort in the <limit> of each"),
    "no velocity": ('velocity="3"', 'velocity="0"', "give velocity in the <limit> of each"),
    "mass of words": ('mass value="0.06"', 'mass value="light"', "value='light'"),
    "origin of words": ('xyz="0 0 0.016"', 'xyz="0 0"', "three numbers"),
    "no axis": ('<axis xyz="0 -1 0"/>', '<axis xyz="0 0 0"/>', "no direction"),
    "no shape": ('<box size="0.1 0.1 0.04"/>', '<plane normal="0 0 1"/>', "a <plane>"),
    "flat shape": ('size="0.1 0.1 0.04"', 'size="0.1 0.1 0"', "above 0"),
    "two links": ('<link name="outer1">', '<link name="outer0">', "more than one link 'outer0'"),
    "no mesh": ('<capsule radius="0.01" length="0.07"/>', '<mesh filename="a.stl"/>', "'a.stl'"),
    "unknown parent": ('parent link="palm"', 'parent link="wrist"', "'wrist'"),
    "two parents": ('child link="outer1"', 'child link="outer0"', "more than one joint"),
    "two palms": ('<link name="palm">', '<link name="wrist"/><link name="palm">', "'wrist'"),
    "loop": ('parent link="palm"', 'parent link="outer0"', "loop"),
    "unknown motor": ('mimic joint="inner', 'mimic joint="motor', "'motor0_joint'"),
    "gear out of its limits": ('offset="0.4"', 'offset="0.3"', "outside its limits"),
    "gear without ratio": ('multiplier="0.5"', 'multiplier="0"', "ratio not 0"),
    "gears in a circle": (
        'joint="inner0_joint" multiplier',
        'joint="outer0_joint" multiplier',
        "loop",
    ),
    "tips that nothing touches": (
        '<collision><origin xyz="0 0 0.0275"/><geometry><capsule radius="0.009" length="0.055"/>'
        "</geometry></collision>",
        "",
        "no <collision> moves with",
    ),
}


@pytest.mark.parametrize("fault", BAD_FILES)
def test_a_urdf_that_cannot_be_used_is_refused(fault, urdf, save) -> None:
    old, new, reason = BAD_FILES[fault]
    assert old in urdf
    with pytest.raises(HandError, match=re.escape(reason)):
        HandDescription.from_urdf(save(urdf.replace(old, new)), **SAID)


BAD_WORDS: dict[str, tuple[dict[str, Any], str]] = {
    "tip": ({"fingertip_links": ["tip"]}, "no link 'tip'; it has palm, inner0"),
    "no tips": ({"fingertip_links": []}, "fingertip_links is empty"),
    "tip that rests": ({"fingertip_links": ["palm"]}, "no joint moves 'palm'"),
    "contact": ({"contact_links": ["tip"]}, "no link 'tip'"),
    "closing": ({"closing_joints": ["inner0"]}, "no joint 'inner0'; it has inner0_joint"),
    "closing none": ({"closing_joints": ()}, "closing_joints is empty"),
    "closing a driven one": ({"closing_joints": ["outer0_joint"]}, "has the motor"),
    "closing and spread": ({"spread_joints": ["inner0_joint"]}, "close and to be held"),
    "spread": ({"spread_joints": ["yaw"]}, "no joint 'yaw'"),
    "gear": ({"gears": [Gear("motor", "outer0_joint", 1.0)]}, "no joint 'motor'"),
    "gears": ({"gears": [Gear("inner0_joint", "outer1_joint", 0.5, 0.4)] * 2}, "More than one"),
    "open": ({"open_angles": {"inner0": 0.0}}, "no joint 'inner0'"),
    "open too far": ({"open_angles": {"inner0_joint": -1.0}}, "outside its limits"),
    "torque": ({"max_torque": {"inner0": 1.0}}, "no joint 'inner0'"),
    "no torque": ({"max_torque": 0.0}, "must be positive"),
    "speed": ({"max_speed": -1.0}, "must be positive"),
    "closing speed": ({"closing_speed": -1.5}, "closing_speed must be a positive"),
    "closing speed of one": ({"closing_speed": {"inner0_joint": 1.0}}, "one for each of them"),
    "closing speed 0": ({"closing_speed": dict.fromkeys(INNER, 0.0)}, "finite and not 0"),
    "closing outwards": ({"closing_speed": dict.fromkeys(INNER, -1.0)}, "turn the sign"),
    "slow closing": ({"closing_speed": 0.02}, "longer than 10 s from open to closed"),
    "closing torque": ({"closing_torque": float("nan")}, "closing_torque must be a positive"),
    "strong closing": ({"closing_torque": 3.0}, "above the limit"),
    "spread range": ({"spread_range": (1.0, 0.0)}, "the lower first"),
    "palm": ({"palm": ()}, "palm needs a region"),
}


@pytest.mark.parametrize("fault", BAD_WORDS)
def test_a_description_that_does_not_fit_the_urdf_is_refused(fault, urdf, save) -> None:
    said, reason = BAD_WORDS[fault]
    with pytest.raises(HandError, match=re.escape(reason)):
        HandDescription.from_urdf(save(urdf), **SAID | said)


def test_a_missing_file_is_named(tmp_path) -> None:
    for path in (tmp_path / "none.urdf", tmp_path):
        with pytest.raises(HandError, match=re.escape(f"{path} cannot be read")):
            HandDescription.from_urdf(path, **SAID)


def test_meshes_are_found_where_the_simulator_finds_them(urdf, tmp_path) -> None:
    robots = tmp_path / "my_hand" / "urdf"
    robots.mkdir(parents=True)
    mesh = tmp_path / "my_hand" / "meshes" / "inner.obj"
    mesh.parent.mkdir()
    mesh.write_text(
        "v 0 0 0\nv 0.02 0 0\nv 0 0.02 0\nv 0 0 0.05\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
    )
    for number, name in enumerate(("../meshes/inner.obj", "package://my_hand/meshes/inner.obj")):
        path = robots / f"hand{number}.urdf"
        capsule = '<capsule radius="0.01" length="0.07"/>'
        path.write_text(urdf.replace(capsule, f'<mesh filename="{name}"/>'))
        hand = HandDescription.from_urdf(path, **SAID)
        client = p.connect(p.DIRECT)
        p.loadURDF(str(hand.urdf), physicsClientId=client)
        p.disconnect(client)
