"""How good the network is before anybody helps it, and how many Newton steps it saves."""

from dataclasses import dataclass

import numpy as np

from solvers import GraspForceProblem, GraspForceSolution, make_solver
from solvers.arrays import Array
from solvers.duality import dual_bound
from solvers.exact.polish import dual_residual, polished
from solvers.exact.torch_newton import cold_start
from solvers.problem import Multipliers, canonical

from .problem_sets import ProblemSet

CERTIFIED = 1e-6
"""Relative gap of a certified answer."""

STEP_GOAL = 1e-9
"""Size of the dual's gradient, in canonical units, at which Newton steps stop being counted."""

MOST_STEPS = 40


@dataclass(frozen=True, eq=False)
class NetworkAccuracy:
    """The network on feasible problems, unless something else is said.

    Args:
        dual_gap: (F,) (optimum - dual bound) / optimum of its multipliers, nothing repaired.
        feasible_share: of feasible problems, with its own repair alone.
        gap: certified gaps of these.
        polished_gap: certified gaps after two Newton steps.
        polished_share: of feasible problems that two Newton steps and repair answer feasibly.
        settled: share of all problems that it, with its fallback, settles: certified to
            `CERTIFIED`, or proven infeasible.
        steps: (F,) Newton steps to `STEP_GOAL` from its answer, `MOST_STEPS` if never.
        cold_steps: (F,) the same from the start that needs no network.
        train_ratio: median dual gap over that on train objects; None without train problems.
    """

    dual_gap: Array
    feasible_share: float
    gap: Array
    polished_gap: Array
    polished_share: float
    settled: float
    steps: Array
    cold_steps: Array
    train_ratio: float | None


def network_accuracy(held_out: ProblemSet, train: ProblemSet | None) -> NetworkAccuracy | None:
    """Measure the network of `conditioned` on a set, and its dual gap on another.

    None if no problem of the set is known to be feasible.
    """
    rows = np.flatnonzero(np.isfinite(held_out.optimum))
    if not len(rows):
        return None
    problems = held_out.problems[rows]
    raw = make_solver("conditioned", polish_steps=0, fallback=None)
    proposed = raw.propose(problems)
    answer = raw.solve(problems)
    polished_answer = make_solver("conditioned", polish_steps=2, fallback=None).solve(problems)
    whole = make_solver("conditioned").solve(held_out.problems)
    dual_gap = _dual_gap(problems, proposed.multipliers, held_out.optimum[rows])
    ratio = None
    if train is not None and np.isfinite(train.optimum).any():
        seen = np.flatnonzero(np.isfinite(train.optimum))
        there = raw.propose(train.problems[seen]).multipliers
        seen_gap = np.median(_dual_gap(train.problems[seen], there, train.optimum[seen]))
        ratio = float(np.median(dual_gap) / seen_gap) if seen_gap > 0 else None
    form = canonical(problems)
    return NetworkAccuracy(
        dual_gap=dual_gap,
        feasible_share=_feasible_share(answer),
        gap=_gaps(answer),
        polished_gap=_gaps(polished_answer),
        polished_share=_feasible_share(polished_answer),
        settled=float(np.mean((whole.gap <= CERTIFIED) | (whole.status == "infeasible"))),
        steps=steps_to_gradient(form.problem, form.scaled(proposed.multipliers.map(np.nan_to_num))),
        cold_steps=steps_to_gradient(form.problem, cold_start(form.problem)),
        train_ratio=ratio,
    )


def steps_to_gradient(problem: GraspForceProblem, start: Multipliers) -> Array:
    """(B,) Newton steps on the dual until its gradient is below `STEP_GOAL`."""
    steps = np.full(len(problem), float(MOST_STEPS))
    rows = np.arange(len(problem))
    here = start
    for step in range(MOST_STEPS):
        done = dual_residual(problem[rows], here) < STEP_GOAL
        steps[rows[done]] = step
        rows = rows[~done]
        if not len(rows):
            break
        here = polished(problem[rows], here[~done], 1)
    return steps


def _dual_gap(problem: GraspForceProblem, multipliers: Multipliers, optimum: Array) -> Array:
    # a bound below zero says no more than zero does: forces have no negative size
    bound = np.maximum(dual_bound(problem, multipliers.map(np.nan_to_num)), 0.0)
    return (optimum - bound) / optimum


def _feasible_share(answer: GraspForceSolution) -> float:
    return float(np.mean(np.isin(answer.status, ("optimal", "feasible"))))


def _gaps(answer: GraspForceSolution) -> Array:
    gap = np.asarray(answer.gap)
    return gap[np.isfinite(gap)]
