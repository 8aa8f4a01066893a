"""What the registered variants are: announced or not, simulated or static, which contacts."""

from collections.abc import Callable, Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as check_env_for_sb3

import gfo_env  # noqa: F401 (registers the environments)
from gfo_env.contacts import lowest_resisted_wrench
from gfo_env.env import GraspForceEnv
from gfo_env.mdp.observation import unpack
from gfo_env.mdp.reward import TERMS
from solvers import GraspForceProblem
from tests.support.episodes import (
    FIELDS,
    IDS,
    INFO,
    ORACLE,
    episode_of,
    oracle,
    play,
    random_actions,
    zeros,
)
from tests.support.seeds import reseeded

FEEDBACK = {
    "joint_positions": 8,
    "joint_velocities": 8,
    "contact_forces": 24,
    "object_velocity": 6,
}
STEADY: dict[str, Any] = {
    "push": 0.0,
    "twist": 0.0,
    "turn": 0.0,
    "mass_change": (1.0, 1.0),
    "friction_change": (1.0, 1.0),
}


@pytest.fixture
def make() -> Iterator[Callable[..., GraspForceEnv]]:
    made: list[GraspForceEnv] = []

    def factory(name: str = "GraspForce-v0", **arguments: Any) -> GraspForceEnv:
        env = gym.make(name, **{"split": "test"} | arguments).unwrapped
        assert isinstance(env, GraspForceEnv)
        made.append(env)
        return env

    yield factory
    for env in made:
        env.close()


# -- the contract, kept by all of them -------------------------------------------------------------


def test_all_are_registered() -> None:
    assert {name for name in gym.registry if name.startswith("GraspForce")} == set(IDS)


# what a hand feels has no bounds that can be told
@pytest.mark.filterwarnings("ignore:.*A Box observation space m.*infinity.*:UserWarning")
@pytest.mark.parametrize("name", IDS)
def test_checkers_find_nothing_to_complain_about(name: str) -> None:
    for render_mode in (None, "rgb_array"):
        made = gym.make(f"gfo_env:{name}", disable_env_checker=True, render_mode=render_mode)
        check_env(made.unwrapped, skip_render_check=render_mode is None)
        check_env_for_sb3(made.unwrapped, skip_render_check=render_mode is None)
        made.close()


@pytest.mark.parametrize("name", IDS)
@pytest.mark.parametrize("act", [oracle, random_actions(0)], ids=["oracle", "random"])
def test_episodes_keep_the_contract(
    name: str, act: Any, make: Callable[..., GraspForceEnv]
) -> None:
    env = make(name)
    for seed in range(3):
        steps = play(env, seed, act)
        for observation, reward, terminated, truncated, info in steps:
            assert observation in env.observation_space
            assert set(info) == INFO
            assert all(np.isfinite(info[key]) for key in INFO - {"object_id"})
            assert reward == pytest.approx(sum(info[f"reward_{name}"] for name in TERMS), abs=1e-12)
            assert not (terminated and truncated)
        assert not any(info["is_success"] for *_, info in steps[:-1])
        assert len({info["grasp"] for *_, info in steps}) == 1


# -- unannounced -----------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", ["dynamic", "static"])
def test_feedback_has_its_shapes(mode: str, make: Callable[..., GraspForceEnv]) -> None:
    env = make("GraspForceUnannounced-v0", mode=mode)
    space = env.observation_space
    assert isinstance(space, gym.spaces.Dict)
    assert set(space) == set(FIELDS) | set(FEEDBACK)
    assert {name: space[name].shape for name in FEEDBACK} == {
        name: (size,) for name, size in FEEDBACK.items()
    }
    for seed in range(3):
        for observation, *_ in play(env, seed, oracle):
            contacts = int(observation["contact_mask"].sum())
            assert not observation["contact_forces"][3 * contacts :].any()
            assert all(np.isfinite(observation[name]).all() for name in FEEDBACK)


def test_only_the_weight_and_the_friction_of_the_beginning_are_known(
    make: Callable[..., GraspForceEnv],
) -> None:
    """Gravity that turns with the hand is felt; pushes, masses and frictions come as a surprise."""
    env, known = make("GraspForceUnannounced-v0"), make()
    surprises = 0
    for seed in range(6):
        blind, told = play(env, seed, oracle), play(known, seed, zeros)
        schedule = episode_of(env).schedule
        mass, friction = schedule.mass[0], blind[0][0]["friction"][0]
        for observation, *_ in blind:
            assert not observation["external_wrench"][3:].any()
            size = np.linalg.norm(observation["external_wrench"])
            assert size == pytest.approx(mass * 9.80665, rel=1e-5)
            mask = observation["contact_mask"]
            np.testing.assert_array_equal(observation["friction"], friction * mask)
        # the same loads underneath: the first observations agree
        for name in FIELDS:
            np.testing.assert_array_equal(blind[0][0][name], told[0][0][name])
        surprises += schedule.push.any() + (schedule.friction != schedule.friction[0]).any()
    assert surprises > 3


