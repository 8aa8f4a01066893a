"""Dual bounds, Farkas certificates and cone projections, against what they promise."""

from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import event, given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from solvers import GraspForceProblem, Multipliers, solve
from solvers.duality import (
    contact_duals,
    dual_bound,
    farkas_value,
    project_cones,
    projection_jacobian,
    usable,
)
from solvers.problem import joint_torques, objective_value
from tests.support.problems import forces_in_cones, random_batch, random_problem, solved_by
from tests.support.seeds import SEEDS, seeded

OBJECTIVES = st.sampled_from(["min_norm", "sum_normal", "min_max_normal"])
VARIANTS = st.sampled_from(
    [
        {},
        {"normal_max": np.inf},
        {"normal_max": np.inf, "torque_min": -np.inf, "torque_max": np.inf},
        {"torque_min": -np.inf},
        {"normal_max": 10.0, "normal_min": 3.0, "torque_max": np.inf},
        {"friction": 0.0},
        {"normal_min": 5.0, "normal_max": 5.0},
    ]
)


def random_multipliers(rng: np.random.Generator, problem: GraspForceProblem) -> Multipliers:
    """Multipliers of any size and sign, some of them zero."""
    scale = 10.0 ** rng.uniform(-3, 3)
    keep = rng.integers(0, 2, problem.n_joints)
    return Multipliers(
        scale * rng.standard_normal(6) * np.repeat([1.0, 30.0], 3),
        scale * 10.0 * rng.standard_normal(problem.n_joints) * keep,
    )


@given(SEEDS, st.integers(3, 6), OBJECTIVES, VARIANTS)
@settings(max_examples=150)
def test_any_multipliers_bound_any_feasible_forces(
    seed: int, count: int, objective: str, variant: dict[str, Any]
) -> None:
    rng = seeded(seed)
    problem = random_problem(rng, count, objective=objective, **variant)
    forces = forces_in_cones(rng, problem)
    problem = solved_by(rng, problem, forces)
    multipliers = random_multipliers(rng, problem)
    bound, value = dual_bound(problem, multipliers), objective_value(problem, forces)
    prices = usable(problem, multipliers)
    torque = joint_torques(problem, forces)
    terms = np.abs(contact_duals(problem, prices).reshape(-1) * forces).sum()
    terms += np.abs(prices.equilibrium * problem.external_wrench).sum()
    terms += np.abs(prices.torque * torque).sum()
    assert bound <= value + 1e-12 * (terms + abs(bound) + value)
    assert farkas_value(problem, multipliers) <= 1e-12


@given(SEEDS, OBJECTIVES, st.sampled_from([np.inf, 30.0]))
@settings(max_examples=40)
def test_bound_is_finite_for_all_multipliers(seed: int, objective: str, cap: float) -> None:
    rng = seeded(seed)
    problem = random_problem(rng, objective=objective, normal_max=cap)
    assert np.isfinite(dual_bound(problem, random_multipliers(rng, problem)))
    nothing = Multipliers(np.zeros(6), np.zeros(problem.n_joints))
    preload = project_cones(problem, np.zeros((problem.n_contacts, 3))).reshape(-1)
    assert dual_bound(problem, nothing) == pytest.approx(objective_value(problem, preload))
    assert farkas_value(problem, nothing) == 0.0


@pytest.mark.parametrize("objective", ["sum_normal", "min_max_normal"])
def test_float32_rounding_does_not_cost_the_whole_linear_bound(objective: str) -> None:
    rng = seeded(0)
    batch = random_batch(rng, 64, objective=objective, normal_max=np.inf)
    nu = torch.tensor(rng.standard_normal((64, 6)) * 100.0, dtype=torch.float32)
    multipliers = Multipliers(nu, torch.zeros(64, 8, dtype=torch.float32))
    bound = dual_bound(batch.to_torch(dtype=torch.float32), multipliers)
    assert bool(torch.isfinite(bound).all())


