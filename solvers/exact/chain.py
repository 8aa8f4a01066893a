"""Exact solvers in turn: each answers what the one before it leaves open."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from solvers.judge import Status, Verdict
from solvers.problem import GraspForceProblem
from solvers.registry import make_solver
from solvers.solution import Candidate

from .interior_point import InteriorPointSolver


def answered_in_turn(problem: GraspForceProblem, threads: int = 1) -> Candidate:
    """Answers of `interior_point`, and of `clarabel` where it does better on those left unsettled.

    Unsettled is what the judge fails, and what it finds feasible and no more. Clarabel settles by
    the least violation what lies closest to the edge of feasibility. Where it does no better, the
    first attempt stays. The messages name who answered, but for the interior point and the linear
    objectives, which are its own.

    Args:
        problem: flat, see `GraspForceProblem.flat`.
        threads: of this process; answers do not depend on it.
    """
    first, verdict = InteriorPointSolver(threads).judged(problem)
    by = "answered by interior_point" if problem.objective == "min_norm" else ""
    failed = verdict.status == Status.FAILED.value
    message = np.where(failed & (first.message != ""), first.message, by).astype(object)
    rows = np.flatnonzero(failed | (verdict.status == Status.FEASIBLE.value))
    if len(rows):
        rest, other = make_solver("clarabel").judged(problem[rows].flat())
        better = _rank(other) < _rank(verdict)[rows]
        better |= (_rank(other) == _rank(verdict)[rows]) & (
            other.objective < verdict.objective[rows]
        )
        rows, own = rows[better], np.flatnonzero(better)
        first.forces[rows] = rest.forces[own]
        first.multipliers.equilibrium[rows] = rest.multipliers.equilibrium[own]
        first.multipliers.torque[rows] = rest.multipliers.torque[own]
        message[rows] = "answered by clarabel"
    return dataclasses.replace(first, message=message.astype(np.str_))


def _rank(verdict: Verdict) -> NDArray[np.intp]:
    """(B,) how much is settled: 0 for an optimum or a proof, 1 for forces, 2 for nothing."""
    failed = verdict.status == Status.FAILED.value
    return np.where(failed, 2, np.where(verdict.status == Status.FEASIBLE.value, 1, 0))