def test_rewards_judge_by_the_true_load(make: Callable[..., GraspForceEnv]) -> None:
    """The residual of forces that balance what is known is the surprise itself."""
    env = make("GraspForceUnannounced-v0", **STEADY | {"push": 2.0})
    env.reset(seed=reseeded(0))
    for seed in range(10):
        observation, *_ = play_to(env, seed, 6)
        if env._episode is None or env._episode.step != 6:
            continue
        problem = GraspForceProblem(**unpack(observation))
        true = env._episode.problem()
        assert true is not None
        push = true.external_wrench - problem.without_padding().external_wrench
        assert np.linalg.norm(push[:3]) == pytest.approx(2.0, rel=1e-4)
        _, _, _, _, info = env.step(oracle(observation))
        if info["friction_violation"] < 1e-6 and info["effort"] > 0:
            assert info["wrench_residual"] > 0.1
            return
    pytest.fail("no episode reached its first push")


def play_to(env: GraspForceEnv, seed: int, step: int) -> tuple[dict[str, Any], ...]:
    observation, _ = env.reset(seed=reseeded(seed))
    for _ in range(step):
        observation, _, terminated, truncated, _ = env.step(oracle(observation))
        if terminated or truncated:
            break
    return (observation,)


def test_announced_wrenches_are_those_of_the_schedule(make: Callable[..., GraspForceEnv]) -> None:
    env = make()
    for seed in range(4):
        observation, _ = env.reset(seed=reseeded(seed))
        for step in range(env.horizon):
            episode = episode_of(env)
            assert episode.step == step
            in_hand = episode.schedule.wrench(step).reshape(2, 3)
            in_object = in_hand @ episode.present.pose.rotation
            np.testing.assert_allclose(
                observation["external_wrench"], in_object.ravel(), rtol=1e-5, atol=1e-6
            )
            mask = observation["contact_mask"]
            np.testing.assert_allclose(observation["friction"], episode.friction * mask, rtol=1e-6)
            observation, _, terminated, truncated, _ = env.step(oracle(observation))
            if terminated or truncated:
                break


def test_measured_contact_forces_carry_the_object_at_rest(
    make: Callable[..., GraspForceEnv],
) -> None:
    env = make("GraspForceUnannounced-v0", **STEADY)
    off, speeds = [], []
    for seed in range(8):
        steps = play(env, seed, oracle)
        if not steps[-1][4]["is_success"]:
            continue
        for observation, *_ in steps[12:30]:
            fields = unpack(observation)
            balance = fields["grasp_map"] @ observation["contact_forces"]
            load = fields["external_wrench"]
            off.append(np.linalg.norm(balance[:3] + load[:3]) / np.linalg.norm(load[:3]))
            speeds.append(np.abs(observation["object_velocity"][:3]).max())
            # contacts push and do not pull, and slide along their cones at most
            forces = observation["contact_forces"].reshape(-1, 3)
            assert (forces[:, 2] >= 0.0).all()
            sliding = np.linalg.norm(forces[:, :2], axis=1)
            assert (sliding <= 1.5 * fields["friction"] * forces[:, 2] + 0.05).all()
    assert len(off) > 50
    assert np.median(off) < 0.05
    assert np.quantile(off, 0.9) < 0.3
    assert np.median(speeds) < 0.005


def test_feedback_before_the_first_step_is_of_a_hand_at_rest(
    make: Callable[..., GraspForceEnv],
) -> None:
    env = make("GraspForceUnannounced-v0")
    observation, _ = env.reset(seed=reseeded(0))
    assert not observation["joint_velocities"].any()
    assert not observation["object_velocity"].any()
    normal = observation["contact_forces"].reshape(-1, 3)[:, 2]
    contacts = int(observation["contact_mask"].sum())
    assert (normal[:contacts] > 0.0).all()
    assert (np.diff(normal[:contacts]) <= 0.0).all()
    start = episode_of(env).start
    np.testing.assert_allclose(observation["joint_positions"], start.joint_angles, rtol=1e-6)


# -- static ----------------------------------------------------------------------------------------


def test_static_episodes_need_no_simulator(make: Callable[..., GraspForceEnv]) -> None:
    env = make("GraspForceStatic-v0")
    for seed in range(20):
        observation, _ = env.reset(seed=reseeded(seed))
        *_, terminated, truncated, _ = env.step(oracle(observation))
        assert terminated
        assert not truncated
    assert env.simulation._bullet is None


