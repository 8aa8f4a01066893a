"""The judge: it refuses whatever is wrong, and only that."""

from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from solvers import (
    Candidate,
    GraspForceProblem,
    GraspForceSolution,
    Multipliers,
    Status,
    judge,
    solve,
)
from solvers.duality import dual_bound, farkas_value
from solvers.judge import EQUILIBRIUM_TOLERANCE, FARKAS_TOLERANCE, GAP_TOLERANCE, LARGEST_NUMBER
from solvers.problem import force_scale, least_force, residuals
from solvers.solution import judge_candidate
from tests.support.problems import forces_in_cones, random_batch, random_problem, solved_by
from tests.support.seeds import SEEDS, seeded

OBJECTIVES = ["min_norm", "sum_normal", "min_max_normal"]


def optimum(problem: GraspForceProblem) -> tuple[np.ndarray, Multipliers]:
    solution = solve(problem)
    assert np.all(solution.status == "optimal")
    return solution.forces, Multipliers(solution.equilibrium_dual, solution.torque_dual)


def feasible_problem(seed: int, **overrides: Any) -> tuple[GraspForceProblem, np.ndarray]:
    rng = seeded(seed)
    problem = random_problem(rng, **overrides)
    forces = forces_in_cones(rng, problem)
    return solved_by(rng, problem, forces), forces


def infeasible_problem(seed: int = 0) -> tuple[GraspForceProblem, Multipliers]:
    problem = random_problem(seeded(seed), normal_max=1.0, normal_min=0.0)
    problem = problem.replace(external_wrench=np.array([50.0, 20.0, 0, 0, 0.1, 0]))
    solution = solve(problem, "clarabel")
    assert solution.status == "infeasible"
    return problem, Multipliers(solution.equilibrium_dual, solution.torque_dual)


NOTHING = Multipliers(np.zeros(6), np.zeros(8))


@given(SEEDS, st.sampled_from(OBJECTIVES))
@settings(max_examples=50)
def test_feasible_forces_are_feasible_and_zero_multipliers_prove_no_optimum(
    seed: int, objective: str
) -> None:
    problem, forces = feasible_problem(seed, objective=objective)
    verdict = judge(problem, forces, NOTHING)
    # zero multipliers say that the preload must be paid, and no more
    least = 0.5 * (problem.normal_min**2).sum()
    floors = {"sum_normal": problem.normal_min.sum(), "min_max_normal": problem.normal_min.max()}
    least = floors.get(objective, least)
    assert verdict.dual_bound == pytest.approx(least)
    excess = verdict.objective - least
    assert verdict.gap * verdict.objective == pytest.approx(excess, abs=1e-9)
    assert verdict.status == ("optimal" if verdict.gap <= GAP_TOLERANCE else "feasible")


@pytest.mark.parametrize("objective", OBJECTIVES)
@pytest.mark.parametrize("constraint", ["equilibrium", "friction", "preload", "cap", "torque"])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_violation_of_one_constraint_is_refused(
    objective: str, constraint: str, sign: float
) -> None:
    """Each constraint is overstepped by a share of the forces: one that rounding makes, or more."""
    problem, forces = feasible_problem(3, objective=objective, normal_min=2.0, normal_max=20.0)
    size = max(float(force_scale(problem)), float(np.linalg.norm(forces)))
    torque = problem.hand_jacobian.T @ forces + problem.external_torque
    terms = abs(problem.hand_jacobian).T @ abs(forces) + abs(problem.external_torque)
    tangential = np.linalg.norm(forces.reshape(-1, 3)[:, :2], axis=-1)
    contact = int(np.argmax(tangential / problem.friction))
    one = np.eye(4)[contact]

    def at_violation(relative: float) -> GraspForceProblem:
        step = relative * size
        if constraint == "equilibrium":
            wrench = problem.grasp_map @ np.full(12, sign / np.sqrt(12))
            wrench *= step / np.linalg.norm(least_force(problem, wrench))
            return problem.replace(external_wrench=problem.external_wrench + wrench)
        if constraint == "friction":
            ratio = (tangential[contact] - step) / forces[3 * contact + 2]
            return problem.replace(friction=np.where(one > 0, ratio, problem.friction))
        if constraint == "preload":
            least = np.where(one > 0, forces[2::3] + step, problem.normal_min)
            return problem.replace(normal_min=least, normal_max=np.maximum(least, 30.0))
        if constraint == "cap":
            most = np.where(one > 0, forces[2::3] - step, problem.normal_max)
            return problem.replace(normal_max=most, normal_min=np.minimum(most, 0.0 * one))
        # relative to what the sum adds up: the rest of the forces does not move this joint
        limit = np.where(np.arange(8) == 2, torque - sign * relative * terms, sign * np.inf)
        name, other = ("torque_max", "torque_min") if sign > 0 else ("torque_min", "torque_max")
        return problem.replace(**{name: limit, other: np.full(8, -sign * np.inf)})

    # a preload on the largest normal force makes it the best there is
    assert judge(at_violation(1e-16), forces, NOTHING).status in ("feasible", "optimal")
    for share in (1e-6, 1e-9, 1e-11, 1e-13):
        if share < EQUILIBRIUM_TOLERANCE and constraint == "equilibrium":
            continue
        refused = judge(at_violation(share), forces, NOTHING)
        assert refused.status == "failed"
        assert np.isnan(refused.objective)
        assert np.isnan(refused.gap)


