"""Solvers by name, their errors, and the naive baselines."""

import importlib.util
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings

from solvers import (
    Candidate,
    GraspForceError,
    GraspForceProblem,
    MissingDependencyError,
    Multipliers,
    Solver,
    SolverError,
    UnknownSolverError,
    available_solvers,
    make_solver,
    solve,
)
from tests.support.problems import random_batch, random_problem
from tests.support.seeds import SEEDS, seeded


class SqueezeOnly(Solver):
    """A solver that a user may write: one objective, 1 N everywhere."""

    objectives = ("min_norm",)

    def propose(self, problem: GraspForceProblem) -> Candidate:
        """The same forces for all."""
        count = len(problem)
        return Candidate(
            np.tile([0.0, 0.0, 1.0], (count, problem.n_contacts)),
            Multipliers(np.zeros((count, 6)), np.zeros((count, problem.n_joints))),
            np.full(count, ""),
        )


def hide(monkeypatch: pytest.MonkeyPatch, *packages: str) -> None:
    find_spec = importlib.util.find_spec

    def without(name: str, *arguments: Any) -> Any:
        return None if name in packages else find_spec(name, *arguments)

    monkeypatch.setattr("solvers.registry.find_spec", without)


def test_exact_solvers_and_baselines_are_available() -> None:
    names = available_solvers()
    assert {"clarabel", "lmi", "pseudoinverse", "equal_squeeze"} <= set(names)
    assert names[0] == "dual_newton"
    assert len(set(names)) == len(names)


def test_the_structured_solver_is_the_default() -> None:
    problem = random_problem(seeded(0))
    np.testing.assert_array_equal(solve(problem).forces, solve(problem, "dual_newton").forces)


def test_unknown_solver_lists_the_known_ones() -> None:
    with pytest.raises(UnknownSolverError, match="unknown solver 'fastest'") as error:
        solve(random_problem(seeded(0)), "fastest")
    assert isinstance(error.value, GraspForceError)
    assert isinstance(error.value, ValueError)
    for name in available_solvers():
        assert name in str(error.value)


def test_missing_package_is_named_with_the_command_that_installs_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    hide(monkeypatch, "cvxpy")
    assert "lmi" not in available_solvers()
    assert "clarabel" in available_solvers()
    with pytest.raises(MissingDependencyError, match=r"'lmi' needs cvxpy; .*pip install cvxpy$"):
        make_solver("lmi")
    hide(monkeypatch, "cvxpy", "clarabel")
    with pytest.raises(MissingDependencyError, match="pip install cvxpy clarabel") as error:
        make_solver("lmi")
    assert isinstance(error.value, ImportError)
    assert set(available_solvers()) >= {"pseudoinverse", "equal_squeeze"}


@pytest.mark.parametrize(
    ("name", "why"),
    [("clarabel", ".*speed"), ("lmi", ".*speed"), ("pseudoinverse", ".*takes no arguments")],
)
def test_unknown_setting_is_an_error(name: str, why: str) -> None:
    with pytest.raises(SolverError, match=f"'{name}' does not take these settings: {why}"):
        make_solver(name, speed=1)


def test_settings_reach_the_solver() -> None:
    problem = random_problem(seeded(0))
    loose, tight = solve(problem, "clarabel", tolerance=1e-4), solve(problem, "clarabel")
    assert abs(loose.gap) > abs(tight.gap)


def test_solver_objects_are_taken_as_they_are() -> None:
    problem = random_problem(seeded(0))
    solution = solve(problem, SqueezeOnly())
    np.testing.assert_array_equal(solution.forces, np.tile([0.0, 0.0, 1.0], 4))
    assert solution.status == "failed"
    with pytest.raises(SolverError, match="already made"):
        solve(problem, SqueezeOnly(), tolerance=1e-3)


def test_objective_that_a_solver_lacks_is_an_error() -> None:
    problem = random_problem(seeded(0), objective="sum_normal")
    with pytest.raises(SolverError, match="SqueezeOnly solves min_norm, not sum_normal"):
        solve(problem, SqueezeOnly())


@given(SEEDS)
@settings(max_examples=25)
def test_pseudoinverse_balances_the_load_with_the_least_forces(seed: int) -> None:
    batch = random_batch(seeded(seed), 4)
    solution = solve(batch, "pseudoinverse")
    size = np.linalg.norm(solution.forces, axis=-1)
    assert np.all(solution.equilibrium_residual() <= 1e-12 * size)
    for problem, forces in zip(batch, solution.forces, strict=True):
        oracle = -np.linalg.pinv(problem.grasp_map, rcond=1e-12) @ problem.external_wrench
        np.testing.assert_allclose(forces, oracle, atol=1e-9 * np.abs(oracle).max())
    best = solve(batch, "clarabel")
    optimal = best.status == "optimal"
    assert np.all(0.5 * size[optimal] ** 2 <= best.objective[optimal] * (1 + 1e-9))


@given(SEEDS)
@settings(max_examples=25)
def test_equal_squeeze_presses_alike_within_preload_and_cap(seed: int) -> None:
    rng = seeded(seed)
    batch = random_batch(rng, 4, normal_min=0.0, normal_max=np.inf)
    mask = batch.contact_mask
    forces = solve(batch, "equal_squeeze").forces.reshape(*mask.shape, 3)
    assert np.all(forces[..., :2] == 0.0)
    assert np.all(forces[~mask] == 0.0)
    load = np.linalg.norm(batch.external_wrench[:, :3], axis=-1)
    for normal, real, problem, weight in zip(forces[..., 2], mask, batch, load, strict=True):
        assert np.ptp(normal[real]) == 0.0
        assert (problem.friction * normal)[real].sum() == pytest.approx(weight)
    bounded = random_batch(rng, 4, normal_min=2.0, normal_max=2.5)
    assert np.all(solve(bounded, "equal_squeeze").normal_violation() == 0.0)


@pytest.mark.parametrize("name", ["pseudoinverse", "equal_squeeze"])
def test_baselines_are_judged_like_any_solver(name: str) -> None:
    batch = random_batch(seeded(1), 40, normal_min=1.0)
    solution = solve(batch, name)
    violation = np.maximum(solution.friction_violation(), solution.normal_violation())
    violation = np.maximum(violation, solution.equilibrium_residual())
    assert np.all(solution.status[violation > 1e-6] == "failed")
    assert np.sum(solution.status == "failed") > 30
    assert not np.any(solution.status == "infeasible")
    assert np.all(solution.message == "a heuristic that checks no constraint")


def test_what_is_no_solver_is_refused() -> None:
    with pytest.raises(SolverError, match="not int"):
        solve(random_problem(seeded(0)), 3)  # type: ignore[arg-type]
