"""The policy that picks, of forces of the most quality, what the reward pays most for."""

import numpy as np
import pytest

from gfo_env.env import GraspForceEnv
from gfo_env.observation import can_balance, unpack
from gfo_env.policy import SolverPolicy
from gfo_env.reward import RewardWeights
from solvers import make_solver
from training.rl.quality_policy import QualityPolicy, farthest_contact


@pytest.fixture(scope="module")
def env() -> GraspForceEnv:
    return GraspForceEnv(split="test", mode="static", preload=0.0)


def policy(**weights: float) -> QualityPolicy:
    return QualityPolicy(make_solver("quality"), 20.0, RewardWeights(**weights))


def test_only_the_prices_of_the_reward_decide(env: GraspForceEnv) -> None:
    least = SolverPolicy("dual_newton", max_force=20.0)
    frugal, lavish = policy(q_lrw=0.0, effort=1.0), policy(q_lrw=1.0, effort=0.0)
    even = QualityPolicy(make_solver("uniform_preload"), 20.0, RewardWeights(q_lrw=1.0, effort=0.0))
    seen = 0
    for seed in range(12):
        observation, _ = env.reset(seed=seed)
        actions = [one.predict(observation)[0] for one in (least, frugal, lavish, even)]
        _, _, _, _, info = env.step(actions[2])
        if not can_balance(unpack(observation)["grasp_map"]) or not info["is_success"]:
            continue
        # a billionth more budget, and the most quality within it, not the least norm
        np.testing.assert_allclose(actions[1], actions[0], atol=1e-3)
        effort = [float(action[2::3].sum()) for action in actions]
        assert effort[2] >= effort[0] - 1e-6
        assert effort[2] > 1.2 * effort[0] or effort[3] <= effort[2] + 1e-6
        seen += 1
    assert seen > 5


def test_every_action_holds_where_the_solver_holds(env: GraspForceEnv) -> None:
    least, chosen = SolverPolicy("dual_newton", max_force=20.0), policy(q_lrw=5.0, effort=5.0)
    rewards = []
    for seed in range(12):
        held = []
        for one in (least, chosen):
            observation, _ = env.reset(seed=seed)
            _, _, _, _, info = env.step(one.predict(observation)[0])
            held.append(info["is_success"])
            paid = 100.0 * info["reward_q_lrw"] + 50.0 * info["reward_effort"]
            rewards.append(paid if info["is_success"] else np.nan)
        assert held[0] == held[1]
    pairs = np.array(rewards).reshape(-1, 2)
    gain = (pairs[:, 1] - pairs[:, 0])[np.isfinite(pairs).all(axis=1)]
    assert gain.mean() > 0.0
    # the radius is not observed, so that a choice may be a little off
    assert (gain > -0.5).all()


def test_the_farthest_contact_is_read_off_the_grasp_map(env: GraspForceEnv) -> None:
    observation, _ = env.reset(seed=1)
    fields = unpack(observation)
    blocks = fields["grasp_map"].reshape(2, 3, -1, 3)
    largest = 0.0
    for i in np.flatnonzero(fields["contact_mask"]):
        axes, moments = blocks[0, :, i], blocks[1, :, i]
        # p = sum of e_k x (p x e_k) / 2
        position = 0.5 * np.sum(np.cross(axes.T, moments.T), axis=0)
        largest = max(largest, float(np.linalg.norm(position)))
    np.testing.assert_allclose(farthest_contact(fields["grasp_map"]), largest, rtol=1e-6)
