"""One pass over what a step has led to: the bits of the functions whose code it calls."""

from collections.abc import Iterator

import numpy as np
import pytest

from gfo_env.contacts import RawContacts, closes, merge, quality_estimate, read_contacts
from gfo_env.env import GraspForceEnv
from gfo_env.grasps.problem import carrying_torques, in_object_frame
from gfo_env.mdp.actions import joint_torques
from gfo_env.mdp.episode import SimulatedEpisode
from gfo_env.mdp.force_quality import residuals_and_quality
from gfo_env.mdp.observation import pack, shapes
from solvers.judge import force_residuals
from tests.support.episodes import episode_of, oracle, random_actions, zeros
from tests.support.seeds import reseeded, seeded

ACTS = {"oracle": oracle, "random": random_actions(5), "dropping": zeros}


@pytest.fixture(scope="module", params=["hand", "fingertips"])
def env(request: pytest.FixtureRequest) -> Iterator[GraspForceEnv]:
    made = GraspForceEnv(split="test", contacts=request.param)
    yield made
    made.close()


def touching(episode: SimulatedEpisode) -> RawContacts:
    """The engine's contact points that count."""
    raw, names = episode.simulation.contacts(), (*episode.hand.link_names, None)
    counted = np.ones(len(raw.links), dtype=np.bool_)
    if episode.settings.fingertips:
        counted[:] = [names[link] in episode.hand.fingertip_links for link in raw.links]
    return RawContacts(*(values[counted] for values in vars(raw).values()))


@pytest.mark.parametrize("act", ACTS)
@pytest.mark.parametrize("seed", range(3))
def test_what_is_read_has_the_bits_of_the_single_functions(
    env: GraspForceEnv, act: str, seed: int
) -> None:
    observation, _ = env.reset(seed=reseeded(seed))
    for _ in range(12):
        observation, _, terminated, _, info = env.step(ACTS[act](observation))
        episode = episode_of(env)
        assert isinstance(episode, SimulatedEpisode)
        pose, posture = episode.simulation.object_pose(), episode.simulation.posture()
        merged = merge(touching(episode), episode.settings.max_contacts)
        contacts = read_contacts(merged, posture, episode.surface, pose)
        now = episode.present
        for name in ("positions", "frames", "links", "normal_forces", "jacobian", "grasp_map"):
            np.testing.assert_array_equal(getattr(now.contacts, name), getattr(contacts, name))
        np.testing.assert_array_equal(now.pose.position, pose.position)
        np.testing.assert_array_equal(now.pose.rotation, pose.rotation)
        np.testing.assert_array_equal(now.gravity_map, posture.gravity_map())
        assert now.contacts.balanceable is contacts.balanceable
        assert info["force_closure"] is (
            contacts.balanceable and closes(contacts, episode.friction)
        )
        gravity = episode.schedule.gravity[episode.step]
        torque = carrying_torques(gravity, posture.gravity_map())
        np.testing.assert_array_equal(episode.fields["external_torque"], torque)
        wrench = in_object_frame(episode.load, pose)
        np.testing.assert_array_equal(episode.fields["external_wrench"], wrench)
        packed = pack(episode.fields, shapes(episode.settings.max_contacts, 8))
        assert list(observation) == list(packed)
        for name, values in packed.items():
            np.testing.assert_array_equal(observation[name], values)
        if terminated:
            break


def test_forces_are_judged_like_the_single_functions(env: GraspForceEnv) -> None:
    rng = seeded(0)
    for seed in range(5):
        env.reset(seed=reseeded(seed))
        episode = episode_of(env)
        fields, contacts = episode.fields, episode.present.contacts
        for size in (0.0, 1.0, 20.0):
            forces = size * rng.normal(size=3 * len(contacts))
            residuals, quality = residuals_and_quality(fields, forces, episode.radius)
            problem = episode.problem()
            assert problem is not None
            assert residuals == force_residuals(problem, forces)
            assert quality == quality_estimate(
                contacts.grasp_map, fields["friction"], forces[2::3], episode.radius
            )


@pytest.mark.parametrize("count", range(4))
def test_joint_torques(count: int) -> None:
    rng = seeded(count)
    forces, jacobian = rng.normal(size=3 * count), rng.normal(size=(3 * count, 8))
    own, limit = rng.normal(size=8), np.full(8, 1.5)
    torques = joint_torques(forces, jacobian, own, -limit, limit)
    np.testing.assert_allclose(torques, np.clip(jacobian.T @ forces + own, -1.5, 1.5), atol=1e-12)
    assert (np.abs(torques) <= 1.5).all()
