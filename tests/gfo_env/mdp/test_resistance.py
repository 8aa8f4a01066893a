"""The reward's term of passive resistance: off by default, and what it is where it is not."""

from collections.abc import Callable
from typing import Any

import cvxpy as cp
import numpy as np
import pytest

from gfo_env.conditions import JOINT_FRICTION
from gfo_env.env import GraspForceEnv
from gfo_env.exceptions import EnvironmentSettingsError
from gfo_env.mdp.resistance import disturbances_of, least_resistance
from solvers import GraspForceProblem, SolverError
from solvers.passive_resistance import LARGEST_MULTIPLE
from tests.support.episodes import Act, episode_of, oracle, play, random_actions, zeros
from tests.support.seeds import reseeded

WEIGHT = 0.4


def weighted(make: Callable[..., GraspForceEnv], **arguments: Any) -> GraspForceEnv:
    return make(reward_weights={"resistance": WEIGHT}, **arguments)


def test_disturbances_come_from_all_sides_and_those_of_size_zero_not_at_all() -> None:
    both = disturbances_of(2.0, 0.05)
    assert both.shape == (12, 6)
    np.testing.assert_array_equal(both.sum(axis=0), np.zeros(6))
    np.testing.assert_array_equal(np.abs(both).sum(axis=0), [4.0] * 3 + [0.1] * 3)
    assert (np.count_nonzero(both, axis=1) == 1).all()
    assert disturbances_of(0.0, 0.05).shape == (6, 6)
    assert not disturbances_of(0.0, 0.05)[:, :3].any()
    assert disturbances_of(0.0, 0.0).shape == (0, 6)


@pytest.mark.parametrize("arguments", [{}, {"announced": False}, {"mode": "static"}], ids=str)
@pytest.mark.parametrize("act", [oracle, zeros], ids=["oracle", "zeros"])
def test_the_term_is_off_by_default_and_changes_nothing_else(
    act: Act, arguments: dict[str, Any], make: Callable[..., GraspForceEnv]
) -> None:
    """Other terms, observations and ends of an episode are the same bits with it and without."""
    plain, priced = make(**arguments), weighted(make, **arguments)
    resisted = 0.0
    for seed in range(2):
        without, with_it = play(plain, seed, act), play(priced, seed, act)
        assert len(without) == len(with_it)
        for one, other in zip(without, with_it, strict=True):
            for name in one[0]:
                np.testing.assert_array_equal(one[0][name], other[0][name])
            assert one[2:4] == other[2:4]
            gained = other[4].pop("reward_resistance")
            resisted += other[4].pop("resistance")
            assert other[1] == pytest.approx(one[1] + gained, abs=1e-12)
            assert one[4].pop("reward_resistance") == one[4].pop("resistance") == 0.0
            assert one[4] == other[4]
            assert one[1] == sum(v for k, v in one[4].items() if k.startswith("reward_"))
    assert resisted > 0.0 or act is zeros


def test_nothing_is_computed_without_a_weight(
    make: Callable[..., GraspForceEnv], monkeypatch: pytest.MonkeyPatch
) -> None:
    def never(*arguments: Any) -> float:
        raise AssertionError("resistance was measured")

    monkeypatch.setattr("gfo_env.env.least_resistance", never)
    play(make(mode="static"), 0, oracle)
    with pytest.raises(AssertionError, match="measured"):
        weighted(make, mode="static").reset(seed=reseeded(0))


def resistance_by_cvxpy(
    problem: GraspForceProblem, forces: np.ndarray, push: float, twist: float
) -> float:
    """The least multiple, from the statement of the program in units of 50 mN·m."""
    n = problem.n_contacts
    units = np.repeat([1.0, 0.05], 3)
    grasp_map, load = problem.grasp_map / units[:, None], problem.external_wrench / units
    jacobian, friction = problem.hand_jacobian.T / 0.05, JOINT_FRICTION / 0.05
    told = jacobian @ forces + problem.external_torque / 0.05
    told = np.clip(told, problem.torque_min / 0.05, problem.torque_max / 0.05)
    told = told - problem.external_torque / 0.05

    def in_cones(x: cp.Variable) -> list[Any]:
        return [
            cp.norm(x[3 * i : 3 * i + 2]) <= problem.friction[i] * x[3 * i + 2] for i in range(n)
        ]

    x = cp.Variable(3 * n)
    settled = cp.Problem(
        cp.Minimize(cp.sum_squares(jacobian @ x - told)),
        [grasp_map @ x == -load, *in_cones(x)],
    )
    settled.solve(solver=cp.CLARABEL)
    if settled.status != "optimal":
        return 0.0
    torque = jacobian @ x.value
    least = np.inf
    for axis in range(6):
        for sign in (1.0, -1.0):
            wrench = np.zeros(6)
            wrench[axis] = sign * (push if axis < 3 else twist)
            f, s = cp.Variable(3 * n), cp.Variable(nonneg=True)
            program = cp.Problem(
                cp.Maximize(s),
                [
                    grasp_map @ f == -load - s * wrench / units,
                    cp.abs(jacobian @ f - torque) <= friction,
                    s <= LARGEST_MULTIPLE,
                    *in_cones(f),
                ],
            )
            program.solve(solver=cp.CLARABEL)
            assert program.status == "optimal"
            least = min(least, float(program.value))
    return least


