import numpy as np
import pytest
import torch

from solvers import GraspForceProblem, GraspForceSolution, solve
from solvers.arrays import Array
from solvers.duality import (
    contact_duals,
    dual_bound,
    farkas_value,
    project_cones,
    recession_direction,
    relaxed,
)
from solvers.exact.polish import polished
from solvers.judge import judge
from solvers.problem import CanonicalProblem, Multipliers, apply, canonical
from solvers.solution import corrected_forces, is_feasible, shrunk_forces, tightened
from solvers.solution.repair import balanced_forces, violation
from tests.support.problems import random_batch
from tests.support.seeds import seeded


@pytest.fixture(scope="module")
def problem() -> GraspForceProblem:
    return random_batch(seeded(0), 60)


@pytest.fixture(scope="module")
def exact(problem: GraspForceProblem) -> GraspForceSolution:
    answer = solve(problem, "clarabel")
    assert np.mean(answer.status == "optimal") > 0.5
    return answer


@pytest.fixture(scope="module")
def form(problem: GraspForceProblem) -> CanonicalProblem:
    return canonical(problem)


def optimal_multipliers(form: CanonicalProblem, exact: GraspForceSolution) -> Multipliers:
    return form.scaled(Multipliers(exact.equilibrium_dual, exact.torque_dual))


def equilibrium_error(problem: GraspForceProblem, forces: Array) -> Array:
    return np.abs(apply(problem.grasp_map, forces) + problem.external_wrench).max(axis=-1)


def noisy(multipliers: Multipliers, size: float, seed: int = 1) -> Multipliers:
    rng = seeded(seed)

    def disturb(values: Array) -> Array:
        return values * (1.0 + size * rng.standard_normal(values.shape))

    return Multipliers(disturb(multipliers.equilibrium), disturb(multipliers.torque))


def test_canonical_form_keeps_the_dual_bound(
    problem: GraspForceProblem, form: CanonicalProblem
) -> None:
    rng = seeded(2)
    scaled = Multipliers(rng.standard_normal((60, 6)), 0.1 * rng.standard_normal((60, 8)))
    bound = form.scale**2 * dual_bound(form.problem, scaled)
    original = dual_bound(problem, form.multipliers(scaled))
    np.testing.assert_allclose(bound, original, rtol=1e-9, atol=1e-9 * np.abs(bound).max())


def test_canonical_rows_are_orthonormal(form: CanonicalProblem) -> None:
    rows = form.problem.grasp_map
    gram = rows @ np.swapaxes(rows, -1, -2)
    np.testing.assert_allclose(gram, np.broadcast_to(np.eye(6), gram.shape), atol=1e-12)


def test_canonical_form_of_a_single_problem_and_of_tensors(problem: GraspForceProblem) -> None:
    batch, one = canonical(problem), canonical(problem[3])
    tensors = canonical(problem.to_torch())
    for name in ("scale", "joint_scale", "row_scale"):
        np.testing.assert_allclose(getattr(one, name), getattr(batch, name)[3])
        np.testing.assert_allclose(getattr(tensors, name).numpy(), getattr(batch, name))
    np.testing.assert_allclose(one.problem.torque_max, batch.problem.torque_max[3])
    np.testing.assert_allclose(batch[3:5].scale, batch.scale[3:5])


def test_scaled_multipliers_are_the_inverse_of_the_way_back(problem: GraspForceProblem) -> None:
    rng = seeded(0)
    count = len(problem)
    drawn = Multipliers(rng.normal(size=(count, 6)), rng.normal(size=(count, problem.n_joints)))
    form = canonical(problem)
    back = form.scaled(form.multipliers(drawn))
    np.testing.assert_allclose(back.equilibrium, drawn.equilibrium, rtol=1e-9)
    np.testing.assert_allclose(back.torque, drawn.torque, rtol=1e-9)
    one = canonical(problem[3]).scaled(Multipliers(drawn.equilibrium[3], drawn.torque[3]))
    np.testing.assert_allclose(one.equilibrium, form.scaled(drawn).equilibrium[3], rtol=1e-9)
    tensors = Multipliers(torch.as_tensor(drawn.equilibrium), torch.as_tensor(drawn.torque))
    torques = canonical(problem.to_torch()).scaled(tensors).torque
    np.testing.assert_allclose(torques.numpy(), form.scaled(drawn).torque, rtol=1e-12)


def test_optimal_multipliers_give_the_optimal_forces(
    form: CanonicalProblem, exact: GraspForceSolution
) -> None:
    solved = exact.status == "optimal"
    forces = corrected_forces(form.problem, optimal_multipliers(form, exact))
    expected = exact.forces / form.scale[:, None]
    np.testing.assert_allclose(forces[solved], expected[solved], atol=1e-4)


