"""The ground truth: optimal, proven, and indifferent to frames, units, order and padding."""

import cvxpy as cp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from solvers import GraspForceProblem, GraspForceSolution, SolverError, solve
from solvers.duality import contact_duals, farkas_value, project_cones
from solvers.problem import OBJECTIVES, Multipliers, joint_torques
from tests.support.problems import (
    UNBOUNDED,
    VARIANTS,
    random_batch,
    random_problem,
    skew,
)
from tests.support.seeds import SEEDS, seeded


def optimal(solution: GraspForceSolution) -> bool:
    return bool(np.all(solution.status == "optimal"))


@pytest.mark.parametrize("objective", OBJECTIVES)
@pytest.mark.parametrize("variant", VARIANTS)
def test_every_problem_is_solved_or_proven_infeasible(variant: str, objective: str) -> None:
    batch = random_batch(seeded(11), 60, objective=objective, **VARIANTS[variant])
    solution = solve(batch, "clarabel")
    infeasible, solved = solution.status == "infeasible", solution.status == "optimal"
    # it ended one of 60,000 with `AlmostSolved`
    assert np.count_nonzero(~infeasible & ~solved) <= 1
    assert not infeasible.all()
    # close to the edge, where multipliers are ten thousand times as large, it ends at 3e-7
    assert np.all(np.abs(solution.gap[solved]) < 1e-6)
    assert np.median(np.abs(solution.gap[solved])) < 3e-8
    proofs = Multipliers(solution.equilibrium_dual, solution.torque_dual)
    assert np.all(farkas_value(batch, proofs)[infeasible] > 1e-9)
    assert np.all(np.isnan(solution.gap[infeasible]))
    real = np.repeat(batch.contact_mask, 3, axis=-1)
    assert np.all(np.isnan(solution.forces[infeasible][real[infeasible]]))
    assert np.all(solution.forces[~real] == 0.0)


def socp(problem: GraspForceProblem) -> tuple[float | None, np.ndarray]:
    """The same optimum by another model: cvxpy, N and N·m as they are."""
    n = problem.n_contacts
    force = cp.Variable((n, 3))
    flat = cp.vec(force, order="C")
    torque = problem.hand_jacobian.T @ flat + problem.external_torque
    constraints = [problem.grasp_map @ flat == -problem.external_wrench]
    for i in range(n):
        constraints.append(cp.SOC(problem.friction[i] * force[i, 2], force[i, :2]))
        constraints.append(force[i, 2] >= problem.normal_min[i])
        if np.isfinite(problem.normal_max[i]):
            constraints.append(force[i, 2] <= problem.normal_max[i])
    upper, lower = np.isfinite(problem.torque_max), np.isfinite(problem.torque_min)
    if upper.any():
        constraints.append(torque[upper] <= problem.torque_max[upper])
    if lower.any():
        constraints.append(torque[lower] >= problem.torque_min[lower])
    goals = {
        "min_norm": 0.5 * cp.sum_squares(force),
        "sum_normal": cp.sum(force[:, 2]),
        "min_max_normal": cp.max(force[:, 2]),
    }
    model = cp.Problem(cp.Minimize(goals[problem.objective]), constraints)
    accuracy = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), 1e-11)
    model.solve(solver=cp.CLARABEL, **accuracy)
    if model.status not in ("optimal", "optimal_inaccurate"):
        return None, np.empty(0)
    return float(model.value), force.value.reshape(-1)


@pytest.mark.filterwarnings("ignore:Solution may be inaccurate:UserWarning")
@pytest.mark.parametrize("objective", OBJECTIVES)
def test_optimum_is_that_of_an_independent_model(objective: str) -> None:
    rng = seeded(5)
    for index in range(25):
        problem = random_problem(rng, 3 + index % 4, objective=objective)
        value, forces = socp(problem)
        solution = solve(problem, "clarabel")
        if value is None:
            assert solution.status == "infeasible"
            continue
        assert solution.objective == pytest.approx(value, rel=1e-7)
        if objective == "min_norm":
            size = np.linalg.norm(forces)
            # two optima known to 1e-10 fix the forces to sqrt(2e-10) of their size each
            np.testing.assert_allclose(solution.forces, forces, atol=3e-5 * size)