@pytest.mark.parametrize("arguments", [{}, {"mode": "static"}], ids=str)
def test_the_term_is_what_an_independent_program_says(
    arguments: dict[str, Any], make: Callable[..., GraspForceEnv]
) -> None:
    env = weighted(make, push=1.5, twist=0.03, **arguments)
    for seed in range(3):
        observation, info = env.reset(seed=reseeded(seed))
        for _ in range(min(env.horizon, 2)):
            problem, action = episode_of(env).problem(), oracle(observation)
            assert problem is not None
            forces = 20.0 * action.astype(np.float64)[: 3 * problem.n_contacts]
            expected = resistance_by_cvxpy(problem, forces, 1.5, 0.03)
            observation, *_, info = env.step(action)
            # both settle the torque by a square, flat at its least: 1.3e-3 apart has been seen
            assert info["resistance"] == pytest.approx(expected, rel=5e-3, abs=1e-4)
            share = info["resistance"] / (info["resistance"] + 1.0)
            assert info["reward_resistance"] == pytest.approx(WEIGHT * share)


@pytest.mark.parametrize(
    "act",
    [zeros, random_actions(0), lambda observation: np.tile([0.0, 0.0, 1.0], 8)],
    ids=["zeros", "random", "caps"],
)
def test_the_term_is_bounded_and_the_reward_is_the_sum(
    act: Act, make: Callable[..., GraspForceEnv]
) -> None:
    env = weighted(make, announced=False)
    for seed in range(3):
        for _, reward, _, _, info in play(env, seed, act):
            assert 0.0 <= info["reward_resistance"] <= WEIGHT
            assert 0.0 <= info["resistance"] <= LARGEST_MULTIPLE
            terms = [value for name, value in info.items() if name.startswith("reward_")]
            assert reward == pytest.approx(sum(terms), abs=1e-12)
            assert len(terms) == 8


def test_a_real_grasp_that_is_squeezed_resists_more(make: Callable[..., GraspForceEnv]) -> None:
    """Forces of higher preload have more of it, in the mean over grasps."""
    env = weighted(make, mode="static", preload=1.0)
    found = []
    for seed in range(16):  # in the mean over eight they have 1.07 to 2.3 times as much
        observation, _ = env.reset(seed=reseeded(seed))
        once = env.step(oracle(observation))[-1]["resistance"]
        pressed = observation | {"normal_min": 5.0 * observation["normal_min"]}
        env.reset(seed=reseeded(seed))
        found.append((once, env.step(oracle(pressed))[-1]["resistance"]))
    once, more = np.mean(found, axis=0)
    assert more > 1.2 * once > 0.0


def test_zero_where_nothing_balances_or_no_answer_is_found(
    make: Callable[..., GraspForceEnv], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert least_resistance(None, np.zeros(0), disturbances_of(2.0, 0.05), 0.04) == 0.0

    def fails(*arguments: Any, **settings: Any) -> None:
        raise SolverError("Clarabel ended with NumericalError")

    monkeypatch.setattr("gfo_env.mdp.resistance.passive_resistance", fails)
    env = weighted(make, mode="static")
    info = env.step(oracle(env.reset(seed=reseeded(0))[0]))[-1]
    assert info["resistance"] == info["reward_resistance"] == 0.0


def test_bad_weights_are_one_clear_error() -> None:
    with pytest.raises(EnvironmentSettingsError, match="reward_weights are numbers >= 0"):
        GraspForceEnv(reward_weights={"resistance": -1.0})
    with pytest.raises(EnvironmentSettingsError, match="take a push or a twist"):
        GraspForceEnv(reward_weights={"resistance": 1.0}, push=0.0, twist=0.0)
    GraspForceEnv(push=0.0, twist=0.0).close()
