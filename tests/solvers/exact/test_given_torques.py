"""Joint torques that are given are equations, and an ordinary case for every exact solver."""

import numpy as np
import pytest

from solvers import GraspForceProblem, make_solver, solve
from solvers.judge import EQUILIBRIUM_TOLERANCE
from solvers.problem import OBJECTIVES
from tests.support.given_torques import KINDS, NEARLY, given_torques, settled
from tests.support.seeds import seeded

ACCURACY = 1e-7
"""Relative error of objectives."""

SOLVERS = ("dual_newton", "interior_point", "clarabel", "dual_newton_torch")


def drawn(kind: str, objective: str, count: int = 6) -> list[GraspForceProblem]:
    number = KINDS.index(kind)
    return [given_torques(seeded([53, number, k]), kind, objective) for k in range(count)]


@pytest.mark.parametrize("objective", OBJECTIVES)
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in NEARLY])
def test_statuses_are_those_of_clarabel(kind: str, objective: str) -> None:
    problems = drawn(kind, objective)
    truths = [settled(problem) for problem in problems]
    batch = GraspForceProblem.stack(problems)
    for name in SOLVERS:
        if objective not in make_solver(name).objectives:
            continue
        solution = solve(batch, name)
        for k, truth in enumerate(truths):
            if truth.status:
                assert solution.status[k] == truth.status, (name, k, solution.message[k])
            if truth.status == "optimal":
                np.testing.assert_allclose(
                    solution.objective[k], truth.objective, rtol=ACCURACY, atol=0.0
                )


@pytest.mark.parametrize("objective", OBJECTIVES)
@pytest.mark.parametrize("kind", NEARLY)
def test_equations_that_nearly_depend_are_met(kind: str, objective: str) -> None:
    """Forces are known, so that there are some; the last digits of the optimum are anybody's."""
    solution = solve(GraspForceProblem.stack(drawn(kind, objective, 12)), "dual_newton")
    assert set(solution.status) <= {"optimal", "feasible"}
    assert np.all(solution.gap < 1e-3)


@pytest.mark.parametrize("objective", OBJECTIVES)
def test_given_torques_are_supplied(objective: str) -> None:
    solution = solve(
        GraspForceProblem.stack(drawn("torques of known forces", objective)), "dual_newton"
    )
    problem = solution.problem
    given = problem.torque_min == problem.torque_max
    lever = np.linalg.norm(problem.hand_jacobian, axis=-2).max(axis=-1)
    allowed = EQUILIBRIUM_TOLERANCE * solution.verdict.size * lever
    error = np.abs(solution.joint_torques() - problem.torque_max)
    assert np.all(np.where(given, error, 0.0) <= allowed[:, None])


@pytest.mark.parametrize("objective", OBJECTIVES)
def test_an_equation_that_contradicts_the_others_is_proven_infeasible(objective: str) -> None:
    """One torque twice, with two values: nothing but the equations is needed for the proof."""
    problems = []
    for problem in drawn("two joints alike", objective):
        torque = np.array(problem.torque_min)
        torque[1] += 1e-3
        problems.append(
            problem.replace(
                torque_min=np.where(np.arange(len(torque)) < 2, torque, problem.torque_min),
                torque_max=np.where(np.arange(len(torque)) < 2, torque, problem.torque_max),
            )
        )
    for name in ("dual_newton", "interior_point", "clarabel"):
        assert set(solve(GraspForceProblem.stack(problems), name).status) == {"infeasible"}


def test_a_motorless_joint_keeps_its_contact_from_pressing() -> None:
    """It turns one way only when the contact presses, and nothing else may stop it."""
    problem = given_torques(seeded([54]), "torques of known forces")
    jacobian = np.zeros((3 * problem.n_contacts, 1))
    jacobian[2, 0] = 0.05
    free = problem.replace(
        hand_jacobian=jacobian,
        torque_min=np.array([-np.inf]),
        torque_max=np.array([np.inf]),
        external_torque=np.zeros(1),
        normal_min=np.zeros(problem.n_contacts),
        normal_max=np.full(problem.n_contacts, np.inf),
        friction=np.full(problem.n_contacts, 0.8),
    )
    for objective in OBJECTIVES:
        given = free.replace(torque_min=np.zeros(1), torque_max=np.zeros(1), objective=objective)
        without = free.replace(normal_max=np.array([0.0, *[np.inf] * (free.n_contacts - 1)]))
        one, other = solve(given), solve(without.replace(objective=objective))
        assert one.status == other.status == "optimal"
        assert np.abs(one.forces[:3]).max() <= 1e-9 * np.abs(one.forces).max()
        np.testing.assert_allclose(one.objective, other.objective, rtol=1e-6)
