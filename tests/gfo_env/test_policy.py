"""Solvers as policies: the interface of SB3, batches, and what happens without an answer."""

from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv

from gfo_env.conditions import FRICTION_FACTOR, PRELOAD
from gfo_env.env import GraspForceEnv
from gfo_env.mdp.observation import unpack
from gfo_env.policy import SolverPolicy
from solvers import GraspForceProblem, UnknownSolverError, make_solver, solve
from tests.support.seeds import reseeded

Observation = dict[str, Any]


@pytest.fixture(scope="module")
def env() -> Iterator[GraspForceEnv]:
    made = GraspForceEnv(split="test")
    yield made
    made.close()


@pytest.fixture(scope="module")
def observations(env: GraspForceEnv) -> list[Observation]:
    return [env.reset(seed=reseeded(seed))[0] for seed in range(6)]


def stacked(observations: list[Observation]) -> Observation:
    return {name: np.stack([one[name] for one in observations]) for name in observations[0]}


def test_action_is_the_answer_of_the_solver(observations: list[Observation]) -> None:
    policy = SolverPolicy("clarabel")
    for observation in observations:
        action, state = policy.predict(observation)
        assert state is None
        assert action.dtype == np.float32
        fields = unpack(observation)
        fields["friction"] *= FRICTION_FACTOR
        solution = solve(GraspForceProblem(**fields), "clarabel")
        if solution.status == "optimal":
            np.testing.assert_allclose(20.0 * action, solution.forces, atol=1e-5)
        assert not action[3 * int(observation["contact_mask"].sum()) :].any()


@pytest.mark.parametrize("solver", ["clarabel", "pseudoinverse", "equal_squeeze"])
def test_a_batch_is_answered_like_its_members(
    observations: list[Observation], solver: str, env: GraspForceEnv
) -> None:
    policy = SolverPolicy(make_solver(solver))
    actions, _ = policy.predict(stacked(observations))
    assert actions.shape == (len(observations), 24)
    for action, observation in zip(actions, observations, strict=True):
        np.testing.assert_allclose(action, policy.predict(observation)[0], atol=1e-6)
        assert action in env.action_space


def test_naive_solvers_are_taken_at_their_word(observations: list[Observation]) -> None:
    action, _ = SolverPolicy("equal_squeeze").predict(observations[0])
    normal = action.reshape(-1, 3)[:, 2]
    mask = observations[0]["contact_mask"] > 0
    assert len(set(normal[mask])) == 1
    assert 0.1 <= normal[0] < 0.5
    assert not action.reshape(-1, 3)[:, :2].any()


def grips(action: np.ndarray, observation: Observation) -> bool:
    """Whether an action is the answer to an unanswerable observation: 11 N at every contact."""
    expected = np.zeros((8, 3))
    expected[:, 2] = observation["contact_mask"] * (PRELOAD + 20.0) / 2.0 / 20.0
    return np.allclose(action, expected.ravel())


def test_grips_where_contacts_are_too_few(observations: list[Observation]) -> None:
    policy = SolverPolicy("clarabel")
    for kept in (0, 1, 2):
        few = {name: array.copy() for name, array in observations[0].items()}
        for name, size in (("grasp_map", 3), ("hand_jacobian", 24), ("contact_mask", 1)):
            rows = few[name].reshape(6 if name == "grasp_map" else 1, -1)
            rows[:, size * kept :] = 0.0
        for name in ("friction", "normal_min", "normal_max"):
            few[name] *= few["contact_mask"]
        if kept < 2:
            assert grips(policy.predict(few)[0], few)
        mixed, _ = policy.predict(stacked([observations[0], few, observations[1]]))
        np.testing.assert_allclose(mixed[0], policy.predict(observations[0])[0], atol=1e-6)
        np.testing.assert_allclose(mixed[1], policy.predict(few)[0], atol=1e-6)


def test_grips_where_no_force_can_hold(observations: list[Observation]) -> None:
    policy = SolverPolicy("clarabel")
    hopeless = observations[0] | {"external_wrench": np.full(6, 1e3, np.float32)}
    assert grips(policy.predict(hopeless)[0], hopeless)


def test_max_force_scales_the_action(observations: list[Observation]) -> None:
    wide, _ = SolverPolicy("clarabel", max_force=40.0).predict(observations[0])
    action, _ = SolverPolicy("clarabel").predict(observations[0])
    np.testing.assert_allclose(2.0 * wide, action, atol=1e-6)
    tight, _ = SolverPolicy("clarabel", max_force=1e-3).predict(observations[0])
    assert np.abs(tight).max() == 1.0


def test_friction_factor_keeps_a_margin(observations: list[Observation]) -> None:
    kept = 0
    for observation in observations:
        for factor in (0.5, 1.0):
            fields = unpack(observation)
            fields["friction"] *= factor
            if solve(GraspForceProblem(**fields), "clarabel").status != "optimal":
                continue  # it plans with all of the friction, or grips
            action, _ = SolverPolicy("clarabel", friction_factor=factor).predict(observation)
            force = action.reshape(8, 3)
            tangential = np.linalg.norm(force[:, :2], axis=1)
            assert (tangential <= factor * observation["friction"] * force[:, 2] + 1e-6).all()
            kept += 1
    assert kept >= 4


def test_state_passes_through(observations: list[Observation]) -> None:
    state = (np.zeros(3),)
    policy = SolverPolicy("clarabel")
    _, returned = policy.predict(observations[0], state, np.array([False]), False)
    assert returned is state
    # a new episode has nothing to do with the last one
    assert policy.predict(observations[0], state, np.array([True]), False)[1] is None


def test_unknown_solver() -> None:
    with pytest.raises(UnknownSolverError):
        SolverPolicy("no_such_solver")


def test_evaluates_like_a_policy_of_stable_baselines() -> None:
    venv = DummyVecEnv(
        [lambda: Monitor(gym.make("gfo_env:GraspForce-v0", split="test", horizon=6))]
    )
    venv.seed(0)
    returns, lengths = evaluate_policy(
        SolverPolicy("clarabel"),  # type: ignore[arg-type]
        venv,
        n_eval_episodes=3,
        return_episode_rewards=True,
    )
    venv.close()
    assert isinstance(returns, list)
    assert isinstance(lengths, list)
    assert len(returns) == 3
    assert max(lengths) == 6
    assert max(returns) > 5.0