@pytest.mark.parametrize("objective", OBJECTIVES)
@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf, 1e200, 10 * LARGEST_NUMBER])
def test_numbers_that_are_no_answer(objective: str, number: float) -> None:
    # without preloads, which would prove without any multipliers that some forces are the least
    problem, _ = feasible_problem(1, objective=objective, normal_min=0.0)
    forces, multipliers = optimum(problem)
    wrong = np.where(np.arange(12) == 5, number, forces)
    verdict = judge(problem, wrong, multipliers)
    assert verdict.status == "failed"
    assert np.isnan(verdict.equilibrium_residual)
    assert np.isnan(verdict.torque_violation)
    price = Multipliers(np.where(np.arange(6) == 1, number, multipliers.equilibrium), np.zeros(8))
    assert judge(problem, forces, price).status == "feasible"
    price = Multipliers(multipliers.equilibrium, np.full(8, number))
    assert judge(problem, forces, price).status == "feasible"
    impossible, proof = infeasible_problem()
    price = Multipliers(np.full(6, number), proof.torque)
    assert judge(impossible, wrong, price).status == "failed"


@given(SEEDS, st.sampled_from(OBJECTIVES), st.floats(0.01, 10.0))
@settings(max_examples=40)
def test_wrong_multipliers_never_make_a_worse_answer_optimal(
    seed: int, objective: str, strength: float
) -> None:
    problem, worse = feasible_problem(seed, objective=objective, normal_max=np.inf)
    forces, multipliers = optimum(problem)
    best = judge(problem, forces, multipliers)
    assert best.status == "optimal"
    rng = seeded(seed)
    wrong = Multipliers(
        multipliers.equilibrium * (1 + strength * rng.standard_normal(6)),
        multipliers.torque + strength * rng.standard_normal(8),
    )
    for prices in (multipliers, wrong, NOTHING):
        verdict = judge(problem, worse, prices)
        true_loss = 1.0 - best.objective / verdict.objective if verdict.objective > 0 else 0.0
        assert verdict.status in ("optimal", "feasible")
        assert verdict.gap >= true_loss - 1e-6
        if true_loss > 2 * GAP_TOLERANCE:
            assert verdict.status == "feasible"


def test_proof_is_accepted_perturbed_a_little_and_refused_when_wrong() -> None:
    problem, proof = infeasible_problem()
    nan = np.full(12, np.nan)
    verdict = judge(problem, nan, proof)
    assert verdict.status == "infeasible"
    assert verdict.farkas_value > FARKAS_TOLERANCE
    near = Multipliers(proof.equilibrium * (1 + 1e-9), proof.torque)
    assert judge(problem, nan, near).status == "infeasible"
    load = problem.external_wrench / np.linalg.norm(problem.external_wrench)
    without_load = proof.equilibrium - load * (load @ proof.equilibrium)
    for wrong in (
        Multipliers(-proof.equilibrium, -proof.torque),
        Multipliers(without_load, np.zeros(8)),
        NOTHING,
    ):
        assert judge(problem, nan, wrong).status == "failed"
    lighter = problem.replace(external_wrench=problem.external_wrench * 1e-3)
    assert judge(lighter, nan, proof).status == "failed"


