"""The hand: its URDF in PyBullet against its Denavit-Hartenberg table and its published numbers."""

import pickle
from collections.abc import Iterator
from dataclasses import FrozenInstanceError
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pybullet as p
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from gfo_env.hand import BARRETT_BH8_280 as HAND
from gfo_env.hand import constants as c
from gfo_env.hand.kinematics import fingertip_poses, modified_dh
from gfo_env.hand.urdf import build_urdf

INDEX = {name: i for i, name in enumerate(HAND.joint_names)}
LINKS = (HAND.base_link, *HAND.link_names)


def load(client: int, urdf: Path = HAND.urdf) -> int:
    """Load the hand into a world without gravity, motors off, its base frame at the origin."""
    hand: int = p.loadURDF(
        str(urdf),
        useFixedBase=True,
        flags=p.URDF_USE_INERTIA_FROM_FILE,
        physicsClientId=client,
    )
    for joint in INDEX.values():
        p.setJointMotorControl2(hand, joint, p.VELOCITY_CONTROL, force=0, physicsClientId=client)
    return hand


@pytest.fixture
def client() -> Iterator[int]:
    client = p.connect(p.DIRECT)
    yield client
    p.disconnect(client)


@pytest.fixture
def hand(client: int) -> int:
    return load(client)


@pytest.fixture(scope="module")
def posed() -> Iterator[tuple[int, int]]:
    """A client and the hand in it, for tests that only set joint angles."""
    client = p.connect(p.DIRECT)
    yield client, load(client)
    p.disconnect(client)


def set_joints(client: int, hand: int, angles: np.ndarray) -> None:
    for joint, angle in enumerate(angles):
        p.resetJointState(hand, joint, angle, physicsClientId=client)


def simulated_fingertips(client: int, hand: int, angles: np.ndarray) -> np.ndarray:
    """Poses (3, 4, 4) of the DH fingertip frames on the simulated outer links."""
    set_joints(client, hand, angles)
    tip = modified_dh(c.DH_A_3, -np.pi / 2, c.DH_D_3, 0.0)
    poses = np.empty((3, 4, 4))
    for k, link in enumerate(HAND.fingertip_links):
        index = HAND.link_names.index(link)
        state = p.getLinkState(hand, index, computeForwardKinematics=True, physicsClientId=client)
        outer = np.eye(4)
        outer[:3, :3] = np.reshape(p.getMatrixFromQuaternion(state[5]), (3, 3))
        outer[:3, 3] = state[4]
        poses[k] = outer @ tip
    return poses


def joint_angles(spread: float, inner: np.ndarray, outer: np.ndarray) -> np.ndarray:
    return np.array(
        [spread, inner[0], outer[0], spread, inner[1], outer[1], inner[2], outer[2]], dtype=float
    )


def assert_same_fingertips(
    client: int, hand: int, spread: float, inner: np.ndarray, outer: np.ndarray
) -> None:
    expected = fingertip_poses(spread, inner, outer)
    actual = simulated_fingertips(client, hand, joint_angles(spread, inner, outer))
    np.testing.assert_allclose(actual[:, :3, 3], expected[:, :3, 3], rtol=0, atol=2e-5)
    np.testing.assert_allclose(actual[:, :3, :3], expected[:, :3, :3], rtol=0, atol=1e-5)


@pytest.mark.parametrize("spread", [0.0, 0.9, np.pi])
@pytest.mark.parametrize("inner", [0.0, 0.6, 1.2, 1.8, 2.1, c.INNER_UPPER])
def test_urdf_agrees_with_dh_table_along_the_closing_motion(
    posed: tuple[int, int], spread: float, inner: float
) -> None:
    angles = np.full(3, inner)
    assert_same_fingertips(*posed, spread, angles, angles * c.OUTER_PER_INNER)


@settings(max_examples=60, deadline=None)
@given(
    spread=st.floats(0.0, c.SPREAD_UPPER),
    inner=arrays(float, 3, elements=st.floats(0.0, c.INNER_UPPER)),
    outer=arrays(float, 3, elements=st.floats(0.0, c.OUTER_UPPER)),
)
def test_urdf_agrees_with_dh_table_anywhere(
    posed: tuple[int, int], spread: float, inner: np.ndarray, outer: np.ndarray
) -> None:
    assert_same_fingertips(*posed, spread, inner, outer)


