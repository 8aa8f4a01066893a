"""Preloads of given shares: exact, as high as the effort allows, and differentiable."""

import itertools

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import solvers.max_quality.preload as preload_module
from solvers import GraspForceProblem, solve
from solvers.compiled.newton.ascent import INFEASIBLE, SOLVED
from solvers.compiled.newton.batch import Ascent, solve_batch
from solvers.max_quality.flow import even_shares
from solvers.max_quality.preload import ceiling_duals, effort, least_forces, preloaded, within
from solvers.quality.cuts import NormalForces
from solvers.solution import Candidate, judge_candidate
from tests.support.quality_problems import quality_batch, quality_problem
from tests.support.seeds import SEEDS, seeded
from training.networks.quality_repair import answered


def random_shares(problem: GraspForceProblem, rng: np.random.Generator) -> np.ndarray:
    raw = rng.uniform(0.05, 1.0, problem.friction.shape) * problem.contact_mask
    return np.asarray(raw / raw.sum(axis=1, keepdims=True))


def asked(problem: GraspForceProblem, level: float, shares: np.ndarray) -> np.ndarray:
    """(n,) N: the normal forces that a level asks for at least, of a flat problem of one."""
    capped = np.minimum(level * shares, problem.normal_max[0])
    return np.asarray(np.maximum(problem.normal_min[0], capped))


@pytest.fixture
def tried(monkeypatch: pytest.MonkeyPatch) -> list[tuple[np.ndarray, int]]:
    """The normal forces (n,) that every level asks for which is tried, and the kernel's answer.

    It leaves some undecided, which then end the level as if they were impossible.
    """
    seen: list[tuple[np.ndarray, int]] = []

    def watched(problem: GraspForceProblem) -> Ascent:
        answer = solve_batch(problem)
        seen.extend(zip(problem.normal_min, answer.code, strict=True))
        return answer

    monkeypatch.setattr(preload_module, "solve_batch", watched)
    return seen


def decided(tried: list[tuple[np.ndarray, int]]) -> bool:
    return {code for _, code in tried} <= {SOLVED, INFEASIBLE}


def judged(problem: GraspForceProblem, forces: np.ndarray) -> np.ndarray:
    least = least_forces(problem)
    candidate = Candidate(forces, least.multipliers, np.zeros(len(problem), dtype="U1"))
    return judge_candidate(problem, candidate).status


@given(SEEDS, st.floats(1.01, 6.0))
@settings(max_examples=25)
def test_forces_are_feasible_and_press_as_asked(seed: int, times: float) -> None:
    rng = seeded(seed)
    problem = quality_batch(rng, 3, 4, 6, times=times).flat()
    least = least_forces(problem)
    assert least.found.all()
    assert (judged(problem, least.forces) == "feasible").all()
    shares = random_shares(problem, rng)
    made = preloaded(problem, least, shares, problem.effort_budget)
    assert (judged(problem, made.forces) == "feasible").all()
    asked = np.minimum(made.level[:, None] * shares, problem.normal_max)
    least_normal = np.minimum(least.forces[:, 2::3], asked)
    pressed = made.forces[:, 2::3]
    assert (pressed >= np.maximum(problem.normal_min, least_normal) * (1 - 1e-9) - 1e-12).all()
    np.testing.assert_array_equal(made.effort, effort(made.forces))
    spends = least.effort < problem.effort_budget
    full = ~made.by_torque & spends
    np.testing.assert_allclose(made.effort[full], problem.effort_budget[full], rtol=1e-9)


def test_no_higher_level_exists(tried: list[tuple[np.ndarray, int]]) -> None:
    rng = seeded(1)
    limited = 0
    for contacts in itertools.cycle((3, 4, 5, 6, 4, 5)):
        problem = quality_problem(rng, contacts, times=float(rng.uniform(1.5, 8.0)))
        flat = problem.reshape(1).flat()
        shares = random_shares(flat, rng)
        start = least_forces(flat)
        tried.clear()
        made = preloaded(flat, start, shares, flat.effort_budget)
        ray = NormalForces(problem).ray(shares[0])
        assert ray is not None
        # a cap ends the ray, but not the level: the other contacts may press on
        capped = np.min(problem.normal_max / shares[0])
        assert min(made.level[0], capped) <= ray.length * (1 + 1e-6)
        if made.by_torque[0]:
            # the bracket of the level ends at 0.4 per cent of it
            higher = made.level[0] * (1 + 8e-3)
            refused = [normal for normal, code in tried if code != SOLVED]
            least = asked(flat, higher, shares[0])
            # where caps hold back, the level may end at the budget
            assert higher > flat.effort_budget[0] or any(np.all(each <= least) for each in refused)
            # one in forty ends too soon, by up to 38 per cent, at a level left undecided
            if decided(tried):
                limited += bool(refused)
                assert made.level[0] >= ray.length * (1 - 8e-3)
        if limited == 3:
            break