def test_proof_without_margin_is_refused() -> None:
    # a cap that just carries the load: the price of the load then proves exactly nothing
    problem = random_problem(seeded(0), normal_min=0.0, normal_max=1.0)
    nu = np.array([1.0, 0, 0, 0, 0, 0])
    prices = (problem.grasp_map.T @ nu).reshape(-1, 3)
    least = prices[:, 2] - problem.friction * np.hypot(prices[:, 0], prices[:, 1])
    limit = -np.minimum(least, 0.0).sum()
    for excess, status in ((1e-7, "infeasible"), (1e-10, "failed"), (-1e-7, "failed")):
        edge = problem.replace(external_wrench=nu * limit * (1 + excess))
        verdict = judge(edge, np.full(12, np.nan), Multipliers(nu, np.zeros(8)))
        assert verdict.status == status


def test_feasible_forces_outrank_any_claim_of_infeasibility() -> None:
    problem, forces = feasible_problem(4)
    _, proof = infeasible_problem()
    assert judge(problem, forces, proof).status in ("feasible", "optimal")


@pytest.mark.parametrize("objective", OBJECTIVES)
def test_forces_at_padding_neither_pay_nor_excuse(objective: str) -> None:
    problem, _ = feasible_problem(1, objective=objective)
    forces, multipliers = optimum(problem)
    padded = problem.pad(5)
    for extra in (np.array([0.0, 0.0, -1e3]), np.array([1e9, 0.0, 1e9])):
        same = judge(padded, np.concatenate([forces, extra]), multipliers)
        assert same.objective == judge(problem, forces, multipliers).objective
        off = judge(padded, np.concatenate([forces * (1 + 1e-5), extra]), multipliers)
        assert off.status == "failed"


@pytest.mark.parametrize("objective", OBJECTIVES)
def test_gap_tolerance_separates_optimal_from_feasible(objective: str) -> None:
    problem = random_problem(
        seeded(0),
        objective=objective,
        normal_max=np.inf,
        torque_max=np.inf,
        torque_min=-np.inf,
    )
    forces, multipliers = optimum(problem)
    squeeze = solve(problem.replace(normal_min=np.full(4, 3.0)), "clarabel").forces
    gaps = []
    for share in (0.0, 1e-8, 1e-3, 0.5, 1.0):
        mixed = judge(problem, (1 - share) * forces + share * squeeze, multipliers)
        gaps.append(float(mixed.gap))
        assert mixed.status == ("optimal" if abs(mixed.gap) <= GAP_TOLERANCE else "feasible")
    assert gaps == sorted(gaps)
    assert gaps[0] < 1e-8
    assert gaps[-1] > 1e-2


def test_objective_far_below_its_bound_is_not_optimal() -> None:
    """Forces that use the tolerance where the price of it is huge are feasible at best."""
    problem, _ = feasible_problem(1)
    forces, multipliers = optimum(problem)
    overpriced = problem.replace(external_wrench=problem.external_wrench * (1 + 1e-13))
    lifted = Multipliers(1e5 * multipliers.equilibrium, multipliers.torque)
    verdict = judge(overpriced, forces, lifted)
    assert verdict.status == "feasible"


def test_zero_forces_for_no_load_are_optimal_with_gap_zero() -> None:
    for objective in OBJECTIVES:
        problem = random_problem(
            seeded(0),
            objective=objective,
            external_wrench=np.zeros(6),
            external_torque=0.0,
            normal_min=0.0,
        )
        verdict = judge(problem, np.zeros(12), NOTHING)
        assert (verdict.status, verdict.gap, verdict.objective) == ("optimal", 0.0, 0.0)
        noise = forces_in_cones(seeded(1), problem)
        noise *= 1e-13 / np.linalg.norm(noise)
        assert judge(problem, noise, NOTHING).status in ("feasible", "optimal")
        assert judge(problem, np.tile([0.0, 0.0, 1e-3], 4), NOTHING).status == "failed"


def test_no_limit_at_any_joint_and_no_joint_at_all() -> None:
    for joints in (0, 3):
        problem = random_problem(
            seeded(2),
            hand_jacobian=np.ones((12, joints)),
            external_torque=np.zeros(joints),
            torque_min=np.full(joints, -np.inf),
            torque_max=np.full(joints, np.inf),
            normal_max=np.inf,
        )
        forces, multipliers = optimum(problem)
        verdict = judge(problem, forces, multipliers)
        assert verdict.torque_violation == 0.0
        assert verdict.status == "optimal"