def test_static_success_is_feasibility(make: Callable[..., GraspForceEnv]) -> None:
    """Forces that solve the problem succeed; forces that are off by much do not."""
    env = make("GraspForceStatic-v0")
    feasible = 0
    for seed in range(20):
        observation, _ = env.reset(seed=reseeded(seed))
        problem = GraspForceProblem(**unpack(observation))
        planned = problem.replace(friction=0.8 * problem.friction)
        status = str(ORACLE.solver.solve(planned).status)
        _, reward, _, _, info = env.step(oracle(observation))
        if status == "optimal":
            feasible += 1
            assert info["is_success"]
            assert info["reward_holding"] > 0.999
            env.reset(seed=reseeded(seed))
            _, worse, _, _, info = env.step(np.clip(3.0 * oracle(observation), -1.0, 1.0))
            assert not info["is_success"]
            assert worse < reward
    assert feasible >= 8  # another twenty had 11


def test_zero_forces_never_succeed_in_statics(make: Callable[..., GraspForceEnv]) -> None:
    env = make("GraspForceStatic-v0")
    successes = [play(env, seed, zeros)[-1][4]["is_success"] for seed in range(20)]
    # light objects, too, whose weight is far below the preload
    for seed in range(20):
        env.reset(seed=reseeded(seed), options={"mass": 0.02})
        successes.append(env.step(np.zeros(24, np.float32))[4]["is_success"])
    assert not any(successes)


def test_static_loads_are_of_every_kind(make: Callable[..., GraspForceEnv]) -> None:
    env = make("GraspForceStatic-v0")
    sizes = []
    for seed in range(20):
        observation, _ = env.reset(seed=reseeded(seed))
        sizes.append(np.linalg.norm(observation["external_wrench"].reshape(2, 3), axis=1))
    twisted = np.array(sizes)[:, 1] > 1e-6
    assert 1 <= twisted.sum() <= 12
    np.testing.assert_allclose(np.array(sizes)[twisted, 1], 0.05, rtol=1e-5)


# -- contacts, objects, torques, quality -----------------------------------------------------------


def test_fingertips_alone_touch(make: Callable[..., GraspForceEnv]) -> None:
    env = make("GraspForceFingertips-v0")
    tips = {env.hand.link_names.index(name) for name in env.hand.fingertip_links}
    for seed in range(4):
        observation, _ = env.reset(seed=reseeded(seed))
        over = False
        while not over:
            links = episode_of(env).present.contacts.links
            assert set(links.tolist()) <= tips
            # every contact is moved by a finger: its rows of the Jacobian are not zero
            jacobian = unpack(observation)["hand_jacobian"].reshape(8, 3, -1)
            assert np.abs(jacobian[: len(links)]).max(axis=(1, 2), initial=1.0).min() > 1e-3
            observation, _, terminated, truncated, _ = env.step(oracle(observation))
            over = terminated or truncated


def test_object_ids_restrict_the_objects(make: Callable[..., GraspForceEnv]) -> None:
    fixed = make("GraspForceFixedObject-v0")
    assert {fixed.reset(seed=reseeded(seed))[1]["object_id"] for seed in range(6)} == {"010"}
    assert len({fixed.reset(seed=reseeded(seed))[1]["grasp"] for seed in range(6)}) > 1
    two = make(object_ids=("010", "020"), mode="static")
    assert {two.reset(seed=reseeded(seed))[1]["object_id"] for seed in range(30)} == {"010", "020"}


def test_torque_scales_reach_observation_and_limits(make: Callable[..., GraspForceEnv]) -> None:
    env = make(torque_scale_range=(0.05, 2.0), mode="static")
    strongest = np.array(env.hand.max_torque)
    scales = []
    for seed in range(20):
        observation, _ = env.reset(seed=reseeded(seed))
        scale = observation["torque_max"] / strongest
        np.testing.assert_allclose(scale, scale[0], rtol=1e-6)
        np.testing.assert_array_equal(observation["torque_min"], -observation["torque_max"])
        assert observation in env.observation_space
        scales.append(scale[0])
    assert 0.05 <= min(scales) < 0.5 < 1.5 < max(scales) <= 2.0
    weak, strong = make(torque_scale_range=(1e-3, 1e-3)), make()
    ends = [len(play(weak, seed, oracle)) for seed in range(4)]
    assert sum(ends) < sum(len(play(strong, seed, oracle)) for seed in range(4))


def test_exact_quality_is_the_hulls(make: Callable[..., GraspForceEnv]) -> None:
    exact = make(mode="static", exact_quality=True)
    estimate = make(mode="static")
    for seed in range(6):
        observation, _ = exact.reset(seed=reseeded(seed))
        episode = exact._episode
        assert episode is not None
        action = oracle(observation)
        _, _, _, _, info = exact.step(action)
        contacts = episode.present.contacts
        hull = lowest_resisted_wrench(
            contacts.positions,
            contacts.normals,
            np.full(len(contacts), episode.friction),
            normal_forces=20.0 * action[2 : 3 * len(contacts) : 3].astype(np.float64),
            length=episode.radius,
        )
        assert info["q_lrw"] == pytest.approx(hull.lower, rel=1e-9)
        estimate.reset(seed=reseeded(seed))
        assert estimate.step(action)[4]["q_lrw"] >= info["q_lrw"] * (1 - 1e-6)
