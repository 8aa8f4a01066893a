"""A preload of each contact as an action: what becomes of it, and agents that choose it."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium import spaces
from stable_baselines3.common.env_checker import check_env

import gfo_env
from gfo_env.conditions import FRICTION_FACTOR
from gfo_env.contacts import can_balance
from gfo_env.grasps.collection import CollectionPlan, collect
from gfo_env.mdp.observation import unpack
from gfo_env.policy import SolverPolicy
from solvers import GraspForceProblem
from solvers.problem import residuals
from tests.support.commands import run_command
from tests.support.seeds import reseeded, seeded
from tests.support.world import held_out_objects
from training.rl.network import ContactExtractor, ContactHead
from training.rl.planning import Planner
from training.rl.preloads import FEATURES, PreloadActions, contact_features
from training.rl.runs import learning_curve, load_agent

STATIC = "GraspForceStatic-v0"
CAP = 20.0
assert gfo_env


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("grasps") / "few.npz"
    collect(CollectionPlan(held_out_objects(), 20, 0), workers=1, output=path)
    return path


@pytest.fixture
def make(table: Path) -> Callable[..., gym.Env[Any, Any]]:
    def build(name: str = STATIC, **settings: Any) -> gym.Env[Any, Any]:
        arguments: dict[str, Any] = {"preload": 0.0, "split": "test", "grasps": str(table)}
        return gym.make(name, disable_env_checker=True, **arguments | settings)

    return build


def permuted(observation: dict[str, Any], order: np.ndarray) -> dict[str, Any]:
    """The observation with its contacts in another order."""
    columns = (3 * order[:, None] + np.arange(3)).reshape(-1)
    shapes = unpack(observation)
    moved = dict(observation)
    for name in ("friction", "normal_min", "normal_max", "contact_mask"):
        moved[name] = observation[name][order]
    moved["grasp_map"] = shapes["grasp_map"][:, columns].astype(np.float32).reshape(-1)
    moved["hand_jacobian"] = shapes["hand_jacobian"][columns].astype(np.float32).reshape(-1)
    return moved


def planned_problem(observation: dict[str, Any]) -> GraspForceProblem:
    """What forces are planned for: the observed problem with less friction."""
    fields = unpack(observation)
    return GraspForceProblem(**fields | {"friction": FRICTION_FACTOR * fields["friction"]})


# -- what actions mean -----------------------------------------------------------------------------


def test_the_lowest_action_is_the_solver_to_the_bit(make) -> None:
    plain, wrapped = make(), PreloadActions(make())
    policy = SolverPolicy("dual_newton")
    lowest = -np.ones(8, np.float32)
    for seed in range(10):
        seen, _ = plain.reset(seed=reseeded(seed))
        also, _ = wrapped.reset(seed=reseeded(seed))
        assert all(np.array_equal(seen[name], also[name]) for name in seen)
        action = policy.predict(seen)[0]
        np.testing.assert_array_equal(wrapped.forces(lowest), action)
        assert plain.step(action)[1:] == wrapped.step(lowest)[1:]


def test_forces_meet_every_constraint_whatever_the_action(make) -> None:
    env = PreloadActions(make())
    policy = SolverPolicy("dual_newton")
    rng = seeded(0)
    changed = 0
    for seed in range(30):
        seen, _ = env.reset(seed=reseeded(seed))
        problem = planned_problem(seen)
        forces = CAP * env.forces(rng.uniform(-1.5, 1.5, 8)).astype(np.float64)
        solved = CAP * policy.predict(seen)[0].astype(np.float64)
        if not can_balance(problem.grasp_map) or np.array_equal(forces, solved):
            continue
        changed += 1
        assert residuals.equilibrium_residual(problem, forces) < 1e-4
        assert residuals.friction_violation(problem, forces) < 1e-5
        assert residuals.normal_violation(problem, forces) < 1e-5
        assert residuals.torque_violation(problem, forces) < 1e-5
        assert not forces.reshape(8, 3)[seen["contact_mask"] == 0].any()
    assert changed > 10


def test_each_contact_gets_its_own_preload(make) -> None:
    env = PreloadActions(make(push=0.0, twist=0.0, mass_range=(0.1, 0.15)))
    rng = seeded(0)
    met = 0
    for seed in range(20):
        seen, _ = env.reset(seed=reseeded(seed))
        action = rng.uniform(-1.0, 0.4, 8)
        normal = CAP * env.forces(action)[2::3]
        asked = 10.0 * ((action + 1.0) / 2.0) ** 3 * seen["contact_mask"]
        solved = CAP * env.forces(-np.ones(8))[2::3]
        assert (normal > solved - 1e-3).any()
        met += bool((normal > asked - 1e-4).all() and (normal < solved - 1e-3).sum() < 8)
    assert met > 10


def test_one_preload_for_all_is_that_of_the_planner(make) -> None:
    env = make()
    planner = Planner("dual_newton")
    for seed in range(5):
        seen, _ = env.reset(seed=reseeded(seed))
        alike = planner.action(seen, np.zeros(6), 1.5)
        each = planner.action(seen, np.zeros(6), 1.5 * seen["contact_mask"])
        np.testing.assert_array_equal(alike, each)


def test_contacts_in_another_order_get_the_same_forces(make) -> None:
    env = PreloadActions(make())
    rng = seeded(3)
    for seed in range(5):
        env.reset(seed=reseeded(seed))
        order = rng.permutation(8)
        columns = (3 * order[:, None] + np.arange(3)).reshape(-1)
        action = rng.uniform(-1.0, 1.0, 8)
        before = env.forces(action)
        env._observation = permuted(env._observation, order)
        np.testing.assert_allclose(env.forces(action[order]), before[columns], atol=1e-5)


def test_padding_has_no_effect(make) -> None:
    env = PreloadActions(make())
    padded = 0
    for seed in range(10):
        seen, _ = env.reset(seed=reseeded(seed))
        mask = seen["contact_mask"]
        padded += bool((mask == 0).any())
        one, other = np.where(mask > 0, 0.2, -1.0), np.where(mask > 0, 0.2, 1.0)
        np.testing.assert_array_equal(env.forces(one), env.forces(other))
        lowest = env.forces(-np.ones(8))
        np.testing.assert_array_equal(env.forces(np.where(mask > 0, -1.0, 1.0)), lowest)
        features = seen["contact_features"].reshape(8, FEATURES)
        assert not features[mask == 0].any()
    assert padded > 0


def test_quality_can_be_bought(make) -> None:
    """With the same preload for all, more preload is more quality, and less reward at last.

    On average: so many episodes that both steps of the reward, 0.09 and -0.30, are five times
    what they vary by from draw to draw, 0.016 and 0.034.
    """
    weights = {"q_lrw": 5.0, "effort": 6.0}
    env = PreloadActions(make(reward_weights=weights))
    mean = {}
    for value in (-1.0, 0.0, 1.0):
        results = []
        for seed in range(200):
            env.reset(seed=reseeded(seed))
            _, reward, _, _, info = env.step(np.full(8, value, np.float32))
            results.append((info["q_lrw"], reward))
        mean[value] = np.mean(results, axis=0)
    assert mean[-1.0][0] < mean[0.0][0] < mean[1.0][0]
    assert mean[-1.0][1] < mean[0.0][1]
    assert mean[1.0][1] < mean[0.0][1]


@pytest.mark.parametrize("env", [STATIC, "GraspForceUnannounced-v0"])
def test_the_wrapper_keeps_the_contract(make, env) -> None:
    horizon = {} if env == STATIC else {"horizon": 4}
    check_env(PreloadActions(make(env, **horizon)), skip_render_check=True)


# -- what the agent sees ---------------------------------------------------------------------------


def test_features_tell_the_quality(make) -> None:
    """The farthest reach along the weakest direction, of forces above the anchor, is q_lrw."""
    env = PreloadActions(make(preload=3.0))
    told, true = [], []
    for seed in range(40):
        seen, _ = env.reset(seed=reseeded(seed))
        share = float(seen["contact_features"].reshape(8, FEATURES)[0, 10])
        _, _, _, _, info = env.step(-np.ones(8, np.float32))
        told.append(share)
        true.append(info["q_lrw"] / (info["q_lrw"] + np.linalg.norm(seen["external_wrench"][:3])))
    assert np.ptp(true) > 0.1
    assert np.corrcoef(told, true)[0, 1] > 0.8


def test_network_gives_contacts_in_another_order_the_same_preloads(make) -> None:
    env = PreloadActions(make())
    space = env.observation_space
    assert isinstance(space, spaces.Dict)
    torch.manual_seed(reseeded(0))
    network = ContactExtractor(space)
    head = ContactHead(8, network.features_dim // 8, gain=1.0, outputs=1)

    def answer(observation: dict[str, Any]) -> np.ndarray:
        batch = {name: torch.as_tensor(values)[None] for name, values in observation.items()}
        with torch.no_grad():
            return head(network(batch)).numpy()[0]

    rng = seeded(0)
    for seed in range(5):
        seen, _ = env.reset(seed=reseeded(seed))
        order = rng.permutation(8)
        columns = (3 * order[:, None] + np.arange(3)).reshape(-1)
        problem = {name: seen[name] for name in seen if name != "contact_features"}
        moved = permuted(problem, order)
        forces = rng.normal(size=24)
        features = contact_features(problem, forces)
        np.testing.assert_allclose(
            contact_features(moved, forces[columns]), features[order], atol=1e-4
        )
        before = answer(problem | {"contact_features": features.astype(np.float32).reshape(-1)})
        turned = features[order].astype(np.float32).reshape(-1)
        after = answer(moved | {"contact_features": turned})
        assert np.ptp(before[seen["contact_mask"] > 0]) > 1e-3
        np.testing.assert_allclose(after, before[order], atol=1e-4)


# -- agents ----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_command_trains_and_goes_on(table, tmp_path) -> None:
    """A third of a run, then all of it: the second command goes on with the first one's."""
    arguments = (
        "--policy", "preloads", "--env", STATIC, "--env-kwargs", "preload:0", "split:test",
        f"grasps:{table}", "--envs", "2", "--evaluate-every", "64", "--evaluation-episodes", "4",
        "--checkpoint-every", "64", "--hyperparams", "n_steps:32", "batch_size:64", "n_epochs:2",
    )  # fmt: skip
    for steps in (64, 192):
        done = run_command("train_rl", "--output", tmp_path / "run", *arguments, "--steps", steps)
        assert done.returncode == 0, done.stderr
    agent = load_agent(tmp_path / "run")
    assert agent.model.action_space.shape == (8,)
    assert learning_curve(tmp_path / "run")[0].tolist() == [0, 64, 128, 192]
