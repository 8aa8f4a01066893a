"""The strong simple baseline for quality: least-norm forces, and every contact pressed alike."""

import numpy as np

from .base import Solver
from .dual_newton import DualNewtonSolver
from .judge import Status
from .problem import MAX_QUALITY, GraspForceProblem
from .quality_directions import estimated_quality
from .solution import Candidate, judge_candidate

_BISECTIONS = 40
_SHARES = np.linspace(0.0, 1.0, 9)[:-1]


class UniformPreloadSolver(Solver):
    """The least-norm forces with the largest preload, one for all contacts, that the budget allows.

    With an effort weight the preload is the best of a few, evenly spread up to that.
    """

    objectives = (MAX_QUALITY,)

    def propose(self, problem: GraspForceProblem) -> Candidate:
        """A bisection of the preload, all problems at once."""
        count = problem.contact_mask.sum(axis=-1)
        low, high = np.zeros(len(problem)), problem.effort_budget / count
        best = self._forces(problem, low)
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            tried = self._forces(problem, middle)
            fits = np.isfinite(tried.forces).all(axis=-1)
            fits &= tried.forces[:, 2::3].sum(axis=-1) <= problem.effort_budget
            low, high = np.where(fits, middle, low), np.where(fits, high, middle)
            best.forces[fits] = tried.forces[fits]
        return self._priced(problem, low, best) if problem.effort_weight.any() else best

    def _priced(self, problem: GraspForceProblem, most: np.ndarray, best: Candidate) -> Candidate:
        """The best of a few preloads up to the largest ones (B,) N, where effort has a price."""
        worth = self._worth(problem, best)
        for share in _SHARES:
            tried = self._forces(problem, share * most)
            value = self._worth(problem, tried)
            better = value > worth
            best.forces[better], worth[better] = tried.forces[better], value[better]
        return best

    def _worth(self, problem: GraspForceProblem, candidate: Candidate) -> np.ndarray:
        """(B,) N: quality, estimated, less the price of effort; -inf without forces."""
        worth = np.full(len(problem), -np.inf)
        for index in np.flatnonzero(np.isfinite(candidate.forces).all(axis=-1)):
            normal = candidate.forces[index, 2::3]
            quality = estimated_quality(problem[index], normal)
            worth[index] = quality - problem.effort_weight[index] * normal.sum()
        return worth

    def _forces(self, problem: GraspForceProblem, preload: np.ndarray) -> Candidate:
        """Least-norm forces with that preload (B,) N; NaN where there are none."""
        raised = np.minimum(preload[:, None] * problem.contact_mask, problem.normal_max)
        pressed = problem.constraints().derived(normal_min=np.maximum(problem.normal_min, raised))
        candidate = DualNewtonSolver().propose(pressed)
        verdict = judge_candidate(pressed, candidate)
        held = np.isin(verdict.status, (Status.OPTIMAL.value, Status.FEASIBLE.value))
        candidate.forces[~held] = np.nan
        return candidate
