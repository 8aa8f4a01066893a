from pathlib import Path

import numpy as np
import pytest
import torch

from solvers import GraspForceProblem, GraspForceSolution, SolverError, make_solver, solve
from solvers.conditioned import DEFAULT_WEIGHTS
from solvers.network import ConditionedKktNetwork
from solvers.network_file import read_metadata, save_network
from tests.problems import random_batch, random_problem

USABLE = ("optimal", "feasible")


@pytest.fixture(scope="module")
def problem() -> GraspForceProblem:
    """Mixed, a third of it without friction to speak of, so that some are infeasible."""
    batch = random_batch(np.random.default_rng(0), 150)
    factor = np.where(np.arange(150) % 3 == 0, 0.3, 1.0)[:, None]
    return batch.replace(friction=factor * batch.friction)


@pytest.fixture(scope="module")
def exact(problem: GraspForceProblem) -> GraspForceSolution:
    return solve(problem, "clarabel")


@pytest.fixture(scope="module", params=[0, 4], ids=["network", "polished"])
def answer(request: pytest.FixtureRequest, problem: GraspForceProblem) -> GraspForceSolution:
    return solve(problem, "conditioned", fallback=None, polish_steps=request.param)


def test_feasible_answers_satisfy_every_constraint(answer: GraspForceSolution) -> None:
    usable = np.isin(answer.status, USABLE)
    size = 1e-8 * np.linalg.norm(answer.forces, axis=-1)
    for measured in (
        answer.equilibrium_residual(),
        answer.friction_violation(),
        answer.normal_violation(),
        answer.torque_violation(),
    ):
        assert np.all(measured[usable] <= size[usable])


def test_bounds_and_values_enclose_the_optimum(
    answer: GraspForceSolution, exact: GraspForceSolution
) -> None:
    solved = exact.status == "optimal"
    usable = solved & np.isin(answer.status, USABLE)
    optimum = exact.objective
    assert np.all(answer.dual_bound[solved] <= optimum[solved] * (1.0 + 1e-7))
    assert np.all(answer.objective[usable] >= optimum[usable] * (1.0 - 1e-7))


def test_proofs_and_forces_agree_with_the_exact_solver(
    answer: GraspForceSolution, exact: GraspForceSolution
) -> None:
    assert not np.any((answer.status == "infeasible") & np.isin(exact.status, USABLE))
    assert not np.any(np.isin(answer.status, USABLE) & (exact.status == "infeasible"))


def test_most_problems_get_an_answer(answer: GraspForceSolution, exact: GraspForceSolution) -> None:
    solved, none = exact.status == "optimal", exact.status == "infeasible"
    assert solved.sum() > 60
    assert none.sum() >= 15
    assert np.mean(np.isin(answer.status[solved], USABLE)) > 0.95
    assert np.mean(answer.status[none] == "infeasible") > 0.8
    assert np.median(answer.gap[solved & np.isin(answer.status, USABLE)]) < 1e-5
    assert np.all((answer.message != "") == (answer.status == "failed"))


def test_polish_closes_the_gap(problem: GraspForceProblem, exact: GraspForceSolution) -> None:
    polished = solve(problem, "conditioned", fallback=None, polish_steps=8)
    assert np.mean(polished.status[exact.status == "optimal"] == "optimal") > 0.97


def test_fallback_leaves_nothing_open(
    problem: GraspForceProblem, exact: GraspForceSolution
) -> None:
    answer = solve(problem, "conditioned")
    both = np.isin(answer.status, USABLE) == np.isin(exact.status, USABLE)
    assert np.all(both)
    assert np.array_equal(answer.status == "infeasible", exact.status == "infeasible")


def test_single_problem_and_tensors_get_the_same_answer() -> None:
    problem = random_problem(np.random.default_rng(1), 5)
    solver = make_solver("conditioned", fallback=None)
    alone, batched = solver.solve(problem), solver.solve(GraspForceProblem.stack([problem]))
    tensors = solver.solve(problem.to_torch())
    assert alone.status == batched.status[0] == tensors.status
    np.testing.assert_allclose(alone.forces, batched.forces[0], rtol=1e-5)
    assert isinstance(tensors.forces, torch.Tensor)
    np.testing.assert_allclose(tensors.forces.numpy(), alone.forces, rtol=1e-5)


def test_no_load_needs_no_force() -> None:
    problem = random_problem(
        np.random.default_rng(2), 4, external_wrench=np.zeros(6), normal_min=0.0
    )
    answer = solve(problem, "conditioned", fallback=None)
    assert answer.status == "optimal"
    np.testing.assert_array_equal(answer.forces, 0.0)


def test_empty_batch_is_answered() -> None:
    batch = random_batch(np.random.default_rng(3), 2)
    assert solve(batch[:0], "conditioned").forces.shape == (0, 3 * batch.n_contacts)


def test_untrained_weights_still_tell_no_lies(
    problem: GraspForceProblem, exact: GraspForceSolution, tmp_path: Path
) -> None:
    torch.manual_seed(0)
    path = tmp_path / "untrained.safetensors"
    save_network(ConditionedKktNetwork(), path, {})
    answer = solve(problem, "conditioned", fallback=None, weights=path)
    solved = exact.status == "optimal"
    assert np.all(answer.dual_bound[solved] <= exact.objective[solved] * (1.0 + 1e-7))
    assert not np.any(np.isin(answer.status, USABLE) & (exact.status == "infeasible"))


def test_shipped_weights_say_how_they_were_made() -> None:
    metadata = read_metadata(DEFAULT_WEIGHTS)
    assert metadata["command"].startswith("python scripts/train.py")
    assert {"seed", "steps", "validation", "config"} <= set(metadata)
    assert DEFAULT_WEIGHTS.stat().st_size < 2**20


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"polish_steps": -1}, "polish_steps is -1"),
        ({"fallback": "nobody"}, "fallback 'nobody'"),
        ({"weights": "missing.safetensors"}, "no weights at"),
    ],
)
def test_bad_settings_are_refused(settings: dict[str, object], message: str) -> None:
    with pytest.raises(SolverError, match=message):
        make_solver("conditioned", **settings)


def test_linear_objective_is_refused() -> None:
    problem = random_problem(np.random.default_rng(4), 4, objective="sum_normal")
    with pytest.raises(SolverError, match="min_norm"):
        solve(problem, "conditioned")