@given(SEEDS, st.integers(3, 6))
@settings(max_examples=40)
def test_forces_and_multipliers_satisfy_the_optimality_conditions(seed: int, count: int) -> None:
    """f is the projection of -(G' nu + J lambda), and only active torque limits have a price."""
    rng = seeded(seed)
    problem = random_problem(rng, count, torque_max=0.3, torque_min=-0.3)
    solution = solve(problem, "clarabel")
    if solution.status != "optimal":
        return
    prices = Multipliers(solution.equilibrium_dual, solution.torque_dual)
    projected = project_cones(problem, -contact_duals(problem, prices)).reshape(-1)
    size = np.linalg.norm(solution.forces)
    np.testing.assert_allclose(solution.forces, projected, atol=5e-4 * size)
    torque = joint_torques(problem, solution.forces)
    room = np.where(
        solution.torque_dual > 0, problem.torque_max - torque, torque - problem.torque_min
    )
    assert np.abs(solution.torque_dual * room).max() <= 1e-8 * size**2


def test_load_beyond_the_torque_limits_is_proven_by_them() -> None:
    rng = seeded(3)
    free = random_problem(rng, 5, normal_max=np.inf, **UNBOUNDED)
    assert optimal(solve(free))
    largest = np.abs(joint_torques(free, solve(free).forces)).max()
    tight = free.replace(torque_max=np.full(8, 1e-3 * largest), torque_min=np.full(8, -np.inf))
    tight = tight.replace(torque_min=-tight.torque_max, external_torque=np.zeros(8))
    answer = solve(tight)
    assert answer.status == "infeasible"
    assert np.any(answer.torque_dual != 0.0)
    without = Multipliers(answer.equilibrium_dual, np.zeros(8))
    assert farkas_value(tight, without) <= 0.0


def test_pinched_pair_cannot_resist_torque_about_its_line() -> None:
    """Two antipodal contacts and a third on the same line's side: no force closure, no caps.

    Squeezing the pair costs nothing, so the price of the pair is exactly zero: an exact proof has
    no margin at two contacts.
    """
    x, z = np.eye(3)[0], np.eye(3)[2]
    places = ((-0.03 * x, x), (0.03 * x, -x), (np.array([0.0, 0.02, 0.01]), -z))
    columns = []
    for position, normal in places:
        tangent = np.cross(normal, [0.3, 0.8, 0.5])
        tangent /= np.linalg.norm(tangent)
        frame = np.column_stack([tangent, np.cross(normal, tangent), normal])
        columns.append(np.vstack([frame, skew(position) @ frame]))
    for objective in OBJECTIVES:
        for sign, status in ((1.0, "infeasible"), (-1.0, "optimal")):
            problem = GraspForceProblem(
                grasp_map=np.hstack(columns),
                hand_jacobian=np.zeros((9, 1)),
                friction=np.array([0.5, 0.5, 0.0]),
                torque_min=np.full(1, -np.inf),
                torque_max=np.full(1, np.inf),
                external_wrench=np.array([0, 0, 0, -sign * 0.02, 0, 0]),
                objective=objective,
            )
            assert solve(problem).status == status


def test_pinned_torques_are_met_exactly() -> None:
    rng = seeded(4)
    problem = random_problem(rng, 6, normal_max=np.inf, **UNBOUNDED)
    torque = joint_torques(problem, solve(problem).forces)
    pinned = np.where(np.arange(8) == 1, 1.2 * torque, np.inf)
    low = np.where(np.isfinite(pinned), pinned, -np.inf)
    solution = solve(problem.replace(torque_min=low, torque_max=pinned))
    assert solution.status == "optimal"
    np.testing.assert_allclose(solution.joint_torques()[1], pinned[1], rtol=1e-7)


@pytest.mark.parametrize("tolerance", [0.0, -1e-6, 1.0, np.nan])
def test_tolerance_must_make_sense(tolerance: float) -> None:
    with pytest.raises(SolverError, match="tolerance must lie between 0 and 1"):
        solve(random_problem(seeded(0)), "clarabel", tolerance=tolerance)


def test_loose_tolerance_is_seen_by_the_judge() -> None:
    batch = random_batch(seeded(9), 20)
    loose = solve(batch, "clarabel", tolerance=1e-2)
    exact = solve(batch, "clarabel")
    np.testing.assert_array_equal(loose.status == "infeasible", exact.status == "infeasible")
    assert np.sum(loose.status == "optimal") < np.sum(exact.status == "optimal")
