"""The strong simple baseline for quality: least-norm forces, and every contact pressed alike."""

import numpy as np

from solvers.base import Solver
from solvers.problem import MAX_QUALITY, GraspForceProblem
from solvers.solution import Candidate

from .flow import QualityPoint, even_shares, quality_point
from .preload import least_forces, without_padding

_SPENT = np.linspace(0.0, 1.0, 9)


class UniformPreloadSolver(Solver):
    """The least-norm forces with the largest preload, one for all contacts, that the budget allows.

    With an effort weight the best of a few efforts, evenly spread up to the budget, is spent.
    """

    objectives = (MAX_QUALITY,)

    def propose(self, problem: GraspForceProblem) -> Candidate:
        """All problems at once; NaN where there are no forces within the budget."""
        least = least_forces(problem)
        spare = np.maximum(problem.effort_budget - np.nan_to_num(least.effort), 0.0)

        def spending(share: float) -> QualityPoint:
            limit = problem.effort_budget - (1.0 - share) * spare
            return quality_point(problem, least, even_shares(problem), limit)

        best = spending(1.0)
        forces, utility = best.forces.forces, best.utility(problem)
        for share in _SPENT[:-1] if problem.effort_weight.any() else ():
            tried = spending(share)
            better = tried.utility(problem) > utility
            forces[better] = tried.forces.forces[better]
            utility = np.where(better, tried.utility(problem), utility)
        message = np.where(least.found, "", "no forces within the budget")
        return Candidate(without_padding(problem, forces), least.multipliers, message)