@given(SEEDS, st.sampled_from([1e-6, 1e-3, 1e3, 1e6]), st.sampled_from(OBJECTIVES))
@settings(max_examples=20)
def test_verdicts_do_not_depend_on_units(seed: int, unit: float, objective: str) -> None:
    problem, worse = feasible_problem(seed, objective=objective)
    forces, multipliers = optimum(problem)
    lengths = np.repeat([1.0, unit], 3)
    torques = ("torque_min", "torque_max", "external_torque")
    in_other_lengths = problem.replace(
        grasp_map=lengths[:, None] * problem.grasp_map,
        external_wrench=lengths * problem.external_wrench,
        hand_jacobian=unit * problem.hand_jacobian,
        **{name: unit * getattr(problem, name) for name in torques},
    )
    names = ("external_wrench", "normal_min", "normal_max", *torques)
    in_other_forces = problem.replace(**{name: unit * getattr(problem, name) for name in names})
    price = unit if objective == "min_norm" else 1.0
    longer = Multipliers(multipliers.equilibrium / lengths, multipliers.torque / unit)
    stronger = Multipliers(price * multipliers.equilibrium, price * multipliers.torque)
    for answer in (forces, worse, worse * (1 + 1e-5), worse + 1e-9 * forces):
        here = judge(problem, answer, multipliers)
        assert judge(in_other_lengths, answer, longer).status == here.status
        assert judge(in_other_forces, unit * answer, stronger).status == here.status


def test_batch_is_judged_like_its_members() -> None:
    rng = seeded(7)
    batch = random_batch(rng, 6).reshape(2, 3)
    solution = solve(batch)
    forces = solution.forces * np.array([1.0, 1.0 + 1e-5, np.nan])[:, None]
    prices = Multipliers(solution.equilibrium_dual, solution.torque_dual)
    together = judge(batch, forces, prices)
    assert together.status.shape == (2, 3)
    for index in np.ndindex(2, 3):
        one = Multipliers(prices.equilibrium[index], prices.torque[index])
        alone = judge(batch[index], forces[index], one)
        for name in ("status", "gap", "dual_bound", "farkas_value", "torque_violation"):
            np.testing.assert_array_equal(
                getattr(together, name)[index], getattr(alone, name), err_msg=name
            )


def test_status_compares_with_strings_and_enum() -> None:
    problem, forces = feasible_problem(0)
    status = judge(problem, forces, NOTHING).status
    assert status == Status.FEASIBLE
    assert status == "feasible"
    assert {s.value for s in Status} == {"optimal", "feasible", "infeasible", "failed"}


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_torch_problem_gives_a_torch_solution(dtype: torch.dtype) -> None:
    tensors = random_problem(seeded(2), 5).to_torch(dtype=dtype)
    tensors = tensors.replace(friction=tensors.friction.clone().requires_grad_())
    solution = solve(tensors)
    exact = solve(tensors.to_numpy())
    assert solution.status == exact.status == "optimal"
    for name in ("forces", "objective", "dual_bound", "gap", "equilibrium_dual", "torque_dual"):
        value = getattr(solution, name)
        assert isinstance(value, torch.Tensor)
        assert value.dtype == dtype
        np.testing.assert_allclose(value, getattr(exact, name), rtol=1e-6, atol=1e-9)
    # decided in float64, however the forces are returned
    assert solution.verdict.status == "optimal"
    assert solution.verdict.equilibrium_residual == exact.verdict.equilibrium_residual
    for method in ("equilibrium_residual", "friction_violation", "normal_violation"):
        measured = getattr(solution, method)()
        assert isinstance(measured, torch.Tensor)
        assert float(measured.detach()) <= 1e-5
    assert float(solution.torque_violation().detach()) <= 1e-5
    torque = solution.joint_torques()
    np.testing.assert_allclose(torque.detach(), exact.joint_torques(), rtol=1e-4, atol=1e-5)


def test_solution_measures_itself_like_the_judge() -> None:
    problem, forces = feasible_problem(5)
    candidate = Candidate(forces * 1.001, NOTHING, np.array("by hand"))
    verdict = judge_candidate(problem.flat(), candidate)
    solution = GraspForceSolution.packed(problem, candidate, verdict)
    assert (solution.status, solution.message) == ("failed", "by hand")
    assert solution.equilibrium_residual() == pytest.approx(
        solution.verdict.equilibrium_residual, rel=1e-9
    )
    assert solution.equilibrium_residual() == pytest.approx(
        1e-3 * np.linalg.norm(least_force(problem, problem.external_wrench))
    )
    assert solution.equilibrium_residual() > EQUILIBRIUM_TOLERANCE * np.linalg.norm(forces)