def test_proofs_of_the_ceiling_are_cuts(tried: list[tuple[np.ndarray, int]]) -> None:
    rng = seeded(3)
    seen = 0
    while seen < 5:
        problem = quality_problem(rng, 5, times=8.0)
        flat = problem.reshape(1).flat()
        shares = random_shares(flat, rng)
        least = least_forces(flat)
        tried.clear()
        made = preloaded(flat, least, shares, flat.effort_budget)
        prices = ceiling_duals(flat, made.proof)[0]
        # where a level was left undecided, the proof may be of a much higher one
        if not (made.by_torque[0] and prices.any() and decided(tried)):
            continue
        seen += 1
        # what is priced are normal forces, of which a level asks no less than the preload of the
        # problem and no more than its caps; the proof is of a level 0.4 per cent higher at most
        ceiling = prices @ asked(flat, made.level[0], shares[0])
        for _ in range(5):
            other = random_shares(flat, rng)
            level = preloaded(flat, least, other, flat.effort_budget).level[0]
            assert prices @ asked(flat, level, other[0]) <= ceiling * (1 + 5e-3)


def test_between_least_effort_and_least_norm_the_mean_meets_the_budget() -> None:
    rng = seeded(7)
    met = 0
    for _ in range(30):
        problem = quality_problem(rng, 6, times=1.02, normal_min=0.0)
        flat = problem.reshape(1).flat()
        norm = solve(problem.constraints())
        if norm.forces[2::3].sum() > float(problem.effort_budget):
            met += 1
            least = least_forces(flat)
            np.testing.assert_allclose(least.effort, flat.effort_budget, rtol=1e-12)
            assert judged(flat, least.forces)[0] == "feasible"
            even = preloaded(flat, least, even_shares(flat), flat.effort_budget)
            np.testing.assert_allclose(even.forces, least.forces, rtol=1e-9)
    assert met


def test_the_mean_of_forces() -> None:
    few, many = np.array([[0.0, 0.0, 1.0]]), np.array([[1.0, 0.0, 3.0]])
    np.testing.assert_allclose(within(few, many, np.array([2.0])), [[0.5, 0.0, 2.0]])
    np.testing.assert_array_equal(within(few, many, np.array([5.0])), many)
    np.testing.assert_array_equal(within(few, np.full((1, 3), np.nan), np.array([2.0])), few)
    assert np.isnan(within(few, many, np.array([0.5]))).all()


def test_the_gradient_is_that_of_finite_differences(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(preload_module, "_WIDTH", 1e-10)
    monkeypatch.setattr(preload_module, "_WIDTH_OF_EFFORT", 1e-10)
    monkeypatch.setattr(preload_module, "_ROUNDS", 90)
    rng = seeded(2)
    problem = quality_batch(rng, *[4, 5, 6] * 8, times=1.6).flat()
    least = least_forces(problem)
    shares, limit = random_shares(problem, rng), problem.effort_budget
    leaves = torch.tensor(shares, requires_grad=True), torch.tensor(limit, requires_grad=True)
    point, normal = answered(problem, least, *leaves)
    wanted = torch.tensor(rng.standard_normal(shares.shape))
    (normal * wanted).sum().backward()  # type: ignore[no-untyped-call]
    step = 1e-5
    move = random_shares(problem, rng) - shares

    def change(share_step: float, limit_step: float) -> np.ndarray:
        moved = [
            answered(
                problem,
                least,
                torch.tensor(shares + sign * share_step * move),
                torch.tensor(limit * (1.0 + sign * limit_step)),
            )[1]
            for sign in (1.0, -1.0)
        ]
        return np.asarray(((moved[0] - moved[1]) * wanted).sum(dim=1))

    by_effort = ~point.forces.by_torque & (least.effort < limit)
    assert by_effort.sum() > 8
    assert leaves[0].grad is not None
    assert leaves[1].grad is not None
    exact = (leaves[0].grad.numpy() * move).sum(axis=1)
    measured = change(step, 0.0) / (2 * step)
    # at a kink the two differ; few lie on one
    near = np.isclose(exact, measured, rtol=1e-4, atol=1e-5)[by_effort]
    assert near.mean() > 0.9
    measured = change(0.0, step) / (2 * step * limit)
    near = np.isclose(leaves[1].grad.numpy(), measured, rtol=1e-4, atol=1e-6)[by_effort]
    assert near.mean() > 0.9
