"""The compiled interior point: strictly feasible, certified, and equal to the ground truth."""

from typing import Any

import numpy as np
import pytest

from solvers import GraspForceProblem, SolverError, solve
from solvers.compiled.interior import batch as interior
from solvers.exact.clarabel_ import ClarabelSolver
from solvers.problem import ARRAY_FIELDS, OBJECTIVES
from tests.support.agreement import agrees_with_clarabel, strict
from tests.support.problems import (
    UNBOUNDED,
    VARIANTS,
    random_batch,
    random_problem,
    uneven_batch,
)
from tests.support.seeds import seeded


@pytest.mark.parametrize("objective", OBJECTIVES)
@pytest.mark.parametrize("variant", sorted(VARIANTS))
def test_it_finds_what_clarabel_finds(variant: str, objective: str) -> None:
    batch = random_batch(seeded(11), 60, objective=objective, **VARIANTS[variant])
    assert np.all(agrees_with_clarabel(batch, "interior_point").message == "")


@pytest.mark.parametrize("objective", OBJECTIVES)
@pytest.mark.parametrize("contacts", [3, 4, 8, 20])
def test_any_number_of_contacts_with_uneven_limits(contacts: int, objective: str) -> None:
    batch = uneven_batch(seeded(contacts), 40, contacts, objective=objective)
    solution = solve(batch, "interior_point")
    # the kernel gives up one in 3000 of these problems, all of them with linear objectives, with
    # forces that keep the constraints, with gaps of up to 37 per cent, and says so
    short = solution.message != ""
    assert np.count_nonzero(short) <= (0 if objective == "min_norm" else 2)
    assert strict(solution, short)
    assert np.all(~short | np.isin(solution.status, ["optimal", "feasible"]))
    assert np.all(agrees_with_clarabel(batch[~short], "interior_point").message == "")


def heaviest(problem: GraspForceProblem) -> float:
    """The largest factor on the load that can be carried, to 1e-5, by bisection with Clarabel."""

    def carried(factor: float) -> bool:
        load = factor * problem.external_wrench
        forces = ClarabelSolver().propose_one(problem.replace(external_wrench=load)).forces
        return not np.isnan(forces).any()

    low, high = 0.0, 1.0
    while carried(high) and high < 1e4:
        low, high = high, 4.0 * high
    while high - low > 1e-5 * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if carried(middle) else (low, middle)
    return low


@pytest.mark.parametrize("objective", OBJECTIVES)
def test_loads_up_to_the_largest_are_carried_and_heavier_ones_proven_too_heavy(
    objective: str,
) -> None:
    rng = seeded(21)
    for index in range(8):
        problem = random_problem(
            rng, 3 + index % 5, objective=objective, normal_max=20.0, normal_min=0.0
        )
        most = heaviest(problem)
        if most < 1e-9:  # forces along this load cannot balance it at all
            continue
        for share in (0.5, 0.9, 0.99, 0.999):
            light = problem.replace(external_wrench=share * most * problem.external_wrench)
            solution = solve(light, "interior_point")
            assert solution.status == "optimal"
            assert strict(solution)
        for share in (1.001, 1.01, 1.1, 2.0):
            heavy = problem.replace(external_wrench=share * most * problem.external_wrench)
            assert solve(heavy, "interior_point").status == "infeasible"


@pytest.mark.parametrize("objective", OBJECTIVES)
def test_answers_are_the_same_bytes_alone_and_in_a_batch(objective: str) -> None:
    batch = random_batch(seeded(8), 70, objective=objective)
    whole = solve(batch, "interior_point")
    alone = [solve(batch[index], "interior_point") for index in range(10)]
    for name in ("forces", "equilibrium_dual", "torque_dual"):
        parts = b"".join(getattr(each, name).tobytes() for each in alone)
        assert getattr(whole, name)[:10].tobytes() == parts


def test_pinned_torques_are_met_to_rounding() -> None:
    problem = random_problem(seeded(4), 6, normal_max=np.inf, **UNBOUNDED)
    torque = solve(problem, "interior_point").joint_torques()
    pinned = np.where(np.arange(8) == 1, 1.2 * torque, np.inf)
    low = np.where(np.isfinite(pinned), pinned, -np.inf)
    solution = solve(problem.replace(torque_min=low, torque_max=pinned), "interior_point")
    np.testing.assert_allclose(solution.joint_torques()[1], pinned[1], rtol=1e-9)
    exact = ClarabelSolver().propose_one(problem.replace(torque_min=low, torque_max=pinned)).forces
    assert solution.forces @ solution.forces == pytest.approx(exact @ exact, rel=1e-7)


def test_joint_that_no_contact_moves_can_make_a_problem_infeasible() -> None:
    problem = random_problem(seeded(1), 5)
    jacobian = np.array(problem.hand_jacobian)
    jacobian[:, 3] = 0.0
    idle = problem.replace(hand_jacobian=jacobian)
    assert solve(idle, "interior_point").status == "optimal"
    beyond = np.where(np.arange(8) == 3, 5.0, problem.external_torque)
    assert solve(idle.replace(external_torque=beyond), "interior_point").status == "infeasible"


def test_hopeless_numbers_end_as_failed_with_a_message() -> None:
    """Not a number in, which no problem lets through: the kernel ends, and says so."""
    batch = random_batch(seeded(0), 3, contacts=5, normal_max=np.inf)
    for name in ARRAY_FIELDS[:-1]:
        damaged = getattr(batch, name).copy()
        damaged[1] = np.nan
        code = interior.solve_batch(batch.derived(**{name: damaged}))[3]
        assert code[1] == interior.FAILED
        assert code[0] == code[2] == interior.SOLVED
    flat = batch.grasp_map.copy()
    flat[1, 5] = flat[1, 4]
    code = interior.solve_batch(batch.derived(grasp_map=flat))[3]
    assert code.tolist() == [interior.SOLVED, interior.FAILED, interior.SOLVED]


@pytest.mark.parametrize("threads", [0, -1, 1.5, True, "2"])
def test_threads_must_be_a_positive_whole_number(threads: Any) -> None:
    with pytest.raises(SolverError, match="threads must be a whole number of at least 1"):
        solve(random_problem(seeded(0)), "interior_point", threads=threads)


@pytest.mark.parametrize("objective", OBJECTIVES)
def test_friction_of_all_sizes_at_once(objective: str) -> None:
    """Oil and glue on one object: nothing stays unsettled, and optima are Clarabel's."""
    sizes = np.array([0.0, 1e-8, 0.3, 1.0, 1e3])
    problems = []
    for k in range(60):
        rng = seeded([59, k])
        contacts = int(rng.integers(3, 9))
        cap = rng.choice([20.0, np.inf])
        friction = rng.choice(sizes, contacts)
        problems.append(
            random_problem(
                rng, contacts, objective=objective, friction=friction, normal_max=float(cap)
            )
        )
    solution = solve(GraspForceProblem.stack(problems))
    assert set(solution.status) == {"optimal", "infeasible"}
    assert np.all(np.abs(solution.gap[solution.status == "optimal"]) <= 1e-6)
