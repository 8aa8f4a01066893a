"""What every registered solver must do, whoever wrote it: one list of problems for all.

A solver may fail, and a heuristic nearly always does. It may not be wrong: nothing that is said to
be feasible misses a constraint, nothing that is said to be infeasible has forces, and no bound lies
above the optimum. Two answers to one problem then agree to within the gaps that they state, however
the problem is written down, and whatever else is in the batch.
"""

from collections.abc import Iterator
from functools import cache
from inspect import signature
from typing import Any

import numpy as np
import pytest
import torch

from solvers import (
    GraspForceProblem,
    GraspForceSolution,
    Solver,
    SolverError,
    Status,
    available_solvers,
    make_solver,
    solve,
)
from solvers.problem import MAX_QUALITY, OBJECTIVES, objective_value
from tests.support.agreement import proven, strict
from tests.support.problems import (
    VARIANTS,
    forces_in_cones,
    random_batch,
    random_problem,
    solved_by,
)
from tests.support.quality_problems import quality_problem
from tests.support.rewriting import CHANGES, Change, move_origin
from tests.support.seeds import seeded

EXACT = ("dual_newton", "interior_point", "clarabel", "dual_newton_torch")
"""Settle what is not at the edge of feasibility, and what they settle they settle alike."""

STRUCTURED = ("dual_newton", "interior_point", "dual_newton_torch", "conditioned")
"""Keep every inequality exactly, in whatever order it is added up."""

SLOW = {"lmi": 8, "kkt_ode": 40, "instance_network": 100, "quality_search": 20}
"""They get so many times fewer problems."""

QUICK: dict[str, dict[str, Any]] = {"instance_network": {"iterations": 100}}
"""Settings that leave a solver what it promises, and take a tenth of the time."""

OF_QUALITY = 10
"""And all that solve problems of quality, whose truth takes a second each."""

TOLD_APART = 3e-7
"""Relative error of Clarabel's optima, see `tests.support.agreement`."""


@pytest.fixture(params=available_solvers())
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def made(name: str, **settings: Any) -> Solver:
    return make_solver(name, **QUICK.get(name, {}) | settings)


def answered(problem: GraspForceProblem, name: str) -> GraspForceSolution:
    return made(name).solve(problem)


def objectives(name: str) -> tuple[str, ...]:
    return made(name).objectives


