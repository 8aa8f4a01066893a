"""The compiled interior point: strictly feasible, certified, and equal to the ground truth."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from solvers import GraspForceProblem, GraspForceSolution, Multipliers, SolverError, solve
from solvers.certificates import farkas_value
from solvers.clarabel_ import ClarabelSolver
from solvers.compiled import interior
from solvers.judge import FARKAS_TOLERANCE
from solvers.problem import OBJECTIVES
from solvers.residuals import objective_value
from tests.problems import forces_in_cones, random_batch, random_problem, solved_by
from tests.test_clarabel import (
    UNBOUNDED,
    VARIANTS,
    Change,
    change_force,
    change_length,
    move_origin,
    pad_and_shuffle,
    shuffle_contacts,
    turn_object,
    turn_tangents,
)

SEEDS = st.integers(0, 2**32 - 1)
NO_INTERIOR = {"frictionless", "pinned normal forces"}
"""Variants whose contacts have components that cannot move; few of their problems are feasible."""


def strict(solution: GraspForceSolution, feasible: Any = True) -> bool:
    """Every inequality holds exactly, and equilibrium to rounding, where feasible."""
    verdict = solution.verdict
    size = np.linalg.norm(solution.forces, axis=-1)
    exact = (
        (verdict.friction_violation == 0.0)
        & (verdict.normal_violation == 0.0)
        & (verdict.torque_violation == 0.0)
        & (verdict.equilibrium_residual <= 1e-12 * size)
    )
    return bool(np.all(exact | ~np.asarray(feasible)))


def proven(problem: GraspForceProblem, solution: GraspForceSolution) -> np.ndarray:
    proofs = Multipliers(solution.equilibrium_dual, solution.torque_dual)
    return np.asarray(farkas_value(problem, proofs) > FARKAS_TOLERANCE)


def agrees_with_clarabel(batch: GraspForceProblem, gap: float = 1e-7) -> np.ndarray:
    """(B,) which are feasible; asserts that their optimum is Clarabel's, and proofs for the others.

    Clarabel's forces are taken as it proposes them, before they are moved inside the constraints.
    """
    solution = solve(batch, "interior_point")
    exact = objective_value(batch, ClarabelSolver().propose(batch).forces)
    assert set(solution.status) <= {"optimal", "infeasible"}
    feasible = solution.status == "optimal"
    np.testing.assert_allclose(solution.objective[feasible], exact[feasible], rtol=1e-6, atol=0.0)
    assert np.all(np.abs(solution.gap[feasible]) <= gap)
    assert np.all(proven(batch, solution)[~feasible])
    assert strict(solution, feasible)
    assert np.all(solution.message == "")
    return feasible


@pytest.mark.parametrize("objective", OBJECTIVES)
@pytest.mark.parametrize("variant", sorted(VARIANTS))
def test_it_finds_what_clarabel_finds(variant: str, objective: str) -> None:
    batch = random_batch(np.random.default_rng(11), 60, objective=objective, **VARIANTS[variant])
    feasible = agrees_with_clarabel(batch)
    assert feasible.any()


@pytest.mark.parametrize("objective", OBJECTIVES)
@pytest.mark.parametrize("contacts", [3, 4, 8, 20])
def test_any_number_of_contacts_with_uneven_limits(contacts: int, objective: str) -> None:
    """Each limit is missing, one-sided or weak at random; caps and preloads differ."""
    rng = np.random.default_rng(contacts)
    limit = 10.0 ** rng.uniform(-1.5, 1.0, (2, 40, 8))
    limit[rng.random((2, 40, 8)) < 0.3] = np.inf
    problems = [
        random_problem(
            rng,
            contacts,
            objective=objective,
            torque_min=-lower,
            torque_max=upper,
            normal_min=rng.uniform(0.0, 2.0, contacts) * rng.integers(0, 2, contacts),
            normal_max=rng.choice([5.0, 20.0, np.inf], contacts),
            friction=rng.uniform(0.0, 1.0, contacts) * (rng.random(contacts) < 0.9),
        )
        for lower, upper in zip(*limit, strict=True)
    ]
    feasible = agrees_with_clarabel(GraspForceProblem.stack(problems))
    assert feasible.any()


@given(SEEDS, st.integers(3, 8), st.sampled_from(OBJECTIVES), st.sampled_from(sorted(VARIANTS)))
@settings(max_examples=150)
def test_known_forces_are_never_denied_nor_beaten_by_more_than_the_gap(
    seed: int, count: int, objective: str, variant: str
) -> None:
    """The known forces often lie on the edge of every constraint, so that there is no interior."""
    rng = np.random.default_rng(seed)
    overrides = {k: v for k, v in VARIANTS[variant].items() if k != "contacts"}
    problem = random_problem(rng, count, objective=objective, **overrides)
    forces = forces_in_cones(rng, problem)
    problem = solved_by(rng, problem, forces)
    solution = solve(problem, "interior_point")
    assert solution.status != "infeasible"
    known = {
        "min_norm": 0.5 * forces @ forces,
        "sum_normal": forces[2::3].sum(),
        "min_max_normal": forces[2::3].max(),
    }[objective]
    if solution.message == "":
        assert strict(solution)
        assert solution.objective <= known * (1 + 1e-6) + 1e-9


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
    rng = np.random.default_rng(21)
    for index in range(8):
        problem = random_problem(
            rng, 3 + index % 5, objective=objective, normal_max=20.0, normal_min=0.0
        )
        most = heaviest(problem)
        if most == 0.0:
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
@pytest.mark.parametrize(
    "change",
    [
        turn_object,
        move_origin,
        change_length,
        change_force,
        turn_tangents,
        shuffle_contacts,
        pad_and_shuffle,
    ],
)
@given(seed=SEEDS, count=st.integers(3, 8))
@settings(max_examples=20)
def test_answer_does_not_depend_on_how_the_problem_is_written(
    change: Change, objective: str, seed: int, count: int
) -> None:
    rng = np.random.default_rng(seed)
    problem = random_problem(rng, count, objective=objective)
    moved, value, forces = change(problem, rng)
    before, after = solve(problem, "interior_point"), solve(moved, "interior_point")
    assert after.status == before.status
    if before.status == "optimal":
        linear = objective != "min_norm"
        assert after.objective == pytest.approx(float(value(before.objective, linear)), rel=1e-8)
        if not linear:
            size = np.linalg.norm(after.forces)
            np.testing.assert_allclose(after.forces, forces(before.forces), atol=1e-4 * size)


@pytest.mark.parametrize("objective", OBJECTIVES)
def test_answers_are_the_same_bytes_alone_in_a_batch_and_with_two_threads(objective: str) -> None:
    batch = random_batch(np.random.default_rng(8), 70, objective=objective)
    one = solve(batch, "interior_point")
    two = solve(batch, "interior_point", threads=2)
    many = solve(batch, "interior_point", threads=1000)
    alone = [solve(batch[index], "interior_point") for index in range(10)]
    for name in ("forces", "equilibrium_dual", "torque_dual"):
        whole = getattr(one, name)
        assert whole.tobytes() == getattr(two, name).tobytes() == getattr(many, name).tobytes()
        assert whole[:10].tobytes() == b"".join(getattr(each, name).tobytes() for each in alone)


def test_hand_without_joints() -> None:
    nothing = dict.fromkeys(("torque_min", "torque_max", "external_torque"), np.zeros(0))
    for count in (3, 6):
        problem = random_problem(
            np.random.default_rng(2), count, hand_jacobian=np.zeros((3 * count, 0)), **nothing
        )
        solution, exact = solve(problem, "interior_point"), solve(problem, "clarabel")
        assert solution.status == exact.status
        assert solution.torque_dual.shape == (0,)


@pytest.mark.parametrize("objective", OBJECTIVES)
def test_zero_load_needs_exactly_zero_forces(objective: str) -> None:
    batch = random_batch(
        np.random.default_rng(0),
        3,
        objective=objective,
        external_wrench=np.zeros(6),
        external_torque=0.0,
        normal_min=0.0,
    )
    solution = solve(batch, "interior_point")
    assert np.all(solution.status == "optimal")
    for array in (solution.forces, solution.objective, solution.dual_bound, solution.gap):
        np.testing.assert_array_equal(array, 0.0)


def test_pinned_torques_are_met_to_rounding() -> None:
    problem = random_problem(np.random.default_rng(4), 6, normal_max=np.inf, **UNBOUNDED)
    torque = solve(problem, "interior_point").joint_torques()
    pinned = np.where(np.arange(8) == 1, 1.2 * torque, np.inf)
    low = np.where(np.isfinite(pinned), pinned, -np.inf)
    solution = solve(problem.replace(torque_min=low, torque_max=pinned), "interior_point")
    np.testing.assert_allclose(solution.joint_torques()[1], pinned[1], rtol=1e-9)
    exact = ClarabelSolver().propose_one(problem.replace(torque_min=low, torque_max=pinned)).forces
    assert solution.forces @ solution.forces == pytest.approx(exact @ exact, rel=1e-7)


def test_joint_that_no_contact_moves_can_make_a_problem_infeasible() -> None:
    problem = random_problem(np.random.default_rng(1), 5)
    jacobian = np.array(problem.hand_jacobian)
    jacobian[:, 3] = 0.0
    idle = problem.replace(hand_jacobian=jacobian)
    assert solve(idle, "interior_point").status == "optimal"
    beyond = np.where(np.arange(8) == 3, 5.0, problem.external_torque)
    assert solve(idle.replace(external_torque=beyond), "interior_point").status == "infeasible"


def test_hopeless_numbers_end_as_failed_with_a_message() -> None:
    """Not a number in, which no problem lets through: the kernel ends, and says so."""
    batch = random_batch(np.random.default_rng(0), 3, contacts=5, normal_max=np.inf)
    fields = [
        np.array(getattr(batch, name))
        for name in (
            "grasp_map",
            "hand_jacobian",
            "friction",
            "torque_min",
            "torque_max",
            "external_wrench",
            "external_torque",
            "normal_min",
            "normal_max",
            "contact_mask",
        )
    ]
    for index, array in enumerate(fields[:-1]):
        damaged = [*fields]
        damaged[index] = array.copy()
        damaged[index][1] = np.nan
        code = interior.solve_batch(*damaged, 0)[3]
        assert code[1] == interior.FAILED
        assert code[0] == code[2] == interior.SOLVED
    flat = np.array(fields[0])
    flat[1, 5] = flat[1, 4]
    code = interior.solve_batch(flat, *fields[1:], 0)[3]
    assert code.tolist() == [interior.SOLVED, interior.FAILED, interior.SOLVED]


@pytest.mark.parametrize("threads", [0, -1, 1.5, True, "2"])
def test_threads_must_be_a_positive_whole_number(threads: Any) -> None:
    with pytest.raises(SolverError, match="threads must be a whole number of at least 1"):
        solve(random_problem(np.random.default_rng(0)), "interior_point", threads=threads)


def test_empty_batch_has_an_empty_answer() -> None:
    empty = random_batch(np.random.default_rng(0), 2)[:0]
    for threads in (1, 2):
        solution = solve(empty, "interior_point", threads=threads)
        assert solution.forces.shape == (0, 3 * empty.n_contacts)