@given(SEEDS, st.integers(3, 6), VARIANTS)
@settings(max_examples=60)
def test_bound_on_the_largest_normal_force_is_the_least_of_the_lagrangian(
    seed: int, count: int, variant: dict[str, Any]
) -> None:
    """A linear program over t and the normal forces is the oracle; it may be unbounded.

    The bound may be better: that of the same multipliers shrunk until no contact gains by growing.
    """
    rng = seeded(seed)
    problem = random_problem(rng, count, objective="min_max_normal", **variant)
    multipliers = usable(problem, random_multipliers(rng, problem))
    prices = contact_duals(problem, multipliers)
    slope = prices[:, 2] - problem.friction * np.hypot(prices[:, 0], prices[:, 1])
    constant = multipliers.equilibrium @ problem.external_wrench
    price = multipliers.torque
    limit = np.where(price > 0, problem.torque_max, problem.torque_min)
    constant += price[price != 0] @ (problem.external_torque - limit)[price != 0]

    def least(shrink: float) -> float:
        program = linprog(
            np.append(shrink * slope, 1.0),
            A_ub=np.column_stack([np.eye(count), -np.ones(count)]),
            b_ub=np.zeros(count),
            bounds=[*zip(problem.normal_min, problem.normal_max, strict=True), (None, None)],
        )
        return program.fun + shrink * constant if program.status == 0 else -np.inf

    growing = -slope[slope < 0].sum()
    whole, shrunk = least(1.0), least(1.0 / max(1.0, growing) * (1 - 1e-12))
    if whole == -np.inf:
        event("unbounded: the multipliers are shrunk")
    bound = dual_bound(problem, multipliers)
    size = np.abs(constant) + np.abs(slope).sum() * 1e3
    uncapped = -slope[(slope < 0) & np.isinf(problem.normal_max)].sum()
    best = max(whole, shrunk, least(1.0 / max(1.0, uncapped) * (1 - 1e-12)))
    assert bound == pytest.approx(best, abs=1e-8 * size)


@given(SEEDS)
@settings(max_examples=30)
def test_multipliers_of_infinite_limits_are_ignored(seed: int) -> None:
    rng = seeded(seed)
    problem = random_problem(rng, torque_min=-np.inf, normal_max=np.inf)
    multipliers = random_multipliers(rng, problem)
    upper_only = Multipliers(multipliers.equilibrium, np.maximum(multipliers.torque, 0.0))
    assert dual_bound(problem, multipliers) == dual_bound(problem, upper_only)
    assert farkas_value(problem, multipliers) == farkas_value(problem, upper_only)


@given(SEEDS, st.floats(1e-6, 1e6))
@settings(max_examples=30)
def test_farkas_value_has_no_scale(seed: int, factor: float) -> None:
    rng = seeded(seed)
    problem = random_problem(rng)
    multipliers = random_multipliers(rng, problem)
    scaled = Multipliers(factor * multipliers.equilibrium, factor * multipliers.torque)
    value = farkas_value(problem, multipliers)
    assert -1.0 <= value <= 1.0
    assert farkas_value(problem, scaled) == pytest.approx(value, rel=1e-9, abs=1e-12)


@given(SEEDS, VARIANTS)
@settings(max_examples=60)
def test_positive_farkas_value_means_that_there_are_no_forces(
    seed: int, variant: dict[str, Any]
) -> None:
    """The proof against a heavy load, bent a little, is held against lighter ones."""
    rng = seeded(seed)
    problem = random_problem(rng, **variant)
    heavy = problem.replace(external_wrench=100.0 * problem.external_wrench)
    answer = solve(heavy, "clarabel")
    if answer.status != "infeasible":
        event("even the heavy load is feasible")
        return
    bend = 1.0 + rng.choice([0.0, 1e-3, 0.1]) * rng.standard_normal(6)
    proof = Multipliers(answer.equilibrium_dual * bend, answer.torque_dual)
    for share in (0.003, 0.01, 0.03, 0.1, 0.3):
        light = heavy.replace(external_wrench=share * heavy.external_wrench)
        proven = bool(farkas_value(light, proof) > 1e-9)
        status = solve(light, "clarabel").status
        event(f"{status}, proven {proven}")
        if proven:
            assert status == "infeasible"


