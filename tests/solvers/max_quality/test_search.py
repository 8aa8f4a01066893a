"""Quality-maximising forces: judged, bracketed by proofs that hold, invariant, and unbeaten."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gfo_env.contacts import lowest_resisted_wrench
from solvers import GraspForceProblem, ProblemError, SolverError, solve
from solvers.judge import Status
from solvers.max_quality import search as search_module
from solvers.max_quality.search import QualitySearch, QualitySearchSolver
from solvers.problem import MAX_QUALITY
from solvers.quality import share_tree
from solvers.quality.cuts import CutMultipliers, NormalForces
from solvers.quality.proof import proven_bound
from solvers.quality.share_tree import ShareTree
from tests.support.problems import N_JOINTS, skew
from tests.support.quality_problems import LENGTH, quality_batch, quality_problem
from tests.support.seeds import SEEDS, seeded


def with_budget(problem: GraspForceProblem, budget: float) -> GraspForceProblem:
    return problem.replace(effort_budget=budget)


@pytest.mark.parametrize(("contacts", "gap"), [(3, 0.02), (4, 0.08), (5, 0.1)])
def test_forces_keep_all_constraints_and_come_close_to_the_bound(contacts: int, gap: float) -> None:
    rng = seeded(contacts)
    problem = GraspForceProblem.stack([quality_problem(rng, contacts) for _ in range(3)])
    solution = solve(problem, "quality_search")
    # optimal where the bound proves that the best quality is zero
    assert set(solution.status) <= {"feasible", "optimal"}
    assert (solution.forces[:, 2::3].sum(axis=1) <= problem.effort_budget).all()
    verdict = solution.verdict
    assert verdict.quality_lower is not None
    assert verdict.quality_upper is not None
    assert (verdict.quality_lower <= verdict.quality_upper).all()
    np.testing.assert_array_equal(solution.objective, -verdict.quality_lower)
    assert (solution.dual_bound <= solution.objective).all()
    # the search's tolerance, the judge's width, and what 400 rounds leave of these even spreads:
    # of twelve other draws each at most 0.015, 0.051 and 0.061
    some = verdict.quality_lower > 0.0
    assert (solution.gap[some] <= gap).all()
    assert (solution.dual_bound[~some] > -1e-3).all()  # next to nothing is possible


def test_the_interval_is_that_of_the_hull() -> None:
    rng = seeded(3)
    problem = quality_problem(rng, 4)
    solution = solve(problem, "quality_search")
    blocks = problem.grasp_map.reshape(2, 3, 4, 3)
    normals = blocks[0, :, :, 2].T
    # a column's moment is p x axis
    positions = [
        np.linalg.lstsq(
            np.vstack([-skew(axis) for axis in blocks[0, :, i].T]), blocks[1, :, i].T.ravel()
        )[0]
        for i in range(4)
    ]
    interval = lowest_resisted_wrench(
        positions,
        normals,
        problem.friction,
        normal_forces=solution.forces[2::3],
        length=LENGTH,
        relative_width=0.005,
    )
    assert solution.verdict.quality_lower is not None
    assert solution.verdict.quality_upper is not None
    assert float(solution.verdict.quality_lower) <= interval.upper
    assert interval.lower <= float(solution.verdict.quality_upper)


@given(SEEDS, st.integers(3, 5))
@settings(max_examples=15)
def test_no_other_forces_beat_the_bound(seed: int, contacts: int) -> None:
    rng = seeded(seed)
    problem = quality_problem(rng, contacts, times=float(rng.uniform(1.1, 4.0)))
    search = QualitySearch(problem, 0.05, 60)
    bracket = search.run()
    assert bracket is not None
    assert bracket.quality <= bracket.proof.bound * (1 + 1e-9)
    assert bracket.proof.holds(problem)
    normal_forces = NormalForces(problem)
    for _ in range(10):
        ray = normal_forces.ray(rng.uniform(0.0, 1.0, contacts) ** 3 + 1e-3)
        assert ray is not None
        other = solve(
            problem.constraints("sum_normal").replace(
                normal_min=np.maximum(problem.normal_min, 0.999 * np.maximum(ray.forces[2::3], 0.0))
            )
        )
        assert other.status in ("optimal", "feasible")
        judged = solve(problem, Answer(np.asarray(other.forces)))
        assert judged.status == "feasible"
        assert judged.verdict.quality_lower is not None
        assert float(judged.verdict.quality_lower) <= bracket.proof.bound * (1 + 1e-9)


class Answer(QualitySearchSolver):
    """A solver that always gives the same forces, for the judge to measure."""

    def __init__(self, forces: np.ndarray) -> None:
        super().__init__()
        self.forces = forces

    def propose(self, problem: GraspForceProblem) -> Any:
        """The forces, and no proof."""
        least = super().propose(problem.derived(effort_budget=0.0 * problem.effort_budget))
        return dataclasses.replace(least, forces=self.forces.reshape(1, -1), proofs=None)


@pytest.mark.parametrize("solver", ["uniform_preload", "quality", "quality_search"])
def test_the_budget_is_kept_in_whatever_order_effort_is_added_up(solver: str) -> None:
    problem = quality_batch(seeded(7), 3, 4, 6, times=1.3)
    solution = solve(problem, solver)
    # where nothing that a grasp can do has any quality, the search has proven its forces best
    nothing = (solution.status == "optimal") & (solution.objective == 0.0)
    assert ((solution.status == "feasible") | nothing).all()
    normal = solution.forces[:, 2::3]
    orders = [normal, normal[:, ::-1], np.sort(normal), np.sort(normal)[:, ::-1]]
    for ordered in orders:
        assert (np.cumsum(ordered, axis=1)[:, -1] <= problem.effort_budget).all()
        assert (ordered.sum(axis=1) <= problem.effort_budget).all()
    exact = [math.fsum(row) for row in normal]
    assert (exact <= problem.effort_budget).all()


def test_uniform_preload_is_within_the_budget_and_below_the_bound() -> None:
    rng = seeded(5)
    problem = GraspForceProblem.stack([quality_problem(rng, n) for n in (3, 4, 5, 6)])
    preload, search = solve(problem, "uniform_preload"), solve(problem, "quality_search")
    assert (preload.status == "feasible").all()
    effort = preload.forces[:, 2::3].sum(axis=1)
    assert (effort <= problem.effort_budget).all()
    assert (search.dual_bound <= preload.objective).all()
    # what the bound leaves open, the search may miss
    assert (search.objective <= preload.objective * (1 - 0.05)).all() | (
        search.objective <= preload.objective + 0.05 * np.abs(search.dual_bound)
    ).all()


def scale_forces(problem: GraspForceProblem, unit: float) -> GraspForceProblem:
    names = ("external_wrench", "torque_min", "torque_max", "external_torque", "effort_budget")
    names += ("normal_min", "normal_max")
    return problem.replace(**{name: unit * getattr(problem, name) for name in names})


def scale_lengths(problem: GraspForceProblem, unit: float) -> GraspForceProblem:
    rows = np.repeat([1.0, unit], 3)
    names = ("hand_jacobian", "torque_min", "torque_max", "external_torque")
    return problem.replace(
        grasp_map=rows[:, None] * problem.grasp_map,
        external_wrench=rows * problem.external_wrench,
        **{name: unit * getattr(problem, name) for name in (*names, "characteristic_length")},
    )


def test_false_proofs_are_found_out() -> None:
    problem = quality_problem(seeded(4), 4)
    bracket = QualitySearch(problem, 0.01, 400).run()
    assert bracket is not None
    proof = bracket.proof
    assert proof.holds(problem)
    assert proven_bound(problem, (proof,)) == -proof.bound
    loosest = proven_bound(problem, ())
    assert loosest < -proof.bound
    false = (
        dataclasses.replace(proof, bound=0.9 * bracket.quality),
        dataclasses.replace(proof, directions=proof.directions[:4]),
        dataclasses.replace(proof, bound=np.nan),
        dataclasses.replace(
            proof, cuts=tuple(dataclasses.replace(c, prices=-c.prices) for c in proof.cuts)
        ),
    )
    for wrong in false:
        assert not wrong.holds(problem)
        assert proven_bound(problem, (wrong,)) <= -bracket.quality


@given(SEEDS, st.integers(3, 6))
@settings(max_examples=100)
def test_cuts_of_any_multipliers_let_all_feasible_forces_be(seed: int, contacts: int) -> None:
    rng = seeded(seed)
    problem = quality_problem(rng, contacts)
    forces = solve(problem, "uniform_preload").forces
    cut = CutMultipliers(
        rng.uniform(0.0, 2.0, contacts),
        rng.standard_normal(6) * rng.choice([0.0, 0.1, 1.0, 10.0]),
        rng.standard_normal(N_JOINTS) * rng.choice([0.0, 1.0, 10.0]),
        float(rng.choice([0.0, 0.5, 2.0])),
    )
    assert cut.prices @ forces[2::3] <= cut.end(problem) * (1 + 1e-9) + 1e-9


def test_a_ray_ends_where_its_cut_says() -> None:
    rng = seeded(8)
    for contacts in (3, 5, 8):
        problem = quality_problem(rng, contacts)
        shares = rng.uniform(0.1, 1.0, contacts)
        ray = NormalForces(problem).ray(shares)
        assert ray is not None
        np.testing.assert_allclose(ray.cut.prices @ shares, 1.0, rtol=1e-9)
        np.testing.assert_allclose(ray.end, ray.length, rtol=1e-5)
        assert (ray.forces[2::3] >= ray.length * shares * (1 - 1e-6)).all()


def test_a_budget_below_the_least_effort_is_proven_too_small() -> None:
    problem = quality_problem(seeded(2), 4)
    small = with_budget(problem, 0.4 * float(problem.effort_budget))
    for solver in ("quality_search", "uniform_preload"):
        assert solve(small, solver).status != "feasible"
    assert solve(small, "quality_search").status == "infeasible"


def test_forces_beyond_the_budget_are_refused() -> None:
    problem = quality_problem(seeded(2), 4)
    forces = solve(problem, "uniform_preload").forces
    smaller = with_budget(problem, 0.99 * float(forces[2::3].sum()))
    assert solve(smaller, Answer(forces)).status == Status.FAILED.value


def test_effort_has_a_price() -> None:
    problem = quality_problem(seeded(6), 4, times=3.0, normal_min=0.0)
    plain = solve(problem, "quality_search")
    effort, worth = float(plain.forces[2::3].sum()), -float(plain.objective)
    least = float(solve(problem.constraints("sum_normal")).objective)
    open_ = float(plain.objective - plain.dual_bound)
    for share, low, high, wide in (
        (0.1, 0.98 * effort, effort, 0.1),
        (5.0, least, 1.15 * least, 0.5),
    ):
        weight = share * worth / effort
        priced = solve(problem.replace(effort_weight=weight), "quality_search")
        assert priced.status == "feasible"
        assert low <= float(priced.forces[2::3].sum()) <= high
        assert priced.objective <= plain.objective + weight * effort + 0.02 * worth
        # the bound leaves what it leaves without a price, and the price of the widest interval of
        # efforts: on seven draws up to 0.07 and 0.35 of the worth
        assert 0.0 <= priced.objective - priced.dual_bound <= open_ + wide * worth


@pytest.mark.parametrize("weight", [0.5, 2.0])
def test_without_load_no_forces_are_better_than_dear_ones(weight: float) -> None:
    problem = quality_problem(seeded(11), 3, normal_min=0.0, external_torque=0.0)
    problem = problem.replace(external_wrench=np.zeros(6), effort_budget=30.0, effort_weight=weight)
    solution = solve(problem, "quality_search", rounds=5)
    assert solution.status == "feasible"
    np.testing.assert_array_equal(solution.forces, 0.0)
    assert solution.objective == 0.0
    assert -0.03 * weight <= solution.dual_bound <= 0.0


@pytest.mark.parametrize(
    ("solver", "fields"),
    [("uniform_preload", {}), ("quality", {}), ("quality_search", {"rounds": 2})],
)
def test_padding_contacts_have_no_forces(solver: str, fields: dict[str, Any]) -> None:
    problem = quality_batch(seeded(12), 3, 4)
    # the padded problem has a budget below its least effort, and no forces at all
    problem = problem.replace(effort_budget=problem.effort_budget * [0.1, 1.0])
    answer = solve(problem, solver, **fields)
    assert answer.status[0] != "feasible"
    np.testing.assert_array_equal(answer.forces[0, 9:], 0.0)


def test_memory_ends_a_search_with_the_bound_of_then(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = quality_problem(seeded(1), 12)
    least = float(solve(problem.constraints("sum_normal")).objective)
    monkeypatch.setattr(share_tree, "_MOST_BYTES", 2**20)
    trees: list[ShareTree] = []

    class Watched(ShareTree):
        def __init__(self, contacts: int) -> None:
            super().__init__(contacts)
            trees.append(self)

    monkeypatch.setattr(search_module, "ShareTree", Watched)
    bracket = QualitySearch(problem, 0.01, 20).run()
    (tree,) = trees
    assert tree.full
    boxes = (tree.lower, tree._upper, tree._values, tree._nodes)
    assert sum(array.nbytes for array in boxes) <= 2**20
    assert bracket is not None
    assert 0.0 < bracket.quality <= bracket.proof.bound
    assert bracket.proof.holds(problem)
    assert bracket.forces[2::3].sum() >= least * (1 - 1e-6)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"effort_budget": None}, "effort_budget is missing"),
        ({"characteristic_length": None}, "characteristic_length is missing"),
        ({"effort_budget": 0.0}, "effort_budget is not positive"),
        ({"effort_budget": np.inf}, "effort_budget contains an infinite value"),
        ({"characteristic_length": -1.0}, "characteristic_length is not positive"),
        ({"effort_weight": -1.0}, "effort_weight is negative"),
        ({"objective": "min_norm"}, "effort_budget belongs to the objective max_quality"),
    ],
)
def test_bad_fields_are_named(changes: dict[str, Any], message: str) -> None:
    problem = quality_problem(seeded(0), 4)
    with pytest.raises(ProblemError, match=message):
        problem.replace(**changes)


def test_solvers_of_convex_objectives_name_the_one_that_can() -> None:
    problem = quality_problem(seeded(0), 4)
    with pytest.raises(SolverError, match="quality_search"):
        solve(problem)


@pytest.mark.parametrize(
    ("settings_", "message"),
    [({"tolerance": 0.0}, "tolerance must lie"), ({"rounds": 0}, "rounds must be")],
)
def test_bad_settings_are_refused(settings_: dict[str, Any], message: str) -> None:
    with pytest.raises(SolverError, match=message):
        QualitySearchSolver(**settings_)


def test_batches_of_tensors_come_back_as_tensors(tmp_path: Any) -> None:
    import torch

    rng = seeded(9)
    problem = GraspForceProblem.stack([quality_problem(rng, n) for n in (3, 4)])
    answer = solve(problem.to_torch(), "uniform_preload")
    assert isinstance(answer.forces, torch.Tensor)
    problem.save(tmp_path / "problems.npz")
    loaded = GraspForceProblem.load(tmp_path / "problems.npz")
    assert loaded.objective == MAX_QUALITY
    np.testing.assert_array_equal(loaded.effort_budget, problem.effort_budget)
    again = solve(loaded, "uniform_preload")
    np.testing.assert_array_equal(again.forces, answer.forces.numpy())
