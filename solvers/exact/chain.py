"""Exact solvers in turn: each answers what the one before it fails at."""

import dataclasses

import numpy as np

from solvers.judge import Status
from solvers.problem import GraspForceProblem
from solvers.registry import make_solver
from solvers.solution import Candidate

from .interior_point import InteriorPointSolver


def answered_in_turn(problem: GraspForceProblem, threads: int = 1) -> Candidate:
    """Answers of `interior_point`, and of `clarabel` where the judge fails those.

    Clarabel settles by the least violation what lies closest to the edge of feasibility. Where it
    fails, too, its attempt stays. The messages name who answered, but for the interior point and
    the linear objectives, which are its own.

    Args:
        problem: flat, see `GraspForceProblem.flat`.
        threads: of this process; answers do not depend on it.
    """
    first, verdict = InteriorPointSolver(threads).judged(problem)
    failed = verdict.status == Status.FAILED.value
    by = "answered by interior_point" if problem.objective == "min_norm" else ""
    message = np.where(failed & (first.message != ""), first.message, by).astype(object)
    rows = np.flatnonzero(failed)
    if len(rows):
        rest, verdict = make_solver("clarabel").judged(problem[rows].flat())
        first.forces[rows] = rest.forces
        first.multipliers.equilibrium[rows] = rest.multipliers.equilibrium
        first.multipliers.torque[rows] = rest.multipliers.torque
        failed = verdict.status == Status.FAILED.value
        words = failed & (rest.message != "")
        message[rows] = np.where(words, rest.message, "answered by clarabel")
    return dataclasses.replace(first, message=message.astype(np.str_))