def test_load_that_friction_cannot_carry_has_a_proof_by_hand() -> None:
    rng = seeded(0)
    problem = random_problem(rng, normal_max=1.0, normal_min=0.0, external_torque=0.0)
    most = (1.0 + problem.friction).sum()
    problem = problem.replace(external_wrench=np.array([2 * most, 0, 0, 0, 0, 0]))
    proof = Multipliers(np.array([1.0, 0, 0, 0, 0, 0]), np.zeros(8))
    assert farkas_value(problem, proof) > 0.3
    against = Multipliers(-proof.equilibrium, proof.torque)
    assert farkas_value(problem, against) < 0.0


def test_uncapped_pull_has_a_proof_although_its_price_is_zero_at_a_contact() -> None:
    # All contacts push up, frictionless; they cannot pull. Three of four feel the price exactly.
    problem = random_problem(seeded(0), normal_max=np.inf, normal_min=0.0)
    grasp_map = np.array(problem.grasp_map)
    grasp_map[2, 2::3] = [0.0, 0.0, 0.0, 1.0]
    grasp_map[2, 0::3] = grasp_map[2, 1::3] = 0.0
    load = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    problem = problem.replace(grasp_map=grasp_map, external_wrench=load)
    exact = Multipliers(load, np.zeros(8))
    assert farkas_value(problem, exact) == 1.0
    rounded = Multipliers(load + np.array([1e-16, 0, 0, 0, 1e-16, 0]), np.zeros(8))
    assert farkas_value(problem, rounded) == pytest.approx(1.0, abs=1e-6)


def points_near(rng: np.random.Generator, count: int) -> np.ndarray:
    scale = 10.0 ** rng.uniform(-2, 2, (count, 1))
    return scale * rng.standard_normal((count, 3)) * rng.integers(0, 2, (count, 3))


@given(SEEDS, VARIANTS)
@settings(max_examples=100)
def test_projection_is_the_nearest_point_of_the_cones(seed: int, variant: dict[str, Any]) -> None:
    rng = seeded(seed)
    problem = random_problem(rng, 4, **variant)
    points = points_near(rng, 4)
    nearest = project_cones(problem, points)
    size = 1e-12 * (1.0 + np.abs(points).max() + problem.normal_min.max())
    # inside
    tangential = np.hypot(nearest[:, 0], nearest[:, 1])
    assert np.all(tangential <= problem.friction * nearest[:, 2] + size)
    assert np.all(nearest[:, 2] >= problem.normal_min)
    assert np.all(nearest[:, 2] <= problem.normal_max)
    # a fixed point
    np.testing.assert_allclose(project_cones(problem, nearest), nearest, atol=size, rtol=0)
    # nearest: the angle to every point of the set is obtuse
    for _ in range(20):
        inside = forces_in_cones(rng, problem).reshape(-1, 3)
        products = ((points - nearest) * (inside - nearest)).sum(axis=-1)
        assert np.all(products <= size * (1.0 + np.abs(inside).max()))
    # nonexpansive
    others = points_near(rng, 4)
    moved = np.linalg.norm(project_cones(problem, others) - nearest, axis=-1)
    assert np.all(moved <= np.linalg.norm(others - points, axis=-1) + size)


def test_points_in_the_cones_stay_and_padding_is_zero() -> None:
    rng = seeded(1)
    problem = random_problem(rng, 4).pad(6)
    forces = forces_in_cones(rng, problem.without_padding()).reshape(-1, 3)
    points = np.vstack([forces, rng.standard_normal((2, 3))])
    nearest = project_cones(problem, points)
    np.testing.assert_allclose(nearest[:4], forces, atol=1e-13)
    np.testing.assert_array_equal(nearest[4:], 0.0)


