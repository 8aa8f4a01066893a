"""Solvers as policies: the interface of SB3, batches, and what happens without an answer."""

from collections.abc import Callable, Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv

from gfo_env.conditions import FRICTION_FACTOR, PRELOAD
from gfo_env.env import GraspForceEnv
from gfo_env.exceptions import EnvironmentSettingsError, ObservationError
from gfo_env.mdp.observation import unpack
from gfo_env.policy import SolverPolicy
from solvers import GraspForceError, GraspForceProblem, UnknownSolverError, make_solver, solve
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


@pytest.mark.parametrize("max_force", [7.3, 10.0, 20.0, 40.0])
def test_actions_command_the_forces_of_the_solver(
    make: Callable[..., GraspForceEnv], max_force: float
) -> None:
    env = make(mode="static", max_force=max_force)
    policy, answered = SolverPolicy("dual_newton"), 0
    for seed in range(12):
        observation, _ = env.reset(seed=reseeded(seed))
        fields = unpack(observation)
        solution = solve(GraspForceProblem(**fields | {"friction": 0.8 * fields["friction"]}))
        if solution.status == "optimal":
            action, _ = policy.predict(observation)
            np.testing.assert_allclose(max_force * action, solution.forces, atol=1e-5)
            info = env.step(action)[4]
            assert info["effort"] == pytest.approx(np.linalg.norm(solution.forces), rel=1e-5)
            assert info["is_success"]
            answered += 1
    assert answered > 3


def test_a_batch_may_mix_largest_forces(observations: list[Observation]) -> None:
    policy = SolverPolicy("clarabel")
    strong = observations[1] | {"normal_max": 2.0 * observations[1]["normal_max"]}
    actions, _ = policy.predict(stacked([observations[0], strong]))
    np.testing.assert_allclose(actions[0], policy.predict(observations[0])[0], atol=1e-6)
    np.testing.assert_allclose(actions[1], policy.predict(strong)[0], atol=1e-6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda one: None, "not a NoneType"),
        (lambda one: np.concatenate(list(one.values())), "not a ndarray: .* not flattened"),
        (
            lambda one: {k: v for k, v in one.items() if k != "friction"},
            "friction.* missing",
        ),
        (lambda one: one | {"friction": one["friction"][:7]}, r"grasp_map .* \(126,\), .*\(144,\)"),
        (lambda one: one | {"grasp_map": one["grasp_map"].reshape(6, 24)}, r"grasp_map .*\(144,\)"),
        (lambda one: one | {"torque_max": one["torque_max"][:3]}, r"torque_max .* \(8,\)"),
        (lambda one: one | {"contact_mask": 1.0}, "contact_mask .* array of numbers"),
        (lambda one: one | {"external_wrench": ["x"] * 6}, "external_wrench .* array of numbers"),
        (lambda one: one | {"external_wrench": np.full(6, np.nan)}, "external_wrench .* finite"),
        (lambda one: one | {"grasp_map": np.full(144, np.inf)}, "grasp_map .* finite"),
        (lambda one: one | {"friction": one["friction"] - 1.0}, "not normalised"),
        (lambda one: one | {"contact_mask": one["contact_mask"] / 2.0}, "not normalised"),
        (lambda one: one | {"normal_min": one["normal_max"] + 1.0}, "not normalised"),
        (lambda one: {k: v[None, None] for k, v in one.items()}, r"dimensions \(1, 1\): flatten"),
    ],
)
def test_what_is_no_observation(
    observations: list[Observation], change: Callable[[Observation], Any], message: str
) -> None:
    policy = SolverPolicy("dual_newton")
    with pytest.raises(ObservationError, match=message) as caught:
        policy.predict(change(observations[0]))
    assert isinstance(caught.value, GraspForceError)


def test_a_batch_of_none(observations: list[Observation]) -> None:
    none = {name: np.zeros((0, *array.shape)) for name, array in observations[0].items()}
    assert SolverPolicy("dual_newton").predict(none)[0].shape == (0, 24)


def test_unpack_refuses_what_pack_does_not_make(observations: list[Observation]) -> None:
    twice = {name: np.stack([[array] * 3] * 2) for name, array in observations[0].items()}
    assert unpack(twice)["grasp_map"].shape == (2, 3, 6, 24)
    with pytest.raises(ObservationError, match="hand_jacobian"):
        unpack(twice | {"hand_jacobian": observations[0]["hand_jacobian"]})


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"solver": None}, "solver"),
        ({"solver": 3}, "solver"),
        ({"friction_factor": 0.0}, "friction_factor"),
        ({"friction_factor": 1.5}, "friction_factor"),
        ({"friction_factor": "0.8"}, "friction_factor"),
        ({"friction_factor": float("nan")}, "friction_factor"),
    ],
)
def test_bad_arguments_are_named(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(EnvironmentSettingsError, match=message):
        SolverPolicy(**{"solver": "clarabel"} | arguments)


def test_states_and_starts_of_a_batch(observations: list[Observation]) -> None:
    several, policy = stacked(observations[:3]), SolverPolicy("equal_squeeze")
    known = ((1,), (2,), (3,))
    assert policy.predict(several, known)[1] == known
    assert policy.predict(several, known, np.array([True, False, False]))[1] == (None, (2,), (3,))
    assert policy.predict(several, known, np.ones(3, dtype=bool))[1] is None
    with pytest.raises(ObservationError, match="as many states and starts, not 2 and 3"):
        policy.predict(several, known[:2])
    with pytest.raises(ObservationError, match="as many states and starts, not 3 and 1"):
        policy.predict(several, known, np.array([True]))


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
