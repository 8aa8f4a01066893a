"""The policy that picks, of forces of the most quality, what the reward pays most for."""

import numpy as np
import pytest

from gfo_env.env import GraspForceEnv
from gfo_env.mdp.observation import unpack
from gfo_env.mdp.reward import RewardWeights
from gfo_env.policy import SolverPolicy
from solvers import make_solver
from tests.support.seeds import reseeded
from training.rl.quality_policy import QualityPolicy, farthest_contact


@pytest.fixture(scope="module")
def env() -> GraspForceEnv:
    return GraspForceEnv(split="test", mode="static", preload=0.0)


def policy(**weights: float) -> QualityPolicy:
    return QualityPolicy(make_solver("quality"), RewardWeights(**weights))


def test_only_the_prices_of_the_reward_decide() -> None:
    judged = GraspForceEnv(split="test", mode="static", preload=0.0, exact_quality=True)
    least = SolverPolicy("dual_newton")
    frugal, lavish = policy(q_lrw=0.0, effort=1.0), policy(q_lrw=1.0, effort=0.0)
    even = QualityPolicy(make_solver("uniform_preload"), RewardWeights(q_lrw=1.0, effort=0.0))
    paid: list[list[tuple[float, float]]] = []
    for seed in range(12):
        infos = []
        for one in (least, frugal, lavish, even):
            observation, _ = judged.reset(seed=reseeded(seed))
            infos.append(judged.step(one.predict(observation)[0])[-1])
        if all(info["is_success"] for info in infos):
            paid.append([(info["reward_q_lrw"], -info["reward_effort"]) for info in infos])
    judged.close()
    assert len(paid) > 5
    quality, effort = np.moveaxis(np.array(paid), 2, 0)
    # columns: least norm, frugal, lavish, even. Who pays for effort alone spends the least, but
    # that the same sum of normal forces may have another norm
    assert effort[:, 1].mean() <= 1.02 * effort[:, 0].mean()
    assert effort[:, 2].mean() > 1.5 * effort[:, 1].mean()
    # who pays for quality alone never gets less than the least norm brings, mostly far more, and as
    # much as an even preload brings: it is where the solver's steps begin
    assert (quality[:, 2] >= quality[:, 0] - 1e-6).all()
    assert quality[:, 2].mean() > 2.0 * quality[:, 0].mean()
    assert quality[:, 2].mean() > 0.98 * quality[:, 3].mean()


def test_every_action_holds_where_the_solver_holds(env: GraspForceEnv) -> None:
    least, chosen = SolverPolicy("dual_newton"), policy(q_lrw=5.0, effort=5.0)
    rewards = []
    for seed in range(12):
        held = []
        for one in (least, chosen):
            observation, _ = env.reset(seed=reseeded(seed))
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
    observation, _ = env.reset(seed=reseeded(1))
    fields = unpack(observation)
    blocks = fields["grasp_map"].reshape(2, 3, -1, 3)
    largest = 0.0
    for i in np.flatnonzero(fields["contact_mask"]):
        axes, moments = blocks[0, :, i], blocks[1, :, i]
        # p = sum of e_k x (p x e_k) / 2
        position = 0.5 * np.sum(np.cross(axes.T, moments.T), axis=0)
        largest = max(largest, float(np.linalg.norm(position)))
    np.testing.assert_allclose(farthest_contact(fields["grasp_map"]), largest, rtol=1e-6)