@pytest.mark.parametrize(
    ("degrees", "y", "z"), [(0, -0.1486, 0.1205), (60, -0.0459, 0.1730), (140, 0.0291, 0.0729)]
)
def test_fingertips_match_values_measured_on_the_cad(degrees: float, y: float, z: float) -> None:
    inner = np.full(3, np.radians(degrees))
    tips = fingertip_poses(0.0, inner, inner / 3)[:, :3, 3]
    expected = [(-0.025, y, z), (0.025, y, z), (0.0, -y, z)]
    np.testing.assert_allclose(tips, expected, rtol=0, atol=7e-5)


def test_closing_turns_the_grasping_side_of_every_fingertip_to_the_centre() -> None:
    inner = np.full(3, np.pi / 3)
    for pose in fingertip_poses(np.pi / 3, inner, inner / 3):
        inward = -pose[:2, 3] / np.linalg.norm(pose[:2, 3])
        assert pose[:2, 2] @ inward > 0.5


def test_kinematics_names_wrong_shapes() -> None:
    with pytest.raises(ValueError, match=r"shape \(3,\)"):
        fingertip_poses(0.0, np.zeros(4), np.zeros(3))


def test_simulator_has_the_described_joints_in_order(client: int, hand: int) -> None:
    assert p.getNumJoints(hand, physicsClientId=client) == len(HAND.joint_names)
    assert p.getBodyInfo(hand, physicsClientId=client)[0].decode() == HAND.base_link
    for i, name in enumerate(HAND.joint_names):
        info = p.getJointInfo(hand, i, physicsClientId=client)
        assert info[1].decode() == name
        assert info[12].decode() == HAND.link_names[i]
        assert info[2] == p.JOINT_REVOLUTE
        limits = (HAND.joint_lower[i], HAND.joint_upper[i], HAND.max_torque[i], HAND.max_speed[i])
        assert info[8:12] == pytest.approx(limits, abs=1e-9)


def test_joint_ranges_are_the_published_ones() -> None:
    upper = np.degrees(HAND.joint_upper)
    np.testing.assert_allclose(upper, [180, 140, 48, 180, 140, 48, 140, 48])
    assert HAND.max_torque == (2.0, 2.0, 1.0, 2.0, 2.0, 1.0, 2.0, 1.0)
    assert set(HAND.joint_lower) == {0.0}


def test_simulator_has_the_published_inertia_and_the_armature(client: int, hand: int) -> None:
    total = 0.0
    for i, name in enumerate(LINKS, start=-1):
        kind = c.LINK_KIND[name]
        body = c.LINK_INERTIA[kind].with_flywheel(c.ARMATURE[kind])
        dynamics = p.getDynamicsInfo(hand, i, physicsClientId=client)
        total += dynamics[0]
        if name == HAND.base_link:
            # A fixed base has no mass in the simulator.
            total += body.mass
            continue
        assert dynamics[0] == pytest.approx(body.mass, rel=1e-9)
        assert dynamics[2] == pytest.approx(body.moments, rel=1e-6)
        assert dynamics[3] == pytest.approx(body.center_of_mass, abs=1e-9)
        assert dynamics[4] == pytest.approx((0, 0, 0, 1), abs=1e-9)
    assert total == pytest.approx(1.2013, abs=5e-5)


@pytest.mark.parametrize("armature", [True, False])
@pytest.mark.parametrize("kind", sorted(c.LINK_INERTIA))
def test_inertia_is_that_of_a_rigid_body(kind: str, armature: bool) -> None:
    body = c.LINK_INERTIA[kind].with_flywheel(c.ARMATURE[kind] if armature else 0.0)
    smallest, middle, largest = sorted(body.moments)
    assert smallest > 0
    # A thin disc meets the bound with equality, hence the rounding.
    assert largest <= (smallest + middle) * (1 + 1e-12)


def test_armature_adds_a_flywheel_about_each_joint(client: int, tmp_path: Path) -> None:
    bare = tmp_path / "bare.urdf"
    bare.write_text(build_urdf(armature=False), encoding="utf-8")
    angles = joint_angles(0.4, np.array([0.3, 1.0, 2.0]), np.array([0.1, 0.5, 0.7]))
    with_armature, without = (
        np.array(p.calculateMassMatrix(load(client, urdf), angles.tolist(), physicsClientId=client))
        for urdf in (HAND.urdf, bare)
    )
    added = with_armature - without
    inner, outer = c.ARMATURE["med"], c.ARMATURE["dist"]
    spread = c.ARMATURE["prox"] + (inner + outer) / 2
    finger = [[inner + outer, outer], [outer, outer]]
    expected = np.zeros((8, 8))
    expected[0, 0] = expected[3, 3] = spread
    for start in (1, 4, 6):
        expected[start : start + 2, start : start + 2] = finger
    np.testing.assert_allclose(added, expected, rtol=0, atol=1e-9)


