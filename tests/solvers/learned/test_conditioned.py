from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from solvers import GraspForceProblem, GraspForceSolution, SolverError, make_solver, solve
from solvers.base import Solver
from solvers.duality import contact_duals, project_cones
from solvers.judge import Verdict, judge
from solvers.kkt.multiplier_flow import kkt_flow
from solvers.learned.conditioned import DEFAULT_WEIGHTS, without_spurious_duals
from solvers.learned.files import read_metadata, save_network
from solvers.learned.network import ConditionedKktNetwork
from solvers.problem import Multipliers, canonical
from solvers.solution import Candidate
from tests.support.problems import random_batch, random_problem
from tests.support.seeds import reseeded, seeded

USABLE = ("optimal", "feasible")


@pytest.fixture(scope="module")
def problem() -> GraspForceProblem:
    """Mixed, a third of it without friction to speak of, so that some are infeasible."""
    batch = random_batch(seeded(0), 150)
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
    assert none.sum() >= 8  # another draw had 14
    assert np.mean(np.isin(answer.status[solved], USABLE)) > 0.95
    assert np.mean(answer.status[none] == "infeasible") > 0.8
    assert np.median(answer.gap[solved & np.isin(answer.status, USABLE)]) < 1e-5
    failed, said = answer.status == "failed", answer.message != ""
    assert np.all(said[failed])
    # rounding may make the solver doubt what the judge accepts
    assert np.count_nonzero(said & ~failed) <= 1


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


@pytest.mark.parametrize("polish_steps", [0, 4])
@pytest.mark.parametrize("tolerance", [1e-6, 1e-2])
def test_every_answer_is_proven_or_within_the_tolerance(
    problem: GraspForceProblem, exact: GraspForceSolution, polish_steps: int, tolerance: float
) -> None:
    solver = make_solver("conditioned", polish_steps=polish_steps, tolerance=tolerance)
    answer = solver.solve(problem)
    none = exact.status == "infeasible"
    assert np.array_equal(answer.status == "infeasible", none)
    assert np.all(answer.gap[~none] <= 1.01 * tolerance)
    assert np.all(answer.message[~none] == "")


def proposed(problem: GraspForceProblem, **settings: Any) -> Verdict:
    """What the judge says of the solver's own candidates, before what they miss is repaired."""
    candidate = make_solver("conditioned", **settings, fallback=None).propose(problem.flat())
    return judge(problem, candidate.forces, candidate.multipliers)


def test_tolerance_decides_what_goes_to_the_fallback(
    problem: GraspForceProblem, monkeypatch: pytest.MonkeyPatch
) -> None:
    alone = proposed(problem, polish_steps=0)
    sent = []
    for tolerance in (np.inf, 1e-6, 1e-8):
        solver = make_solver("conditioned", polish_steps=0, tolerance=tolerance)
        fallback = solver._fallback
        passed: list[int] = []

        def judge_and_count(
            part: GraspForceProblem, fallback: Solver = fallback, passed: list[int] = passed
        ) -> tuple[Candidate, Verdict]:
            passed.append(len(part))
            return Solver.judged(fallback, part)

        monkeypatch.setattr(fallback, "judged", judge_and_count)
        solver.solve(problem)
        sent.append(sum(passed))
    failed = np.sum(alone.status == "failed")
    expected = [failed + np.sum(alone.gap > tolerance) for tolerance in (np.inf, 1e-6, 1e-8)]
    assert sent == expected
    assert sent[0] < sent[1] < sent[2]