def number(name: str, objective: str, most: int) -> int:
    times = max(SLOW.get(name, 1), OF_QUALITY if objective == MAX_QUALITY else 1)
    return max(most // times, 1)


@cache
def problems(objective: str, count: int) -> GraspForceProblem:
    """Every kind in turn, padded to the largest."""
    return GraspForceProblem.stack([problem(objective, k) for k in range(count)])


def problem(objective: str, k: int) -> GraspForceProblem:
    rng = seeded([37, k])
    if objective == MAX_QUALITY:
        # a budget below the least effort is one that nothing can keep
        return quality_problem(rng, 3 + k % 3, times=0.5 if k % 4 == 2 else 2.0)
    overrides = {"contacts": 3 + k % 4, "objective": objective} | list(VARIANTS.values())[
        k % len(VARIANTS)
    ]
    return random_problem(rng, **overrides)


@cache
def truth(objective: str, count: int) -> GraspForceSolution:
    judge = "quality_search" if objective == MAX_QUALITY else "clarabel"
    return solve(problems(objective, count), judge)


def usable(solution: GraspForceSolution) -> Any:
    return np.isin(solution.status, (Status.OPTIMAL.value, Status.FEASIBLE.value))


def bounded(one: GraspForceSolution, other: GraspForceSolution, factor: float = 1.0) -> bool:
    """No forces of the other are better than what the one proves that none can be."""
    value = np.asarray(other.objective)
    room = TOLD_APART * np.abs(value) + 1e-12 * np.asarray(other.verdict.size)
    below = factor * np.asarray(one.dual_bound) <= value + room
    # what is said to be infeasible has no bound worth the name
    return bool(np.all(below | ~usable(other) | (one.status == Status.INFEASIBLE.value)))


def agree(one: GraspForceSolution, other: GraspForceSolution, factor: float = 1.0) -> None:
    """Two answers to one problem, or to two whose optima differ by the factor."""
    denied = one.status == Status.INFEASIBLE.value
    assert not np.any(denied & usable(other))
    assert not np.any(usable(one) & (other.status == Status.INFEASIBLE.value))
    assert bounded(one, other, factor)
    assert bounded(other, one, 1.0 / factor)


def near(name: str, one: GraspForceSolution, other: GraspForceSolution, forces: Any) -> None:
    """Exact answers to one `min_norm` problem have one status, and forces as near as gaps tell."""
    if name in EXACT and one.problem.objective == "min_norm":
        settled = (one.status == "optimal") & (other.status == "optimal")
        # half the square of the distance from the optimum is at most what the objective exceeds it
        gaps = np.sqrt(np.abs(one.gap)) + np.sqrt(np.abs(other.gap)) + 1e-7
        size = np.linalg.norm(other.forces, axis=-1)
        apart = np.linalg.norm(other.forces - forces, axis=-1)
        assert np.all((apart <= gaps * size) | ~settled)


def cases(name: str, most: int) -> Iterator[tuple[Solver, GraspForceProblem, GraspForceSolution]]:
    for objective in objectives(name):
        count = number(name, objective, most)
        yield made(name), problems(objective, count), truth(objective, count)


def test_no_answer_is_wrong(name: str) -> None:
    for solver, batch, known in cases(name, 64):
        answer = solver.solve(batch)
        assert set(answer.status.tolist()) <= {str(status) for status in Status}
        # what others add up in another order, the judge and they may round apart
        assert strict(answer, usable(answer), 0.0 if name in STRUCTURED else 1e-15)
        assert np.all(np.isnan(answer.gap) == ~usable(answer))
        agree(answer, known)
        denied = answer.status == "infeasible"
        if batch.objective != MAX_QUALITY:
            assert np.all(proven(batch, answer)[denied])
        padding = ~np.repeat(batch.contact_mask, 3, axis=-1)
        assert np.all(answer.forces[padding & usable(answer)[:, None]] == 0.0)
        assert np.all(answer.message[answer.status == "failed"] != "")
        if name in EXACT:
            settled = np.isin(answer.status, ("optimal", "infeasible"))
            assert np.count_nonzero(~settled) <= 1
            assert {"optimal", "infeasible"} <= set(answer.status.tolist())


def test_known_forces_are_never_denied_nor_beaten_by_the_bound(name: str) -> None:
    """They often lie close to the edge of every constraint, so that there is hardly a choice."""
    for objective in set(objectives(name)) & set(OBJECTIVES):
        kinds = list(VARIANTS.values())
        found, values = [], []
        for k in range(number(name, objective, 10 * len(kinds))):
            rng = seeded([38, k])
            overrides = {"contacts": 3 + k % 4} | kinds[k % len(kinds)]
            drawn = random_problem(rng, objective=objective, **overrides)
            forces = forces_in_cones(rng, drawn)
            found.append(solved_by(rng, drawn, forces))
            values.append(float(objective_value(found[-1], forces)))
        answer = answered(GraspForceProblem.stack(found), name)
        assert not np.any(answer.status == "infeasible")
        allowed = np.array(values) * (1.0 + 1e-6) + 1e-9
        assert np.all(
            answer.dual_bound[answer.status != "failed"] <= allowed[answer.status != "failed"]
        )
        if name in EXACT:
            assert np.all((answer.objective <= allowed) | (answer.status != "optimal"))


def all_at_once(problem: GraspForceProblem, rng: np.random.Generator) -> Any:
    """Every change that all objectives bear."""
    steps = []
    for change in CHANGES:
        if change is not move_origin:
            problem, value, forces = change(problem, rng)
            steps.append((value, forces))

    def value_of(value: Any, linear: bool) -> Any:
        for step, _ in steps:
            value = step(value, linear)
        return value

    def forces_of(forces: Any) -> Any:
        for _, step in steps:
            forces = step(forces)
        return forces

    return problem, value_of, forces_of


WRITTEN = [
    (name, change)
    for name in available_solvers()
    for change in ([] if name in SLOW else [*CHANGES]) + [all_at_once]
]


@pytest.mark.parametrize(("name", "change"), WRITTEN)
def test_answers_do_not_depend_on_how_a_problem_is_written(name: str, change: Change) -> None:
    for objective in objectives(name):
        if objective == MAX_QUALITY and change is move_origin:
            continue  # q_lrw is about the centre of mass
        for k in range(number(name, objective, 8)):
            one = problem(objective, k)
            moved, value, forces = change(one, seeded([39, k]))
            before, after = answered(one, name), answered(moved, name)
            factor = float(value(1.0, objective != "min_norm"))
            agree(before, after, factor)
            near(name, before, after, forces(before.forces))
            if name in EXACT:
                assert after.status == before.status


def test_answers_do_not_depend_on_company_or_kind_of_array(name: str) -> None:
    for solver, batch, _ in cases(name, 24):
        together = solver.solve(batch)
        for index in range(0, len(batch), 5):
            alone = solver.solve(batch[index])
            for field in ("status", "message", "objective", "gap", "dual_bound"):
                assert np.shape(getattr(alone, field)) == ()
            agree(alone, solver.solve(batch[[index]]))
            member = solve_of(together, index)
            agree(alone, member)
            near(name, alone, member, alone.forces)
        shaped = solver.solve(batch[:4].reshape(2, -1)) if len(batch) >= 4 else together
        size = shaped.problem.batch_shape
        assert shaped.status.shape == shaped.gap.shape == shaped.message.shape == size
        assert shaped.forces.shape == (*size, 3 * batch.n_contacts)
        assert shaped.equilibrium_dual.shape == (*size, 6)
        assert shaped.torque_dual.shape == (*size, batch.n_joints)
        for dtype in (torch.float32, torch.float64):
            tensors = batch[:2].to_torch(dtype=dtype)
            answer = solver.solve(tensors)
            assert answer.problem is tensors
            assert answer.forces.dtype == answer.gap.dtype == dtype


def solve_of(solution: GraspForceSolution, index: int) -> GraspForceSolution:
    """One of a batch of answers."""
    verdict = type(solution.verdict)(
        **{
            field: value if value is None else value[index]
            for field, value in vars(solution.verdict).items()
        }
    )
    parts = {field: value[index] for field, value in vars(solution).items() if field != "verdict"}
    return GraspForceSolution(**parts, verdict=verdict)


def test_threads_change_no_byte(name: str) -> None:
    if "threads" not in signature(type(made(name))).parameters:
        with pytest.raises(SolverError, match="does not take these settings"):
            made(name, threads=2)
        return
    solvers = [made(name, threads=threads) for threads in (1, 2, 100)]
    for objective in objectives(name):
        # more than one chunk of the interior point, and of the ascent that is for `min_norm` alone
        for count in (1, 9, 2100 if objective == "min_norm" else 140):
            batch = random_batch(seeded(8), count, objective=objective)
            one, *others = [solver.solve(batch) for solver in solvers]
            for other in others:
                for field in ("forces", "equilibrium_dual", "torque_dual", "status"):
                    assert getattr(one, field).tobytes() == getattr(other, field).tobytes()


def test_an_empty_batch_has_an_empty_answer(name: str) -> None:
    for solver, batch, _ in cases(name, 2):
        for empty in (batch[:0], batch[:0].to_torch()):
            answer = solver.solve(empty)
            assert answer.status.shape == (0,)
            assert answer.forces.shape == (0, 3 * batch.n_contacts)
            assert answer.torque_dual.shape == (0, batch.n_joints)


def test_where_nothing_has_to_be_done_nothing_is(name: str) -> None:
    idle = {"external_wrench": np.zeros(6), "external_torque": 0.0, "normal_min": 0.0}
    for objective in set(objectives(name)) & set(OBJECTIVES):
        answer = answered(random_batch(seeded(1), 3, objective=objective, **idle), name)
        np.testing.assert_allclose(answer.forces, 0.0, atol=1e-8)
        if objective == "min_norm" or name in EXACT:
            assert np.all(answer.status == "optimal")
            for array in (answer.forces, answer.objective, answer.dual_bound, answer.gap):
                np.testing.assert_array_equal(array, 0.0)


def test_a_hand_without_joints(name: str) -> None:
    nothing = dict.fromkeys(("torque_min", "torque_max", "external_torque"), np.zeros(0))
    for objective in set(objectives(name)) & set(OBJECTIVES):
        drawn = [
            random_problem(
                seeded([40, k]), 4, objective=objective, hand_jacobian=np.zeros((12, 0)), **nothing
            )
            for k in range(number(name, objective, 12))
        ]
        batch = GraspForceProblem.stack(drawn)
        answer = answered(batch, name)
        agree(answer, solve(batch, "clarabel"))
        assert answer.torque_dual.shape == (len(batch), 0)
        assert np.all(answer.torque_violation() == 0.0)
        assert strict(answer, usable(answer), 0.0 if name in STRUCTURED else 1e-15)


def test_objectives_that_a_solver_lacks_are_refused(name: str) -> None:
    for objective in {*OBJECTIVES, MAX_QUALITY} - set(objectives(name)):
        with pytest.raises(SolverError, match=f"not {objective}; use the solver"):
            answered(problem(objective, 0), name)
