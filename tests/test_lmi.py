"""The linear matrix inequality says what the cones say, and its solver finds the same optimum."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from solvers import GraspForceProblem, solve
from solvers.lmi import linear_matrix_inequality
from solvers.residuals import friction_violation, normal_violation, torque_violation
from tests.problems import forces_in_cones, random_problem, solved_by

SEEDS = st.integers(0, 2**32 - 1)
VARIANTS = st.sampled_from(
    [
        {},
        {"normal_max": np.inf},
        {"torque_min": -np.inf, "torque_max": np.inf},
        {"friction": 0.0},
        {"normal_min": 3.0, "normal_max": 3.0},
    ]
)


def least_eigenvalue(problem: GraspForceProblem, forces: np.ndarray) -> float:
    return float(np.linalg.eigvalsh(linear_matrix_inequality(problem)(forces))[0])


def violation(problem: GraspForceProblem, forces: np.ndarray) -> float:
    """Largest violation of everything that the inequality covers; N or N·m."""
    return max(
        float(measure(problem, forces))
        for measure in (friction_violation, normal_violation, torque_violation)
    )


@given(SEEDS, VARIANTS, st.integers(3, 5))
@settings(max_examples=150)
def test_matrix_is_positive_exactly_where_the_cones_and_bounds_hold(
    seed: int, variant: dict[str, Any], count: int
) -> None:
    rng = np.random.default_rng(seed)
    problem = random_problem(rng, count, **variant)
    inside = forces_in_cones(rng, problem)
    problem = solved_by(rng, problem, inside)
    assert least_eigenvalue(problem, inside) >= -1e-12
    assert violation(problem, inside) <= 1e-12
    for size in (1e-3, 1.0, 30.0):
        forces = inside + size * rng.standard_normal(3 * count) * rng.integers(0, 2, 3 * count)
        excess = violation(problem, forces)
        eigenvalue = least_eigenvalue(problem, forces)
        if excess > 1e-9:
            assert eigenvalue < 0.0
        else:
            assert eigenvalue >= -1e-9


@given(SEEDS)
@settings(max_examples=30)
def test_least_eigenvalue_crosses_zero_at_the_edge(seed: int) -> None:
    """On a ray out of the set, the inequality fails right after the constraints do."""
    rng = np.random.default_rng(seed)
    problem = random_problem(rng, normal_min=1.0, normal_max=20.0)
    start = forces_in_cones(rng, problem)
    problem = solved_by(rng, problem, start)
    direction = rng.standard_normal(12)
    inside, outside = 0.0, 1e3
    for _ in range(60):
        middle = 0.5 * (inside + outside)
        if violation(problem, start + middle * direction) > 0.0:
            outside = middle
        else:
            inside = middle
    beyond = start + (outside + 1e-6) * direction
    assert least_eigenvalue(problem, start + inside * direction) >= -1e-10
    assert least_eigenvalue(problem, beyond) < 0.0


def test_blocks_of_a_small_example_by_hand() -> None:
    problem = random_problem(np.random.default_rng(0), 3)
    jacobian = np.zeros((9, 2))
    jacobian[0, 0], jacobian[8, 1] = 0.1, 0.2
    problem = problem.replace(
        friction=np.array([0.5, 1.0, 0.0]),
        hand_jacobian=jacobian,
        torque_min=np.array([-1.0, -np.inf]),
        torque_max=np.array([2.0, 3.0]),
        external_torque=np.array([0.25, 0.5]),
        normal_min=np.array([1.0, 0.0, 0.0]),
        normal_max=np.array([10.0, np.inf, np.inf]),
    )
    forces = np.array([3.0, 4.0, 8.0, 0.0, -1.0, 2.0, 0.0, 0.0, 5.0])
    inequality = linear_matrix_inequality(problem)
    assert inequality.friction_size == 9
    expected = np.zeros((16, 16))
    expected[:3, :3] = [[4.0, 0.0, 3.0], [0.0, 4.0, 4.0], [3.0, 4.0, 4.0]]
    expected[3:6, 3:6] = [[2.0, 0.0, 0.0], [0.0, 2.0, -1.0], [0.0, -1.0, 2.0]]
    torque = (0.1 * 3.0 + 0.25, 0.2 * 5.0 + 0.5)
    bounds = [torque[0] + 1.0, 2.0 - torque[0], 3.0 - torque[1]]
    bounds += [8.0 - 1.0, 10.0 - 8.0, 2.0, 5.0]
    expected[range(9, 16), range(9, 16)] = bounds
    np.testing.assert_allclose(inequality(forces), expected, atol=1e-15)
    # |f_t| = 5 > mu f_n = 4: the eigenvalues are mu f_n and mu f_n +- |f_t|
    np.testing.assert_allclose(
        np.linalg.eigvalsh(inequality(forces)[:3, :3]), [-1.0, 4.0, 9.0], atol=1e-14
    )


@given(SEEDS)
@settings(max_examples=20)
def test_matrix_is_symmetric_and_affine(seed: int) -> None:
    rng = np.random.default_rng(seed)
    inequality = linear_matrix_inequality(random_problem(rng))
    first, second = rng.standard_normal((2, 12))
    mixed = inequality(0.3 * first + 0.7 * second)
    np.testing.assert_allclose(mixed, 0.3 * inequality(first) + 0.7 * inequality(second), atol=1e-9)
    np.testing.assert_array_equal(mixed, mixed.T)
    np.testing.assert_array_equal(inequality(np.zeros(12)), inequality.constant)
    batch = rng.standard_normal((2, 5, 12))
    np.testing.assert_allclose(inequality(batch)[1, 3], inequality(batch[1, 3]), atol=1e-12)


@pytest.mark.parametrize("objective", ["min_norm", "sum_normal"])
def test_semidefinite_program_has_the_optimum_of_the_cones(objective: str) -> None:
    rng = np.random.default_rng(1)
    solved = 0
    for index in range(24):
        problem = random_problem(rng, 3 + index % 4, objective=objective)
        cones, matrices = solve(problem, "clarabel"), solve(problem, "lmi")
        if cones.status == "infeasible":
            # cvxpy reports infeasibility without multipliers, so there is no proof to check
            assert matrices.status == "failed"
            assert "infeasible" in str(matrices.message)
            assert np.all(np.isnan(matrices.forces))
            continue
        solved += 1
        assert matrices.verdict.equilibrium_residual <= 1e-6 * np.linalg.norm(cones.forces)
        assert matrices.status in ("optimal", "feasible")
        assert matrices.objective == pytest.approx(cones.objective, rel=1e-6)
        if objective == "min_norm":
            error = np.linalg.norm(matrices.forces - cones.forces)
            assert error <= 1e-4 * np.linalg.norm(cones.forces)
    assert solved >= 20


def test_frictionless_contacts_are_solved_too() -> None:
    problem = random_problem(
        np.random.default_rng(3),
        8,
        friction=0.0,
        normal_max=np.inf,
        normal_min=0.0,
        torque_min=-np.inf,
        torque_max=np.inf,
    )
    cones, matrices = solve(problem, "clarabel"), solve(problem, "lmi")
    assert cones.status == "optimal"
    assert matrices.objective == pytest.approx(cones.objective, rel=1e-6)


def test_padding_is_left_out() -> None:
    problem = random_problem(np.random.default_rng(0))
    np.testing.assert_allclose(
        solve(problem.pad(6), "lmi").forces[:12], solve(problem, "lmi").forces
    )