def test_correction_ends_in_exact_equilibrium(
    form: CanonicalProblem, exact: GraspForceSolution
) -> None:
    solved = exact.status == "optimal"
    here = form[solved]
    ratios = []
    for seed in range(10):
        multipliers = noisy(optimal_multipliers(form, exact), 0.01, seed)
        multipliers = Multipliers(multipliers.equilibrium[solved], multipliers.torque[solved])
        forces = corrected_forces(here.problem, multipliers)
        assert equilibrium_error(here.problem, forces).max() < 1e-12
        prices = contact_duals(here.problem, multipliers)
        start = project_cones(here.problem, -prices).reshape(forces.shape)
        orthogonal = balanced_forces(here.problem, start)
        assert equilibrium_error(here.problem, orthogonal).max() < 1e-12
        ratios.append(violation(here.problem, forces) / violation(here.problem, orthogonal))
    # the metric of the projection disturbs the cones less than the shortest correction does, of
    # the same multipliers of the same problem: these medians are 0.33 to 0.54
    assert np.median(ratios) < 0.7


def test_shrink_stops_at_the_boundary(form: CanonicalProblem, exact: GraspForceSolution) -> None:
    inner = tightened(form, 0.05)
    scaled = inner.problem
    interior = solve(scaled, "clarabel")
    rows = np.flatnonzero(interior.status == "optimal")
    assert len(rows) > 20
    here = form[rows].problem
    inside = balanced_forces(here, interior.forces[rows])
    assert np.all(is_feasible(here, inside))
    rng = seeded(3)
    push = 10.0 * rng.standard_normal(inside.shape) * here.contact_mask.repeat(3, axis=-1)
    outside = balanced_forces(here, inside + push)
    beyond = ~is_feasible(here, outside)
    assert beyond.mean() > 0.9
    shrunk = shrunk_forces(here, outside, inside)
    assert np.all(is_feasible(here, shrunk))
    further = shrunk + 1e-6 * (outside - inside)
    assert not np.any(is_feasible(here, further)[beyond])


def test_shrink_leaves_feasible_forces_alone(
    form: CanonicalProblem, exact: GraspForceSolution
) -> None:
    rows = np.flatnonzero(exact.status == "optimal")
    here = tightened(form, 0.01).problem[rows]
    answer = solve(here, "clarabel")
    inside = answer.status == "optimal"
    original = form.problem[rows][inside]
    forces = balanced_forces(original, answer.forces[inside])
    np.testing.assert_array_equal(shrunk_forces(original, forces, 0.9 * forces), forces)


def test_tightened_problems_lie_inside(form: CanonicalProblem) -> None:
    inner = tightened(form, 0.1)
    answer = solve(inner.problem, "clarabel")
    solved = answer.status == "optimal"
    assert solved.any()
    assert np.all(violation(form.problem, answer.forces)[solved] < 0)


def test_newton_steps_never_lower_the_dual_and_reach_the_optimum(
    problem: GraspForceProblem, form: CanonicalProblem, exact: GraspForceSolution
) -> None:
    solved = exact.status == "optimal"
    start = Multipliers(2.0 * form.problem.external_wrench, np.zeros_like(problem.torque_max))
    before = dual_bound(form.problem, start)
    for _ in range(3):
        start = polished(form.problem, start, 1)
        after = dual_bound(form.problem, start)
        assert np.all(after >= before)
        before = after
    # steps rest where all lengths that the line search tries are too long: after a start as rough
    # as this in one of 25 problems
    end = form.scale**2 * dual_bound(form.problem, polished(form.problem, start, 12))
    assert np.mean(np.isclose(end, exact.objective, rtol=1e-7, atol=0.0)[solved]) > 0.8
    # after good multipliers, which they are for, in one of 1000; joints at rest have no price
    best = optimal_multipliers(form, exact)
    used = np.where(np.abs(best.torque) > 1e-6, best.torque, 0.0)
    good = noisy(Multipliers(best.equilibrium, used), 0.01)
    end = form.scale**2 * dual_bound(form.problem, polished(form.problem, good, 15))
    # between Clarabel's bounds, but for rounding
    assert np.mean((end >= exact.dual_bound * (1 - 1e-9))[solved]) > 0.95
    assert np.all((end <= exact.objective * (1 + 1e-9))[solved])


def test_relaxed_multipliers_prove_infeasibility(problem: GraspForceProblem) -> None:
    hard = problem.replace(
        friction=0.2 * problem.friction, normal_max=np.full(problem.friction.shape, np.inf)
    )
    answer = solve(hard, "clarabel")
    none = np.flatnonzero(answer.status == "infeasible")
    assert len(none) > 5
    form = canonical(hard[none])
    wider = relaxed(form, 0.03)
    start = Multipliers(
        2.0 * wider.problem.external_wrench, np.zeros_like(wider.problem.torque_max)
    )
    guess = polished(wider.problem, start, 8)
    proof = form.multipliers(recession_direction(wider.problem, guess))
    proven = farkas_value(hard[none], proof) > 0
    assert proven.mean() > 0.5
    verdict = judge(hard[none], np.full((len(none), 3 * hard.n_contacts), np.nan), proof)
    assert np.all(verdict.status[proven] == "infeasible")