@given(SEEDS, OBJECTIVES, VARIANTS)
@settings(max_examples=30)
def test_numpy_torch_single_and_padded_agree(
    seed: int, objective: str, variant: dict[str, Any]
) -> None:
    rng = seeded(seed)
    batch = random_batch(rng, 3, objective=objective, **variant)
    each = [random_multipliers(rng, one) for one in batch]
    multipliers = Multipliers(
        np.stack([m.equilibrium for m in each]), np.stack([m.torque for m in each])
    )
    tensors = Multipliers(torch.tensor(multipliers.equilibrium), torch.tensor(multipliers.torque))
    points = rng.standard_normal((3, batch.n_contacts, 3))
    np.testing.assert_allclose(
        project_cones(batch.to_torch(), torch.tensor(points)), project_cones(batch, points)
    )
    for function in (dual_bound, farkas_value):
        together = function(batch, multipliers)
        tolerance = {"rtol": 1e-9, "atol": 1e-9 * (1.0 + np.abs(together).max())}
        np.testing.assert_allclose(function(batch.to_torch(), tensors), together, **tolerance)
        alone = [function(one.without_padding(), m) for one, m in zip(batch, each, strict=True)]
        np.testing.assert_allclose(alone, together, **tolerance)


@pytest.mark.parametrize("objective", ["min_norm", "sum_normal", "min_max_normal"])
@pytest.mark.parametrize("cap", [np.inf, 20.0])
def test_gradients_are_finite_at_zero_prices_and_padding(objective: str, cap: float) -> None:
    batch = random_batch(seeded(5), 8, objective=objective, normal_max=cap)
    tensors = batch.pad(9).to_torch()
    for start in (0.0, 1.0):
        nu = torch.full((8, 6), start, dtype=torch.float64, requires_grad=True)
        price = torch.full((8, 8), start, dtype=torch.float64, requires_grad=True)
        multipliers = Multipliers(nu, price)
        total = dual_bound(tensors, multipliers) + farkas_value(tensors, multipliers)
        total.sum().backward()
        assert nu.grad is not None
        assert price.grad is not None
        assert bool(torch.isfinite(nu.grad).all())
        assert bool(torch.isfinite(price.grad).all())


def test_gradient_of_the_quadratic_bound_is_the_residual() -> None:
    rng = seeded(6)
    problem = random_problem(rng, torque_min=-np.inf, torque_max=np.inf).to_torch()
    nu = torch.tensor(rng.standard_normal(6), requires_grad=True)
    multipliers = Multipliers(nu, torch.zeros(8, dtype=torch.float64))
    dual_bound(problem, multipliers).backward()
    forces = project_cones(problem, -contact_duals(problem, multipliers)).reshape(-1).detach()
    residual = problem.grasp_map @ forces + problem.external_wrench
    np.testing.assert_allclose(nu.grad, residual, rtol=1e-10, atol=1e-12)


@given(SEEDS, VARIANTS)
@settings(max_examples=60)
def test_projection_jacobian_is_that_of_automatic_differentiation(
    seed: int, variant: dict[str, Any]
) -> None:
    rng = seeded(seed)
    problem = random_problem(rng, 5, **variant).pad(6).to_torch()
    points = torch.tensor(10.0 * rng.standard_normal((6, 3)))

    def projected(free: torch.Tensor) -> torch.Tensor:
        return project_cones(problem, free).sum(dim=0)

    # contacts do not mix: the sum over them keeps each one's own derivatives apart
    oracle = torch.autograd.functional.jacobian(projected, points).movedim(1, 0)
    np.testing.assert_allclose(projection_jacobian(problem, points), oracle, atol=1e-12)