@given(SEEDS, st.sampled_from(OBJECTIVES), st.sampled_from([0.0, 1e-9, 0.1, 10.0]))
@settings(max_examples=60, deadline=None)
def test_measurements_are_those_of_the_definitions(
    seed: int, objective: str, spread: float
) -> None:
    """The judge's compiled code against the formulas for arrays, which others use."""
    rng = seeded(seed)
    batch = random_batch(rng, 4, objective=objective)
    forces = rng.standard_normal((4, 3 * batch.n_contacts)) * spread
    forces = np.where(np.repeat(batch.contact_mask, 3, axis=-1), forces, 0.0)
    prices = Multipliers(
        rng.standard_normal((4, 6)),
        rng.standard_normal((4, 8)) * rng.integers(0, 2, (4, 8)),
    )
    verdict = judge(batch, forces, prices)
    for name in (
        "equilibrium_residual",
        "friction_violation",
        "normal_violation",
        "torque_violation",
    ):
        expected = getattr(residuals, name)(batch, forces)
        np.testing.assert_allclose(getattr(verdict, name), expected, rtol=1e-9, atol=1e-12)
    bound = dual_bound(batch, prices)
    np.testing.assert_allclose(verdict.dual_bound, bound, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(verdict.farkas_value, farkas_value(batch, prices), atol=1e-9)
    size = np.maximum(force_scale(batch), np.linalg.norm(forces, axis=-1))
    np.testing.assert_allclose(verdict.size, size, rtol=1e-9)


def test_torque_limits_that_coincide_are_an_equation() -> None:
    """No sum of products meets a number exactly; a limit that is missed by more is refused."""
    problem, forces = feasible_problem(4)
    torque = problem.hand_jacobian.T @ forces + problem.external_torque
    pinned = problem.replace(torque_min=torque, torque_max=torque)
    assert judge(pinned, forces, NOTHING).status in ("feasible", "optimal")
    size = np.linalg.norm(forces) * np.linalg.norm(problem.hand_jacobian, axis=0).max()
    for share, status in ((1e-13, "feasible"), (1e-11, "failed"), (-1e-11, "failed")):
        other = torque + share * size
        moved = pinned.replace(torque_min=other, torque_max=other)
        assert judge(moved, forces, NOTHING).status == status


def test_empty_batch_has_an_empty_verdict() -> None:
    batch = random_batch(seeded(0), 3)[:0]
    nothing = Multipliers(np.zeros((0, 6)), np.zeros((0, 8)))
    verdict = judge(batch, np.zeros((0, 3 * batch.n_contacts)), nothing)
    assert verdict.status.shape == verdict.gap.shape == (0,)


@given(SEEDS, st.floats(0.0, 15.0))
@settings(max_examples=60)
def test_squeezing_carries_nothing(seed: int, digits: float) -> None:
    """Internal forces of any size answer no load, not even within rounding of their sum."""
    problem = random_problem(
        seeded(seed), normal_max=np.inf, normal_min=0.0, torque_min=-np.inf, torque_max=np.inf
    )
    loads = problem.external_wrench
    internal = solve(
        problem.replace(external_wrench=np.zeros(6), normal_min=np.ones(problem.n_contacts))
    )
    assume(internal.status == "optimal")
    squeeze = 10.0**digits * internal.forces / np.linalg.norm(internal.forces)
    unloaded = problem.replace(external_wrench=np.zeros(6), normal_min=np.zeros(problem.n_contacts))
    for share in (1.0, 1e-3, 1e-5):
        loaded = unloaded.replace(external_wrench=share * loads)
        assert judge(loaded, squeeze, NOTHING).status == "failed"


@given(SEEDS, st.floats(-3.0, 12.0))
@settings(max_examples=40)
def test_a_proof_decides_whatever_the_forces(seed: int, digits: float) -> None:
    problem, proof = infeasible_problem(seed % 5)
    forces = 10.0**digits * seeded(seed).standard_normal(3 * problem.n_contacts)
    for given_forces in (
        forces,
        np.zeros_like(forces),
        least_force(problem, -problem.external_wrench),
    ):
        verdict = judge(problem, given_forces, proof)
        assert verdict.farkas_value > FARKAS_TOLERANCE
        assert verdict.status == "infeasible"
        assert np.isnan(verdict.objective)
        assert np.isnan(verdict.gap)