def test_an_answer_better_than_the_fallback_is_kept(
    problem: GraspForceProblem, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = {"polish_steps": 0, "tolerance": 1e-9}
    alone = solve(problem, "conditioned", **settings, fallback=None)
    solver = make_solver("conditioned", **settings, fallback="equal_squeeze")
    answer = solver.solve(problem)
    assert np.any(alone.gap > 1e-9)
    same = proposed(problem, **settings).status != "failed"
    np.testing.assert_array_equal(answer.status[same], alone.status[same])
    np.testing.assert_array_equal(answer.forces[same], alone.forces[same])


@pytest.mark.parametrize("polish_steps", [0, 4])
def test_without_repair_forces_are_those_of_the_prices(
    problem: GraspForceProblem, polish_steps: int
) -> None:
    settings = {"polish_steps": polish_steps, "fallback": None}
    raw = make_solver("conditioned", repair=False, **settings).propose(problem)
    priced = project_cones(problem, -contact_duals(problem, raw.multipliers))
    size = np.linalg.norm(priced, axis=(-2, -1))
    error = np.linalg.norm(priced.reshape(raw.forces.shape) - raw.forces, axis=-1)
    assert np.all(error <= 1e-6 * (size + 1.0))
    repaired = make_solver("conditioned", **settings).propose(problem)
    assert np.sum(raw.message != "") > 2 * np.sum(repaired.message != "")


def test_without_repair_the_fallback_answers(
    problem: GraspForceProblem, exact: GraspForceSolution
) -> None:
    answer = solve(problem, "conditioned", repair=False)
    assert np.array_equal(answer.status == "infeasible", exact.status == "infeasible")
    assert np.all(answer.gap[exact.status == "optimal"] <= 1.01e-6)


def test_spurious_torque_prices_are_those_that_a_step_of_the_flow_removes(
    problem: GraspForceProblem,
) -> None:
    form = canonical(problem).problem
    rng = seeded(7)
    price = rng.normal(size=form.torque_min.shape) * rng.choice([1e-3, 1.0, 30.0], (len(form), 1))
    guess = Multipliers(rng.normal(size=form.external_wrench.shape), price)
    kept = without_spurious_duals(form, guess)
    assert np.array_equal(kept.equilibrium, guess.equilibrium)
    assert np.all((kept.torque == 0) | (kept.torque == price))
    tensors = Multipliers(torch.as_tensor(guess.equilibrium), torch.as_tensor(price))
    after = price + kkt_flow(form.to_torch(), tensors).torque.numpy()
    np.testing.assert_array_equal(kept.torque == 0, after * price <= 0)
    assert 0.05 < np.mean(kept.torque == 0) < 0.95


def test_true_torque_prices_are_not_spurious(problem: GraspForceProblem) -> None:
    tight = problem.replace(
        torque_min=0.1 * problem.torque_min,
        torque_max=0.1 * problem.torque_max,
        external_torque=np.zeros_like(problem.external_torque),
    )
    exact = solve(tight, "clarabel")
    rows = np.flatnonzero(exact.status == "optimal")
    form = canonical(tight[rows])
    best = form.scaled(Multipliers(exact.equilibrium_dual[rows], exact.torque_dual[rows]))
    true = np.abs(best.torque) > 1e-4
    assert true.sum() > 5
    kept = without_spurious_duals(form.problem, best)
    np.testing.assert_array_equal(kept.torque[true], best.torque[true])


def test_no_load_needs_no_force() -> None:
    problem = random_problem(seeded(2), 4, external_wrench=np.zeros(6), normal_min=0.0)
    answer = solve(problem, "conditioned", fallback=None)
    assert answer.status == "optimal"
    np.testing.assert_array_equal(answer.forces, 0.0)


def test_untrained_weights_still_tell_no_lies(
    problem: GraspForceProblem, exact: GraspForceSolution, tmp_path: Path
) -> None:
    torch.manual_seed(reseeded(0))
    path = tmp_path / "untrained.safetensors"
    save_network(ConditionedKktNetwork(), path, {})
    answer = solve(problem, "conditioned", fallback=None, weights=path)
    solved = exact.status == "optimal"
    assert np.all(answer.dual_bound[solved] <= exact.objective[solved] * (1.0 + 1e-7))
    assert not np.any(np.isin(answer.status, USABLE) & (exact.status == "infeasible"))


def test_shipped_weights_say_how_they_were_made() -> None:
    metadata = read_metadata(DEFAULT_WEIGHTS, ConditionedKktNetwork)
    assert metadata["command"].startswith("python scripts/train.py")
    assert {"seed", "steps", "validation", "config"} <= set(metadata)
    assert DEFAULT_WEIGHTS.stat().st_size < 2**20


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"polish_steps": -1}, "polish_steps is -1"),
        ({"tolerance": 0.0}, "tolerance is 0"),
        ({"tolerance": float("nan")}, "tolerance is nan"),
        ({"fallback": "nobody"}, "fallback 'nobody'"),
        ({"weights": "missing.safetensors"}, "no weights at"),
    ],
)
def test_bad_settings_are_refused(settings: dict[str, object], message: str) -> None:
    with pytest.raises(SolverError, match=message):
        make_solver("conditioned", **settings)


def test_linear_objective_is_refused() -> None:
    problem = random_problem(seeded(4), 4, objective="sum_normal")
    with pytest.raises(SolverError, match="min_norm"):
        solve(problem, "conditioned")


def test_where_the_fallback_fails_too_the_first_attempt_stays() -> None:
    problem = random_batch(seeded(31), 40)
    settings: dict[str, Any] = {"polish_steps": 0, "repair": False}
    alone = solve(problem, "conditioned", **settings, fallback=None)
    heuristic = solve(problem, "pseudoinverse")
    answer = solve(problem, "conditioned", **settings, fallback="pseudoinverse")
    neither = (alone.status == "failed") & (heuristic.status == "failed")
    assert neither.any()
    np.testing.assert_array_equal(answer.forces[neither], alone.forces[neither])
    np.testing.assert_array_equal(answer.message[neither], alone.message[neither])
