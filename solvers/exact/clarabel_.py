"""Ground truth: the problem as a second-order cone program for Clarabel.

Goulart and Chen, "Clarabel: An interior-point solver for conic programs with quadratic objectives",
2024.
"""

from functools import partial

import numpy as np

from solvers.arguments import real_number
from solvers.base import InstanceSolver
from solvers.conic import ConicProgram, solve
from solvers.judge import Status, judge
from solvers.problem import GraspForceProblem
from solvers.solution import Candidate, nearly_feasible

_INFEASIBLE = 1e-10
"""Accuracy asked of proofs."""


class ClarabelSolver(InstanceSolver):
    """Interior-point solution in float64, one problem after the other.

    Args:
        tolerance: relative accuracy asked of Clarabel for gap and feasibility.

    Raises:
        SolverError: if the tolerance is not between 0 and 1.
    """

    def __init__(self, tolerance: float = 1e-10) -> None:
        tolerance = real_number("tolerance", tolerance, 0.0, 1.0)
        self._solve = partial(solve, tolerance=tolerance, infeasible=_INFEASIBLE)

    def propose_one(self, problem: GraspForceProblem) -> Candidate:
        """Forces and multipliers of one problem; on infeasibility, a Farkas vector.

        At the edge of feasibility Clarabel ends with too little accuracy for the judge. The least
        violation is a program that always has a solution: its forces, or its dual, then settle it.
        """
        program = ConicProgram(problem)
        outcome = self._solve(*program.data())
        status = outcome.status
        message = np.array("" if status == "Solved" else f"Clarabel ended with {status}")
        forces = program.forces(outcome.x)
        none = np.full_like(forces, np.nan)
        multipliers = program.multipliers(outcome.dual)
        first = Candidate(none if "Infeasible" in status else forces, multipliers, message)
        if status == "Solved" or _accepted(problem, first):
            return first
        outcome = self._solve(*program.least_violation_data())
        forces = program.forces(outcome.x[:-1])
        proof = program.violation_multipliers(outcome.dual)
        others = (Candidate(forces, multipliers, message), Candidate(none, proof, message))
        return next((other for other in others if _accepted(problem, other)), first)


def _accepted(problem: GraspForceProblem, candidate: Candidate) -> bool:
    """An answer, or one that its last step will make so."""
    verdict = judge(problem, candidate.forces, candidate.multipliers)
    return bool(verdict.status != Status.FAILED) or bool(nearly_feasible(verdict))
