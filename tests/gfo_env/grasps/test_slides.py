"""Hands whose joints are slides: any speed closes them, and two flat jaws are enough."""

from collections.abc import Iterator
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import trimesh

import gfo_env
from gfo_env.contacts import Surface, merge, read_contacts
from gfo_env.grasps.acquisition import Outcome, attempt, least_links
from gfo_env.hand import HandDescription
from gfo_env.objects import ObjectSet
from gfo_env.policy import SolverPolicy
from gfo_env.simulation import Simulation
from tests.support.seeds import seeded

assert gfo_env

PAD = '<box size="0.012 0.03 0.06"/>'
BAR = '<capsule radius="0.009" length="0.07"/>'


def link(name: str, mass: float, z: float, shape: str) -> str:
    return (
        f'<link name="{name}"><inertial><origin xyz="0 0 {0.7 * z}"/><mass value="{mass}"/>'
        '<inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial>'
        f'<collision><origin xyz="0 0 {z}"/><geometry>{shape}</geometry></collision></link>'
    )


def jaws(folder: Path, count: int, shape: str, speed: float) -> HandDescription:
    """So many jaws around a palm, each on a slide of 45 mm towards the middle."""
    text = link("palm", 0.6, 0.02, '<box size="0.12 0.12 0.04"/>')
    for k in range(count):
        yaw = 2 * np.pi * k / count
        foot = f"{0.055 * np.cos(yaw)} {0.055 * np.sin(yaw)} 0.05"
        text += link(f"jaw{k}", 0.08, 0.045, shape)
        text += (
            f'<joint name="slide{k}" type="prismatic"><parent link="palm"/><child link="jaw{k}"/>'
            f'<origin xyz="{foot}" rpy="0 0 {yaw}"/><axis xyz="-1 0 0"/>'
            '<limit lower="0" upper="0.045" effort="60" velocity="0.2"/></joint>\n'
        )
    path = folder / f"jaws{count}.urdf"
    path.write_text(f'<robot name="jaws">{text}</robot>')
    return HandDescription.from_urdf(
        path,
        fingertip_links=[f"jaw{k}" for k in range(count)],
        closing_joints=[f"slide{k}" for k in range(count)],
        closing_speed=speed,
        closing_torque=20.0,
        palm=0.04,
    )


@pytest.fixture
def objects(tmp_path) -> ObjectSet:
    folder = tmp_path / "meshes"
    folder.mkdir()
    trimesh.creation.icosphere(subdivisions=3, radius=0.025).export(folder / "ball.stl")
    trimesh.creation.box((0.05, 0.06, 0.08)).export(folder / "box.stl")
    return ObjectSet(folder)


@pytest.fixture
def two_pads(tmp_path) -> Iterator[Simulation]:
    simulation = Simulation(jaws(tmp_path, 2, PAD, 0.1))
    yield simulation
    simulation.close()


@pytest.mark.parametrize("speed", [0.005, 0.02, 0.1, 0.2])
def test_slides_close_until_they_touch_however_slow(speed, objects, tmp_path) -> None:
    simulation = Simulation(jaws(tmp_path, 3, BAR, speed))
    for seed in range(3):
        result = attempt(objects["ball.stl"], simulation, seeded(seed))
        assert result.outcome is Outcome.GRASP
        # the ball's 25 mm are left between the bar's 9 mm and the foot
        assert result.grasp is not None
        assert result.grasp.joint_angles.mean() == pytest.approx(0.021, abs=0.002)
    simulation.close()


def test_two_flat_jaws_grasp_what_they_can_balance(objects, two_pads) -> None:
    body = objects["box.stl"]
    outcomes = []
    for seed in range(12):
        result = attempt(body, two_pads, seeded(seed))
        outcomes.append(result.outcome)
        if result.grasp is not None:
            assert len(set(result.grasp.contacts.links.tolist())) == least_links(two_pads.hand) == 2
            assert result.grasp.contacts.balanceable
            continue
        pose = two_pads.object_pose()
        merged = merge(two_pads.contacts(), 8)
        contacts = read_contacts(merged, two_pads.posture(), Surface(body.solid), pose)
        assert not (contacts.balanceable and len(set(contacts.links.tolist())) >= 2)
    assert outcomes.count(Outcome.GRASP) >= 4


def test_two_jaws_hold_in_the_environment(objects, two_pads, tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    env = gymnasium.make("GraspForce-v0", hand=two_pads.hand, object_set=str(tmp_path / "meshes"))
    policy = SolverPolicy("dual_newton")
    observation, info = env.reset(seed=0)
    over = False
    while not over:
        assert observation in env.observation_space
        action, _ = policy.predict(observation)
        assert np.abs(action).max() > 0.0
        observation, reward, terminated, truncated, info = env.step(action)
        assert np.isfinite(float(reward))
        over = terminated or truncated
    assert info["object_id"] == "box.stl"
    assert isinstance(info["is_success"], bool)
    env.close()
