"""What statuses promise holds in exact arithmetic, by code that the project does not share."""

import ast
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from solvers import GraspForceProblem, GraspForceSolution, Multipliers, make_solver, solve
from solvers.problem import MAX_QUALITY, OBJECTIVES
from tests.support import exact_quality, promises, rational
from tests.support.problems import VARIANTS, feasible_problem, random_problem
from tests.support.promises import broken_promises
from tests.support.quality_problems import quality_problem
from tests.support.rational import Exact, Prices
from tests.support.seeds import seeded

CONVEX = {
    "dual_newton": 4,
    "interior_point": 2,
    "clarabel": 1,
    "conditioned": 2,
    "dual_newton_torch": 1,
    "pseudoinverse": 1,
    "equal_squeeze": 1,
}
"""How many problems of each kind and objective a solver gets: 576 answers in all."""


def problems(objective: str, each: int) -> GraspForceProblem:
    """Every kind of `VARIANTS`, padded to the largest."""
    return GraspForceProblem.stack(
        [
            random_problem(
                seeded([61, k, kind]), **{"contacts": 3 + k % 4, "objective": objective} | settings
            )
            for kind, settings in enumerate(VARIANTS.values())
            for k in range(each)
        ]
    )


@pytest.mark.parametrize("name", CONVEX)
def test_no_promise_of_a_status_is_broken(name: str) -> None:
    solver = make_solver(name)
    for objective in set(OBJECTIVES) & set(solver.objectives):
        batch = problems(objective, CONVEX[name])
        answer = solver.solve(batch)
        broken = {k: broken_promises(batch, answer, k) for k in range(len(batch))}
        assert not {k: what for k, what in broken.items() if what}


@pytest.mark.parametrize("name", ["quality", "uniform_preload"])
def test_no_promise_about_quality_is_broken(name: str) -> None:
    for k in range(8):
        # a budget below the least effort is one that nothing can keep
        problem = quality_problem(seeded([62, k]), 3 + k % 3, times=0.5 if k % 4 == 2 else 2.0)
        assert problem.objective == MAX_QUALITY
        assert broken_promises(problem, solve(problem, name)) == []


@pytest.mark.parametrize("objective", OBJECTIVES)
def test_multipliers_prove_what_an_exact_solver_says_and_no_less(objective: str) -> None:
    batch = problems(objective, 2)
    answer = solve(batch)
    for k in range(len(batch)):
        prices = Prices(Exact(batch[k]), answer.equilibrium_dual[k], answer.torque_dual[k])
        if answer.status[k] == "optimal":
            size = answer.verdict.size[k] ** (2 if objective == "min_norm" else 1)
            exact = float(prices.bound())
            # `min_max_normal` may prove more by another multiple of the multipliers
            assert exact >= answer.dual_bound[k] - 1e-12 * size
            assert exact <= answer.objective[k] + 1e-12 * size
        else:
            share = float(prices.farkas() / prices.size())
            np.testing.assert_allclose(share, answer.verdict.farkas_value[k], rtol=1e-6)


def moved(axis: int, by: float) -> Callable[[GraspForceSolution], Any]:
    def spoil(answer: GraspForceSolution) -> Any:
        forces = answer.forces.copy()
        forces[axis] += by
        return with_forces(answer, forces)

    return spoil


def with_forces(answer: GraspForceSolution, forces: Any) -> Any:
    """The answer with other forces, and the objective that they have."""
    return replace(answer, forces=forces, objective=np.float64(0.5 * forces @ forces))


SPOILT: dict[str, tuple[str, Callable[[GraspForceSolution], Any]]] = {
    "forces that do not balance": ("equilibrium", moved(2, 1e-9)),
    "a force out of its cone": (
        "friction",
        lambda answer: with_forces(answer, answer.forces + np.tile([0.0, 1e3, 0.0], 4)),
    ),
    "a pull": ("normal force", lambda answer: with_forces(answer, -answer.forces)),
    "torques without end": ("torque", lambda answer: with_forces(answer, 1e3 * answer.forces)),
    "forces that are no numbers": ("finite", moved(0, np.nan)),
    "another objective": (
        "objective",
        lambda answer: replace(answer, objective=answer.objective * (1 + 1e-12)),
    ),
    "a bound too high": (
        "bound",
        lambda answer: replace(answer, dual_bound=answer.dual_bound * (1 + 1e-9)),
    ),
    "a bound without multipliers": (
        "bound",
        lambda answer: replace(answer, equilibrium_dual=np.full(6, np.nan)),
    ),
    "a gap": ("gap", lambda answer: replace(answer, dual_bound=answer.dual_bound * (1 - 1e-5))),
    "a proof of nothing": (
        "Farkas",
        lambda answer: replace(answer, status=np.array("infeasible")),
    ),
    "a failure without a word": (
        "message",
        lambda answer: replace(answer, status=np.array("failed"), message=np.array("")),
    ),
}
"""What is found, and how an answer comes by it."""


