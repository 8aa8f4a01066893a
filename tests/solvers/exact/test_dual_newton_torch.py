"""The batched solver: Clarabel's answers, strictly feasible, up to the edge of feasibility."""

import cvxpy as cp
import numpy as np
import pytest
import torch
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from solvers import GraspForceProblem, SolverError, Status, available_solvers, solve
from solvers.compiled.judge.measure import ROUNDING
from solvers.duality import dual_bound, farkas_value, recession_direction, relaxed
from solvers.exact import torch_verdict
from solvers.exact.dual_newton_torch import STATUS_CODES, DualNewtonTorchSolver, solve_tensors
from solvers.exact.torch_newton import (
    ascent_step,
    cholesky_qr,
    cold_start,
    direction,
    evaluate_dual,
    tightened,
)
from solvers.exact.torch_verdict import verdict
from solvers.judge import judge
from solvers.problem import Multipliers, canonical
from tests.support.problems import (
    VARIANTS,
    random_batch,
    random_problem,
)
from tests.support.seeds import SEEDS, reseeded, seeded


def assert_same_as_clarabel(batch: GraspForceProblem) -> None:
    answer, truth = solve(batch, "dual_newton_torch"), solve(batch, "clarabel")
    # Clarabel's gap is at times a little more than optimal answers may have; one in 840 slippery
    # problems it does not solve
    worse = (truth.status == "failed") | ((truth.status == "feasible") & (truth.gap < 1e-5))
    better = (answer.status == "optimal") & worse
    assert np.sum(better) <= 1
    # on one in 840 problems whose torque limits leave little room it gives up itself, and says so
    gave_up = answer.status == "failed"
    assert np.sum(gave_up) <= 1
    both = ~better & ~gave_up
    np.testing.assert_array_equal(answer.status[both], truth.status[both])
    solved = (answer.status == "optimal") & ~better
    apart = abs(answer.objective - truth.objective)[solved]
    assert np.all(apart <= ((1e-7 + abs(truth.gap)) * truth.objective)[solved])
    assert np.all(answer.gap[solved] < 1e-7)
    # the solver knows what the judge will say
    np.testing.assert_array_equal(answer.message != "", gave_up)


@pytest.mark.parametrize("variant", VARIANTS)
def test_answers_are_those_of_clarabel(variant: str) -> None:
    assert_same_as_clarabel(random_batch(seeded(3), 60, **VARIANTS[variant]))


GIVEN = {
    "one torque": (1, 0, 0.0),
    "four torques": (4, 0, 0.0),
    "nearly given torques": (2, 0, 1e-11),
    "torques twice": (2, 0, 0.0),
    "one normal force": (0, 1, 0.0),
    "three normal forces": (0, 3, 0.0),
    "nearly given normal forces": (0, 2, 1e-15),
    "torques and normal forces": (2, 1, 0.0),
}
"""How many torques, how many normal forces, and the relative distance of their limits."""


def given_batch(kind: str, count: int) -> GraspForceProblem:
    """Problems some of whose torques and normal forces are given, near what would be best."""
    torques, normals, apart = GIVEN[kind]
    rng = seeded([19, list(GIVEN).index(kind)])
    problems = []
    for size in rng.integers(4, 8, count):
        problem = random_problem(rng, int(size))
        best = np.nan_to_num(solve(problem).forces)
        torque = problem.hand_jacobian.T @ best + problem.external_torque
        torque += 0.01 * rng.standard_normal(len(torque))
        normal = np.abs(best[2::3] + 0.5 * rng.standard_normal(size))
        some = np.arange(problem.n_joints) < torques
        others = np.arange(size) < normals
        problem = problem.replace(
            torque_min=np.where(some, torque, problem.torque_min),
            torque_max=np.where(some, torque + apart * abs(torque), problem.torque_max),
            normal_min=np.where(others, normal, problem.normal_min),
            normal_max=np.where(others, normal * (1.0 + apart), problem.normal_max),
        )
        if kind == "torques twice":
            names = ("hand_jacobian", "torque_min", "torque_max", "external_torque")
            twice = {name: np.concatenate([getattr(problem, name)] * 2, axis=-1) for name in names}
            problem = problem.replace(**twice)
        problems.append(problem)
    return GraspForceProblem.stack(problems)


