"""Eight public hands as their makers have them: read, coupled, and good for grasps."""

import gymnasium
import numpy as np
import pytest

import gfo_env
from gfo_env.grasps.acquisition import attempt, least_links
from gfo_env.hand import HandDescription
from gfo_env.policy import SolverPolicy
from gfo_env.pose import Pose
from gfo_env.simulation import Simulation
from tests.support.hands import PUBLIC_HANDS, PublicHand
from tests.support.seeds import seeded
from tests.support.world import held_out_objects

assert gfo_env

PLAY = 0.11
"""rad or m: what gears and limits give way in the simulator."""


@pytest.fixture(scope="module", params=PUBLIC_HANDS)
def public(request, tmp_path_factory) -> PublicHand:
    return PUBLIC_HANDS[request.param](tmp_path_factory.mktemp("hand"))


@pytest.fixture(scope="module")
def hand(public, tmp_path_factory) -> HandDescription:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        if not public.made_up:
            return HandDescription.from_urdf(public.path, **public.said)
        with pytest.warns(UserWarning, match="made up"):
            return HandDescription.from_urdf(public.path, **public.said)


def test_hand_is_read_and_its_couplings_lead_to_motors(public, hand) -> None:
    assert len(hand.joint_names) == public.joints
    driven = {gear.driven for gear in hand.gears}
    assert public.joints - len(driven) == public.motors
    assert not driven & {gear.driver for gear in hand.gears}
    assert len(hand.fingertip_links) == len(public.said["fingertip_links"])


def test_hand_closes_to_its_limits_and_no_farther(hand) -> None:
    """With nothing in it, coupled joints stay so, and nothing goes through what stops it."""
    objects = held_out_objects()
    simulation = Simulation(hand)
    opened = hand.open_angles(hand.spread_range[0])
    away = Pose(np.full(3, 3.0), np.eye(3))
    simulation.load(objects[objects.object_ids[0]], away, opened, friction=0.8)
    simulation.couple()
    simulation.set_iterations(1000)
    simulation.drive(hand.held_joints, 0.0, 1.0)
    simulation.drive(hand.closing_joints, hand.closing_speeds, hand.closing_torques)
    for _ in range(round(240 * hand.closing_times.max()) + 60):
        simulation.step()
    angles, _ = simulation.joint_state()
    simulation.close()
    at = dict(zip(hand.joint_names, angles.tolist(), strict=True))
    for gear in hand.gears:
        assert at[gear.driven] == pytest.approx(
            gear.ratio * at[gear.driver] + gear.offset, abs=0.02
        )
    assert np.all(angles >= np.array(hand.joint_lower) - 0.02)
    assert np.all(angles <= np.array(hand.joint_upper) + 0.02)
    for name, speed in zip(hand.closing_joints, hand.closing_speeds, strict=True):
        joint = hand.joint_names.index(name)
        assert (at[name] - opened[joint]) * speed > 0


def test_hand_grasps(hand) -> None:
    objects = held_out_objects()
    simulation = Simulation(hand)
    for number in range(12):
        grasp = attempt(objects[objects.object_ids[number]], simulation, seeded([5, number])).grasp
        if grasp is not None:
            break
    simulation.close()
    assert grasp is not None
    assert len(set(grasp.contacts.links.tolist())) >= least_links(hand)
    assert grasp.contacts.balanceable
    at = dict(zip(hand.joint_names, grasp.joint_angles.tolist(), strict=True))
    for gear in hand.gears:
        assert at[gear.driven] == pytest.approx(
            gear.ratio * at[gear.driver] + gear.offset, abs=PLAY
        )
    assert np.all(grasp.joint_angles >= np.array(hand.joint_lower) - 0.03)
    assert np.all(grasp.joint_angles <= np.array(hand.joint_upper) + 0.03)


@pytest.mark.slow
def test_hand_holds_in_the_environment(hand, tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    env = gymnasium.make("GraspForce-v0", hand=hand, object_set="random_urdfs", split="test")
    policy = SolverPolicy("dual_newton")
    observation, info = env.reset(seed=0)
    over, rewards = False, []
    while not over:
        assert observation in env.observation_space
        action, _ = policy.predict(observation)
        observation, reward, terminated, truncated, info = env.step(action)
        rewards.append(reward)
        over = terminated or truncated
    env.close()
    assert np.isfinite(rewards).all()
    assert "is_success" in info
