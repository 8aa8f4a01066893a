"""Jacobians and gravity torques against the engine's own, on the Barrett hand and on any tree."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pybullet as p
import pytest
from scipy.spatial.transform import Rotation

from gfo_env.hand import BARRETT_BH8_280
from gfo_env.hand.posture import Posture, read_tree
from tests.support.seeds import seeded

LINKS = 9
KINDS = ("revolute", "prismatic", "fixed")
ROUNDING = 1e-6
"""The engine keeps the frames of links in single precision, or not much better."""


@pytest.fixture
def client() -> Iterator[int]:
    number = p.connect(p.DIRECT)
    yield number
    p.disconnect(number)


def triple(vector: Any) -> str:
    return " ".join(f"{x:.12g}" for x in vector)


def random_tree(rng: np.random.Generator, tilt: float) -> tuple[str, tuple[str, ...]]:
    """A URDF with every kind of joint, fixed ones too, and the names of its moving joints.

    Inertial frames are turned by up to `tilt` rad.
    """
    lines, names = ['<robot name="tree"><link name="l0"/>'], []
    for link in range(1, LINKS):
        kind = KINDS[int(rng.integers(3))] if link > 3 else KINDS[link - 1]
        axis = rng.normal(size=3)
        lines.append(
            f'<link name="l{link}"><inertial><origin xyz="{triple(rng.normal(0, 0.1, 3))}" '
            f'rpy="{triple(rng.uniform(-tilt, tilt, 3))}"/>'
            f'<mass value="{rng.uniform(0.1, 1.0):.12g}"/><inertia ixx="0.01" iyy="0.012" '
            f'izz="0.015" ixy="{2e-3 * (tilt > 0)}" ixz="0" iyz="0"/></inertial>'
            f'</link><joint name="j{link}" type="{kind}"><parent link="l{rng.integers(link)}"/>'
            f'<child link="l{link}"/><origin xyz="{triple(rng.normal(0, 0.2, 3))}" '
            f'rpy="{triple(rng.uniform(-3, 3, 3))}"/>'
            f'<axis xyz="{triple(axis / np.linalg.norm(axis))}"/>'
            '<limit lower="-9" upper="9" effort="1" velocity="1"/></joint>'
        )
        if kind != "fixed":
            names.append(f"j{link}")
    return "".join([*lines, "</robot>"]), tuple(names)


def posed(rng: np.random.Generator, client: int, body: int) -> tuple[list[float], list[int]]:
    """Put the joints anywhere; returns positions and numbers of those that move."""
    infos = [
        p.getJointInfo(body, i, physicsClientId=client)
        for i in range(p.getNumJoints(body, physicsClientId=client))
    ]
    moving = [info[0] for info in infos if info[2] != p.JOINT_FIXED]
    positions = rng.uniform(-1.5, 1.5, len(moving)).tolist()
    for joint, position in zip(moving, positions, strict=True):
        p.resetJointState(body, joint, position, physicsClientId=client)
    return positions, moving


def posture_of(client: int, body: int, names: tuple[str, ...]) -> Posture:
    tree = read_tree(p, client, body, names)
    states = p.getLinkStates(
        body, range(len(tree.masses)), computeForwardKinematics=1, physicsClientId=client
    )
    return Posture(tree, *(np.array([state[entry] for state in states]) for entry in (4, 5, 0)))


def assert_as_the_engine(
    rng: np.random.Generator, client: int, body: int, names: tuple[str, ...], *, tilted: bool
) -> None:
    positions, moving = posed(rng, client, body)
    posture = posture_of(client, body, names)
    tree = posture.tree
    # the engine's columns are the moving joints in its order
    order = [moving.index(joint) for joint in tree.joints]
    still = [0.0] * len(moving)
    # where inertial frames are turned, the engine means other points than its manual says
    for link in range(0 if tilted else len(tree.masses)):
        local = rng.normal(0.0, 0.05, 3)
        state = p.getLinkState(body, link, computeForwardKinematics=1, physicsClientId=client)
        point = np.array(state[4]) + Rotation.from_quat(state[5]).apply(local)
        linear, _ = p.calculateJacobian(
            body, link, local.tolist(), positions, still, still, physicsClientId=client
        )
        expected = np.array(linear)[:, order]
        found = posture.jacobians(point[None], tree.bodies[[link]])[0]
        np.testing.assert_allclose(found, expected, atol=ROUNDING)
    for _ in range(3):
        gravity = rng.normal(0.0, 10.0, 3)
        p.setGravity(*gravity, physicsClientId=client)
        carried = p.calculateInverseDynamics(body, positions, still, still, physicsClientId=client)
        np.testing.assert_allclose(
            posture.gravity_map() @ gravity,
            np.array(carried)[order],
            atol=ROUNDING * 50.0,  # N and N·m of weights at arm's length
        )


@pytest.mark.parametrize("seed", range(5))
def test_barrett_hand(seed: int, client: int) -> None:
    hand = BARRETT_BH8_280
    flags = p.URDF_USE_INERTIA_FROM_FILE
    body = p.loadURDF(str(hand.urdf), useFixedBase=True, flags=flags, physicsClientId=client)
    rng = seeded(seed)
    assert_as_the_engine(rng, client, body, hand.joint_names, tilted=False)


@pytest.mark.parametrize("tilt", [0.0, 3.0])
@pytest.mark.parametrize("seed", range(6))
def test_any_tree_in_any_order_of_joints(seed: int, tilt: float, client: int, tmp_path) -> None:
    rng = seeded(seed)
    text, names = random_tree(rng, tilt)
    path = tmp_path / "tree.urdf"
    path.write_text(text)
    flags = p.URDF_USE_INERTIA_FROM_FILE
    body = p.loadURDF(str(path), useFixedBase=True, flags=flags, physicsClientId=client)
    shuffled = tuple(str(name) for name in rng.permutation(names))
    assert_as_the_engine(rng, client, body, shuffled, tilted=tilt > 0)


@pytest.mark.parametrize("seed", range(3))
def test_jacobians_are_derivatives(seed: int, client: int, tmp_path) -> None:
    """Of points that move with their links, by central differences, without the engine's word."""
    rng = seeded(100 + seed)
    text, names = random_tree(rng, 3.0)
    path = tmp_path / "tree.urdf"
    path.write_text(text)
    body = p.loadURDF(str(path), useFixedBase=True, physicsClientId=client)
    positions, moving = posed(rng, client, body)
    here = posture_of(client, body, names)
    local = rng.normal(0.0, 0.1, 3)
    links = np.arange(len(here.tree.masses))
    turned = Rotation.from_quat(here.orientations).apply(local)
    found = here.jacobians(here.origins + turned, here.tree.bodies[:-1])
    step = 3e-3
    for column, joint in enumerate(here.tree.joints):
        ends = []
        at = positions[moving.index(int(joint))]
        for change in (step, -step):
            p.resetJointState(body, joint, at + change, physicsClientId=client)
            there = posture_of(client, body, names)
            ends.append(there.origins + Rotation.from_quat(there.orientations).apply(local))
        p.resetJointState(body, joint, at, physicsClientId=client)
        np.testing.assert_allclose(
            found[links, :, column], (ends[0] - ends[1]) / (2 * step), atol=5e-5
        )


def test_the_base_is_moved_by_no_joint(client: int) -> None:
    hand = BARRETT_BH8_280
    body = p.loadURDF(str(hand.urdf), useFixedBase=True, physicsClientId=client)
    posed(seeded(0), client, body)
    posture = posture_of(client, body, hand.joint_names)
    assert not posture.jacobians(np.ones((2, 3)), np.array([-1, -1])).any()
    assert posture.jacobians(np.zeros((0, 3)), np.zeros(0, dtype=np.int64)).shape == (0, 3, 8)
    # a joint moves what comes after it alone
    mixed = posture.jacobians(np.ones((2, 3)), np.array([-1, 0]))
    assert not mixed[0].any()
    assert mixed[1].any()