@pytest.mark.parametrize("name", SPOILT)
def test_what_is_wrong_is_found(name: str) -> None:
    problem = feasible_problem(
        seeded(63), 4, normal_min=0.5, normal_max=40.0, torque_min=-1.0, torque_max=1.0
    )
    answer = solve(problem)
    assert broken_promises(problem, answer) == []
    what, spoil = SPOILT[name]
    broken = broken_promises(problem, spoil(answer))
    assert any(what in one for one in broken), broken


def test_feasible_forces_and_a_proof_of_infeasibility_exclude_each_other() -> None:
    impossible = feasible_problem(seeded(64), 4, normal_min=0.0, normal_max=40.0).replace(
        external_wrench=np.array([0.0, 0.0, 1e3, 0.0, 0.0, 0.0])
    )
    answer = solve(impossible)
    assert answer.status == "infeasible"
    assert broken_promises(impossible, answer) == []
    claimed = replace(answer, status=np.array("feasible"), forces=np.zeros(12))
    assert any("prove infeasibility" in one for one in broken_promises(impossible, claimed))
    none = Multipliers(np.zeros(6), np.zeros(impossible.n_joints))
    unproven = replace(answer, equilibrium_dual=none.equilibrium, torque_dual=none.torque)
    assert any("Farkas" in one for one in broken_promises(impossible, unproven))


def test_what_is_wrong_with_quality_is_found() -> None:
    problem = quality_problem(seeded(65), 4)
    answer = solve(problem, "uniform_preload")
    verdict = answer.verdict
    lower, upper = 1.02 * verdict.quality_upper, 1.03 * verdict.quality_upper
    claimed = replace(
        answer,
        objective=-lower,
        verdict=replace(verdict, quality_lower=lower, quality_upper=upper),
    )
    assert any("below what is stated" in one for one in broken_promises(problem, claimed))
    cheap = problem.replace(effort_budget=0.9 * answer.forces[2::3].sum())
    assert any("budget" in one for one in broken_promises(cheap, answer))


def test_bounds_of_a_problem_that_is_solved_by_hand() -> None:
    """Two contacts along x, each half of the load at mu = 1/2, have multipliers that are known."""
    line = np.zeros((6, 6))
    line[0, 2], line[0, 5] = 1.0, -1.0
    line[1, 0] = line[1, 3] = 1.0
    pair: dict[str, Any] = {
        "grasp_map": line,
        "hand_jacobian": np.zeros((6, 0)),
        "friction": np.full(2, 0.5),
        "torque_min": np.zeros(0),
        "torque_max": np.zeros(0),
        "external_torque": np.zeros(0),
        "external_wrench": np.array([0.0, -3.0, 0.0, 0.0, 0.0, 0.0]),
        "normal_min": np.zeros(2),
        "normal_max": np.full(2, np.inf),
        "contact_mask": np.ones(2, dtype=bool),
    }
    # each contact bears 1.5 N by friction and presses with 3 N; a newton of load costs nu
    for objective, nu, optimum in (
        ("min_norm", 7.5, 11.25),
        ("sum_normal", 2.0, 6.0),
        ("min_max_normal", 1.0, 3.0),
    ):
        exact = Exact(SimpleNamespace(**pair, objective=objective))
        prices = Prices(exact, np.array([0.0, -nu, 0, 0, 0, 0]), np.zeros(0))
        assert float(prices.bound()) == pytest.approx(optimum, rel=1e-15)
    stuck = SimpleNamespace(**pair | {"normal_max": np.full(2, 2.0)}, objective="min_norm")
    proof = Prices(Exact(stuck), np.array([0.0, -1.0, 0, 0, 0, 0]), np.zeros(0))
    # 3 N of load against 2 * 0.5 * 2 N of friction
    assert float(proof.farkas()) == pytest.approx(1.0, rel=1e-15)


def test_the_check_shares_no_code_with_the_project() -> None:
    ours = {"solvers", "gfo_env", "training", "scripts"}
    for module in (rational, promises, exact_quality):
        source = ast.parse(Path(str(module.__file__)).read_text(encoding="utf-8"))
        names = {
            (node.module or "") if isinstance(node, ast.ImportFrom) else alias.name
            for node in ast.walk(source)
            if isinstance(node, ast.Import | ast.ImportFrom)
            for alias in node.names
        }
        assert not {name.split(".")[0] for name in names} & ours