def test_gears_couple_known_joints_within_their_limits() -> None:
    driven = [gear.driven for gear in HAND.gears]
    assert len(set(driven)) == len(driven)
    assert not set(driven) & {gear.driver for gear in HAND.gears}
    for gear in HAND.gears:
        reach = gear.ratio * HAND.joint_upper[INDEX[gear.driver]]
        assert reach <= HAND.joint_upper[INDEX[gear.driven]]
    independent = [name for name in HAND.joint_names if name not in driven]
    assert independent == ["f1_spread", "f1_med", "f2_med", "f3_med"]


def test_gear_constraints_hold_the_coupling_while_the_hand_closes(client: int, hand: int) -> None:
    for gear in HAND.gears:
        constraint = p.createConstraint(
            hand,
            INDEX[gear.driver],
            hand,
            INDEX[gear.driven],
            p.JOINT_GEAR,
            [0, 0, 1],
            [0, 0, 0],
            [0, 0, 0],
            physicsClientId=client,
        )
        p.changeConstraint(
            constraint, gearRatio=-1 / gear.ratio, maxForce=50, physicsClientId=client
        )
    drives = {"f1_spread": (0.5, HAND.max_torque[0])}
    drives |= dict.fromkeys(HAND.closing_joints, (HAND.closing_speed, HAND.closing_torque))
    for name, (speed, torque) in drives.items():
        p.setJointMotorControl2(
            hand,
            INDEX[name],
            p.VELOCITY_CONTROL,
            targetVelocity=speed,
            force=torque,
            physicsClientId=client,
        )
    p.setTimeStep(1 / 240, physicsClientId=client)
    for _ in range(240):
        p.stepSimulation(physicsClientId=client)
        states = p.getJointStates(hand, list(INDEX.values()), physicsClientId=client)
        for gear in HAND.gears:
            driver, driven = states[INDEX[gear.driver]][0], states[INDEX[gear.driven]][0]
            assert driven == pytest.approx(gear.ratio * driver, abs=1e-3)
    for name, (speed, _) in drives.items():
        # A second at speed, less the start: otherwise the coupling was never tried.
        assert states[INDEX[name]][0] > 0.8 * speed


def test_collision_shapes_have_the_described_surfaces(client: int, hand: int) -> None:
    p.stepSimulation(physicsClientId=client)
    for y in (0.0, -0.03, c.THUMB_KNUCKLE_Y + 0.003, 0.033):
        (hit,) = p.rayTestBatch([[0, y, 0.5]], [[0, y, -0.5]], physicsClientId=client)
        assert hit[0] == hand
        (described,) = HAND.surface_height(np.array([[0.0, y, 0.0]]))
        # the description keeps 1 mm off the thumb's knuckle
        assert described - 1.001e-3 <= hit[3][2] <= described + 1e-4


def test_open_hand_at_a_spread() -> None:
    angles = dict(zip(HAND.joint_names, HAND.open_angles(0.7), strict=True))
    assert {angles[name] for name in HAND.spread_joints} == {0.7}
    assert {angle for name, angle in angles.items() if name not in HAND.spread_joints} == {0.0}


def test_contact_links_are_links_with_collision_shapes(client: int, hand: int) -> None:
    assert set(HAND.contact_links) <= set(LINKS)
    for i, name in enumerate(LINKS, start=-1):
        shapes = p.getCollisionShapeData(hand, i, physicsClientId=client)
        assert len(shapes) == len(c.COLLISION[c.LINK_KIND[name]])


def test_committed_urdf_is_the_generated_one() -> None:
    assert HAND.urdf.read_text(encoding="utf-8") == build_urdf()


def test_urdf_suits_the_loader() -> None:
    # PyBullet gives a link without inertial 1 kg, and breaks on lines of 8191 bytes.
    assert max(len(line.encode()) for line in build_urdf().splitlines()) < 8191
    robot = ET.fromstring(build_urdf())
    for link in robot.iter("link"):
        assert {"inertial", "visual", "collision"} <= {child.tag for child in link}
    assert robot.find(".//mimic") is None


def test_description_is_immutable_and_picklable() -> None:
    with pytest.raises(FrozenInstanceError):
        HAND.name = "other"  # type: ignore[misc]
    assert pickle.loads(pickle.dumps(HAND)) == HAND
