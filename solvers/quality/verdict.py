"""The judge's verdict on forces that are to have the most quality for their effort."""

import dataclasses

import numpy as np

from solvers.arguments import plain_array
from solvers.arrays import Array
from solvers.exceptions import ProblemError
from solvers.judge import GAP_TOLERANCE, Status, Verdict, judge_flat
from solvers.problem import MAX_QUALITY, GraspForceProblem, Multipliers, as_problem

from .friction_discs import FrictionDiscs, SupportBounds, support_bounds
from .proof import CoverProof, proven_bound

Proofs = tuple[tuple[CoverProof, ...], ...]

QUALITY_WIDTH = 0.01
"""Relative width of the interval that the judge finds q_lrw to lie in."""

_EDGES = 6
_BUDGET_TOLERANCE = 1e-12
_MINIMUM_TOLERANCE = 1e-9


def judge_quality(
    problem: GraspForceProblem,
    forces: Array,
    multipliers: Multipliers,
    proofs: Proofs | None = None,
) -> Verdict:
    """Measure forces against a flat problem `max_quality`, trusting nothing that a solver said.

    Feasible forces satisfy the constraints as for every objective, and the budget up to rounding.
    The objective is what they are worth at least, effort_weight * effort less the lower end of the
    interval of q_lrw; the bound is that of `solvers.quality.proof.proven_bound`. No forces exist
    where the multipliers prove it, or that the least effort exceeds the budget.

    Args:
        problem: see `GraspForceProblem.flat`.
        forces: (B, 3n) N.
        multipliers: of the convex problem of least effort.
        proofs: of each problem.

    Raises:
        ProblemError: for another objective, a problem that is not flat, or arrays or proofs for
            another number of problems.
    """
    _for_quality(problem)
    if proofs and len(proofs) != len(problem):
        raise ProblemError(f"there are proofs of {len(proofs)} problems, not of {len(problem)}")
    verdict = judge_flat(problem.constraints("sum_normal"), forces, multipliers)
    held = np.isin(verdict.status, (Status.FEASIBLE.value, Status.OPTIMAL.value))
    held &= verdict.objective <= problem.effort_budget * (1.0 + _BUDGET_TOLERANCE)
    none = verdict.status == Status.INFEASIBLE.value
    none |= verdict.dual_bound > problem.effort_budget * (1.0 + _MINIMUM_TOLERANCE)
    held &= ~none
    count = len(problem)
    lower, upper = np.full(count, np.nan), np.full(count, np.nan)
    bound = np.full(count, -np.inf)
    for index in range(count):
        one = problem[index].without_padding()
        if held[index]:
            normal = np.asarray(forces)[index, 2::3][problem.contact_mask[index]]
            interval = quality_bounds(one, normal)
            lower[index], upper[index] = interval.lower, interval.upper
        bound[index] = proven_bound(
            one, proofs[index] if proofs else (), float(verdict.dual_bound[index])
        )
    value = problem.effort_weight * verdict.objective - lower
    excess = value - bound
    with np.errstate(divide="ignore", invalid="ignore"):
        gap = np.where(excess == 0.0, 0.0, excess / np.abs(value))
    status = np.full(count, Status.FAILED.value, dtype=verdict.status.dtype)
    status[none] = Status.INFEASIBLE.value
    status[held] = np.where(gap[held] <= GAP_TOLERANCE, Status.OPTIMAL.value, Status.FEASIBLE.value)
    return dataclasses.replace(
        verdict,
        status=status,
        objective=np.where(held, value, np.nan),
        dual_bound=bound,
        gap=np.where(held, gap, np.nan),
        quality_lower=lower,
        quality_upper=upper,
    )


def quality_bounds(problem: GraspForceProblem, normal: Array) -> SupportBounds:
    """q_lrw of normal forces (n,) N, refined until bounds are within `QUALITY_WIDTH` of each other.

    Args:
        problem: one float64 numpy problem without padding, `max_quality`.
        normal: N, of feasible forces.

    Raises:
        ProblemError: for another objective, a batch, or another number of normal forces.
    """
    _for_quality(problem).plain_arrays(0)
    normal = plain_array("normal", normal, (problem.n_contacts,))
    pressing = normal > 0.0
    discs = FrictionDiscs.of_grasp_map(
        problem.grasp_map, problem.friction, normal, float(problem.characteristic_length)
    )
    return support_bounds(
        discs[pressing], _EDGES, lambda lower, upper: upper - lower <= QUALITY_WIDTH * upper
    )


def _for_quality(problem: GraspForceProblem) -> GraspForceProblem:
    if as_problem(problem).objective != MAX_QUALITY:
        raise ProblemError(f"quality is that of {MAX_QUALITY} problems, not of {problem.objective}")
    return problem
