"""Ground truth: the problem as a second-order cone program for Clarabel.

Goulart and Chen, "Clarabel: An interior-point solver for conic programs with quadratic objectives",
2024.
"""

import clarabel
import numpy as np

from solvers.base import InstanceSolver
from solvers.conic import ConicProgram
from solvers.exceptions import SolverError
from solvers.judge import Status, judge
from solvers.problem import GraspForceProblem
from solvers.solution import Candidate, nearly_feasible


class ClarabelSolver(InstanceSolver):
    """Interior-point solution in float64, one problem after the other.

    Args:
        tolerance: relative accuracy asked of Clarabel for gap and feasibility.

    Raises:
        SolverError: if the tolerance is not between 0 and 1.
    """

    def __init__(self, tolerance: float = 1e-10) -> None:
        if not 0.0 < tolerance < 1.0:
            raise SolverError(f"tolerance must lie between 0 and 1, not {tolerance}")
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.max_threads = 1
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
        settings.tol_infeas_abs = settings.tol_infeas_rel = 1e-10
        self._settings = settings

    def propose_one(self, problem: GraspForceProblem) -> Candidate:
        """Forces and multipliers of one problem; on infeasibility, a Farkas vector.

        At the edge of feasibility Clarabel ends with too little accuracy for the judge. The least
        violation is a program that always has a solution: its forces, or its dual, then settle it.
        """
        program = ConicProgram(problem)
        solution = clarabel.DefaultSolver(*program.data(), self._settings).solve()
        status = str(solution.status)
        message = np.array("" if status == "Solved" else f"Clarabel ended with {status}")
        forces = program.forces(np.array(solution.x))
        none = np.full_like(forces, np.nan)
        multipliers = program.multipliers(np.array(solution.z))
        first = Candidate(none if "Infeasible" in status else forces, multipliers, message)
        if status == "Solved" or _accepted(problem, first):
            return first
        solution = clarabel.DefaultSolver(*program.least_violation_data(), self._settings).solve()
        forces = program.forces(np.array(solution.x)[:-1])
        proof = program.violation_multipliers(np.array(solution.z))
        others = (Candidate(forces, multipliers, message), Candidate(none, proof, message))
        return next((other for other in others if _accepted(problem, other)), first)


def _accepted(problem: GraspForceProblem, candidate: Candidate) -> bool:
    """An answer, or one that its last step will make so."""
    verdict = judge(problem, candidate.forces, candidate.multipliers)
    return bool(verdict.status != Status.FAILED) or bool(nearly_feasible(verdict))