@pytest.mark.parametrize("kind", GIVEN)
def test_given_torques_and_normal_forces_are_equations(kind: str) -> None:
    batch = given_batch(kind, 40)
    answer, truth = solve_tensors(batch.to_torch()), solve(batch, "clarabel")
    status = np.array([STATUS_CODES[code] for code in answer.status.tolist()])
    settled = (truth.status == "optimal") | (truth.status == "infeasible")
    assert settled.sum() >= 20
    assert (status == "optimal").sum() >= 10
    np.testing.assert_array_equal(status[settled], truth.status[settled])
    assert (status == "failed").sum() <= 1
    both = (status == "optimal") & (truth.status == "optimal")
    objective = answer.objective.numpy()[both]
    apart = (1e-7 + abs(truth.gap[both])) * truth.objective[both]
    assert np.all(abs(objective - truth.objective[both]) <= apart)


@pytest.mark.parametrize("variant", [*VARIANTS, *GIVEN])
def test_statuses_are_those_that_the_judge_gives(variant: str) -> None:
    if variant in GIVEN:
        batch = given_batch(variant, 20)
    else:
        batch = random_batch(seeded(20), 60, **VARIANTS[variant])
    answer = solve_tensors(batch.to_torch())
    multipliers = Multipliers(answer.equilibrium_dual.numpy(), answer.torque_dual.numpy())
    judged = judge(batch, answer.forces.numpy(), multipliers)
    status = np.array([STATUS_CODES[code] for code in answer.status.tolist()])
    np.testing.assert_array_equal(status, judged.status)
    np.testing.assert_allclose(answer.gap.numpy(), judged.gap, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(answer.objective.numpy(), judged.objective, rtol=1e-12)


@given(SEEDS, st.floats(-17.0, -9.0), st.booleans())
@settings(max_examples=8, deadline=None)
def test_forces_that_miss_a_constraint_by_little_get_the_verdict_of_the_judge(
    seed: int, digits: float, pinned: bool
) -> None:
    rng = seeded(seed)
    batch = random_batch(rng, 20, torque_min=-0.3, torque_max=0.3)
    if pinned:
        batch = given_batch("torques and normal forces", 20)
    answer = solve(batch)
    forces = answer.forces * (1.0 + 10.0**digits * rng.standard_normal(answer.forces.shape))
    ours = verdict(batch.to_torch(), torch.tensor(forces), torch.tensor(answer.dual_bound))
    nothing = Multipliers(np.zeros((20, 6)), np.zeros((20, batch.n_joints)))
    theirs = judge(batch, forces, nothing).status
    np.testing.assert_array_equal(ours.feasible.numpy(), np.isin(theirs, ("optimal", "feasible")))


def test_rounding_is_that_of_the_judge() -> None:
    assert torch_verdict._ROUNDING == ROUNDING


def test_at_the_edge_of_feasibility_steps_gain_no_more_than_rounding() -> None:
    # prices a million times the scale of the forces cancel in the value
    rng = np.random.default_rng(7_000_003)
    problem = random_batch(rng, 60, **VARIANTS["external torque over the limit"])[30]
    answer = solve_tensors(problem.to_torch())
    assert answer.is_status(Status.OPTIMAL)
    assert answer.forces.norm() > 1e3
    np.testing.assert_allclose(float(answer.objective), solve(problem).objective, rtol=1e-7)


@pytest.mark.parametrize("variant", VARIANTS)
def test_no_inequality_is_violated_at_all(variant: str) -> None:
    batch = random_batch(seeded(5), 60, **VARIANTS[variant]).to_torch()
    answer = solve_tensors(batch)
    solved = answer.is_status(Status.OPTIMAL)
    assert solved.any()
    forces = answer.forces[solved].numpy()
    problem = batch[solved].to_numpy()
    contacts = forces.reshape(len(forces), -1, 3)
    real = problem.contact_mask
    assert np.all((problem.friction * contacts[..., 2] >= np.hypot(*contacts[..., :2].T).T)[real])
    assert np.all((contacts[..., 2] >= problem.normal_min)[real])
    assert np.all((contacts[..., 2] <= problem.normal_max)[real])
    assert np.all(contacts[~real] == 0.0)
    torque = np.einsum("bij,bi->bj", problem.hand_jacobian, forces) + problem.external_torque
    assert np.all((torque >= problem.torque_min) & (torque <= problem.torque_max))
    applied = np.einsum("bij,bj->bi", problem.grasp_map, forces)
    size = np.abs(problem.grasp_map).max(axis=(1, 2)) * np.linalg.norm(forces, axis=1)
    error = np.abs(applied + problem.external_wrench).max(axis=1)
    assert np.all(error <= 1e-12 * np.maximum(size, 1e-300))


@given(SEEDS, st.integers(4, 6))
@settings(max_examples=25, deadline=None)
def test_loads_up_to_the_largest_are_carried_and_larger_ones_proven_impossible(
    seed: int, count: int
) -> None:
    problem = random_problem(
        seeded(seed), count, normal_min=0.0, normal_max=30.0, external_torque=0.0
    )
    largest = largest_load(problem)
    assume(largest > 0.1)  # no force closure: not every load can be carried at all
    shares = np.array([0.5, 0.8, 0.95, 0.99, 0.999, 1.001, 1.01, 1.1, 1.5, 2.0])
    wrench = largest * shares[:, None] * problem.external_wrench
    answer = solve(problem.replace(external_wrench=wrench), "dual_newton_torch")
    wanted = np.where(shares < 1.0, "optimal", "infeasible")
    np.testing.assert_array_equal(answer.status, wanted)


def largest_load(problem: GraspForceProblem) -> float:
    """By what the external wrench can be multiplied, from a conic program of its own."""
    forces, factor = cp.Variable((problem.n_contacts, 3)), cp.Variable()
    flat = cp.reshape(forces, (3 * problem.n_contacts,), order="C")
    torque = problem.hand_jacobian.T @ flat + problem.external_torque
    constraints = [
        problem.grasp_map @ flat + factor * problem.external_wrench == 0,
        cp.norm(forces[:, :2], axis=1) <= cp.multiply(problem.friction, forces[:, 2]),
        forces[:, 2] >= problem.normal_min,
        forces[:, 2] <= problem.normal_max,
        torque >= problem.torque_min,
        torque <= problem.torque_max,
    ]
    program = cp.Problem(cp.Maximize(factor), constraints)
    program.solve(solver=cp.CLARABEL)
    return float(factor.value)


def test_without_load_no_force_is_best_even_at_a_torque_limit() -> None:
    problem = random_problem(seeded(18), external_wrench=np.zeros(6), normal_min=0.0)
    answer = solve(problem.replace(torque_max=problem.external_torque), "dual_newton_torch")
    assert answer.status == "optimal"
    assert np.all(answer.forces == 0.0)
    assert answer.objective == answer.dual_bound == 0.0


def test_batches_larger_than_a_chunk_keep_their_order(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("solvers.exact.dual_newton_torch._CHUNK", {"cpu": 7})
    batch = random_batch(seeded(9), 40, torque_min=-0.15, torque_max=0.15)
    truth = solve(batch, "clarabel")
    answer = solve(batch, "dual_newton_torch")
    assert {"optimal", "infeasible"} <= set(truth.status)
    np.testing.assert_array_equal(answer.status, truth.status)
    solved = truth.status == "optimal"
    np.testing.assert_allclose(answer.objective[solved], truth.objective[solved], rtol=1e-7)


def test_tensor_answers_carry_certificates_that_hold_in_the_original_problem() -> None:
    batch = random_batch(seeded(10), 80, torque_min=-0.1, torque_max=0.1)
    answer = solve_tensors(batch.to_torch())
    multipliers = Multipliers(answer.equilibrium_dual.numpy(), answer.torque_dual.numpy())
    solved = answer.is_status(Status.OPTIMAL).numpy()
    infeasible = answer.is_status(Status.INFEASIBLE).numpy()
    assert solved.any()
    assert infeasible.any()
    np.testing.assert_allclose(
        dual_bound(batch, multipliers)[solved], answer.dual_bound.numpy()[solved], rtol=1e-12
    )
    assert np.all(farkas_value(batch, multipliers)[infeasible] > 1e-9)
    gap = (answer.objective - answer.dual_bound) / answer.objective
    torch.testing.assert_close(answer.gap[solved], gap[solved], rtol=1e-6, atol=1e-12)
    assert answer.forces[torch.tensor(infeasible)].isnan().any(dim=-1).all()
    assert answer.objective[torch.tensor(infeasible)].isnan().all()


@pytest.mark.parametrize("shape", [(), (0,), (1,), (2, 3), (2, 0)])
def test_batch_dimensions_are_kept(shape: tuple[int, ...]) -> None:
    problem = random_problem(seeded(11))
    wrench = np.broadcast_to(problem.external_wrench, (*shape, 6))
    answer = solve_tensors(problem.replace(external_wrench=wrench).to_torch())
    assert answer.status.shape == shape
    assert answer.forces.shape == (*shape, 12)
    assert answer.equilibrium_dual.shape == (*shape, 6)
    assert answer.torque_dual.shape == (*shape, 8)
    assert all(STATUS_CODES[code] == "optimal" for code in answer.status.reshape(-1).tolist())


def test_answers_carry_no_gradients_and_leave_the_problem_alone() -> None:
    problem = random_batch(seeded(12), 5).to_torch()
    wrench = problem.external_wrench.clone().requires_grad_()
    before = wrench.detach().clone()
    answer = solve_tensors(problem.replace(external_wrench=wrench))
    assert not answer.forces.requires_grad
    torch.testing.assert_close(wrench.detach(), before, rtol=0.0, atol=0.0)


def test_what_is_left_over_fails_with_a_message(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("solvers.exact.dual_newton_torch._CHECKS", (1,))
    monkeypatch.setattr("solvers.exact.dual_newton_torch._LATE_CHECKS", (1,))
    monkeypatch.setattr("solvers.exact.dual_newton_torch._WIDER", ())
    answer = solve(random_batch(seeded(13), 20), "dual_newton_torch")
    failed = answer.status == "failed"
    assert failed.any()
    assert all("dual_newton" in message for message in answer.message[failed])


def test_the_dual_value_never_falls_and_steps_end() -> None:
    problem = canonical(random_batch(seeded(14), 100).to_torch(), cholesky_qr).problem
    inner = tightened(problem)
    here = evaluate_dual(inner, cold_start(inner))
    for _ in range(25):
        ahead = direction(inner, here)
        after = ascent_step(inner, here, ahead)
        assert torch.all(after.value >= here.value - 1e-12 * (1.0 + here.value.abs()))
        here = after
    again = evaluate_dual(inner, here.multipliers)
    torch.testing.assert_close(again.value, here.value)
    torch.testing.assert_close(again.forces, here.forces)


@given(SEEDS, st.floats(0.0, 8.0))
@settings(max_examples=30, deadline=None)
def test_cholesky_qr_is_a_qr_factorisation_of_bad_matrices_too(seed: int, digits: float) -> None:
    generator = torch.Generator().manual_seed(reseeded(seed))
    left = torch.randn((5, 12, 6), generator=generator, dtype=torch.float64)
    sizes = torch.logspace(0.0, -digits, 6, dtype=torch.float64)
    matrix = torch.linalg.qr(left).Q * sizes @ torch.linalg.qr(left[:, :6]).Q
    basis, factor = cholesky_qr(matrix)
    eye = torch.eye(6, dtype=torch.float64).expand(5, 6, 6)
    torch.testing.assert_close(basis.mT @ basis, eye, rtol=0.0, atol=1e-13)
    torch.testing.assert_close(basis @ factor, matrix, rtol=0.0, atol=1e-13)
    assert torch.all(factor.tril(-1).abs() == 0.0)


def test_proofs_are_sought_the_same_way_in_numpy_and_torch() -> None:
    batch = random_batch(seeded(16), 40, torque_min=-0.1, torque_max=0.1)
    form, twin = canonical(batch), canonical(batch.to_torch())
    wider, other = relaxed(form, 0.01).problem, relaxed(twin, 0.01).problem
    begin = cold_start(other)
    rng = seeded(17)
    price = rng.normal(size=begin.torque.shape)
    ours = recession_direction(wider, Multipliers(begin.equilibrium.numpy(), price))
    theirs = recession_direction(other, Multipliers(begin.equilibrium, torch.tensor(price)))
    np.testing.assert_allclose(theirs.equilibrium.numpy(), ours.equilibrium, rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(theirs.torque.numpy(), ours.torque, rtol=1e-6, atol=1e-7)


def test_bad_settings_and_problems_are_refused() -> None:
    with pytest.raises(SolverError, match="tolerance"):
        DualNewtonTorchSolver(tolerance=0.0)
    with pytest.raises(SolverError, match="device"):
        DualNewtonTorchSolver(device="abacus")
    problem = random_problem(seeded(15))
    with pytest.raises(SolverError, match="float64 tensors"):
        solve_tensors(problem)
    with pytest.raises(SolverError, match="float64 tensors"):
        solve_tensors(problem.to_torch(dtype=torch.float32))
    with pytest.raises(SolverError, match="min_norm"):
        solve_tensors(problem.replace(objective="sum_normal").to_torch())
    with pytest.raises(SolverError, match="min_norm"):
        solve(problem.replace(objective="sum_normal"), "dual_newton_torch")


def test_the_solver_is_registered_after_the_network() -> None:
    names = available_solvers()
    assert names.index("dual_newton_torch") > names.index("conditioned")
