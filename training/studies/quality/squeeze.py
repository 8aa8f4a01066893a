"""The equal squeeze made feasible: the forces of a problem that lie nearest to it."""

import numpy as np
from numpy.typing import NDArray

from solvers import GraspForceProblem
from solvers.base import Solver
from solvers.conic import ConicProgram, solve
from solvers.max_quality.preload import effort, least_forces, within
from solvers.problem import MAX_QUALITY, force_scale
from solvers.solution import Candidate


class NearestSqueezeSolver(Solver):
    """Every contact presses with the same share of the budget, then all give way to feasibility.

    The nearest forces that satisfy the constraints are a second-order cone program for Clarabel;
    where they exceed the budget, the mean with the least forces that meets it is taken.
    """

    objectives = (MAX_QUALITY,)

    def propose(self, problem: GraspForceProblem) -> Candidate:
        """One problem after the other; the least forces where Clarabel has no answer."""
        least = least_forces(problem)
        nearest = least.forces.copy()
        for index in np.flatnonzero(least.found):
            columns = np.repeat(problem.contact_mask[index], 3)
            one = problem[index].without_padding()
            forces = _nearest(one, float(one.effort_budget) / one.n_contacts)
            if forces is not None:
                nearest[index, columns] = forces
        return Candidate(
            within(least.forces, nearest, problem.effort_budget),
            least.multipliers,
            np.where(np.isfinite(effort(nearest)), "", "no forces within the budget"),
        )


def _nearest(problem: GraspForceProblem, normal: float) -> NDArray[np.float64] | None:
    """(3n,) N nearest to pure normal forces of that size; None if Clarabel finds none."""
    convex = problem.constraints()
    program = ConicProgram(convex)
    quadratic, linear, *rest = program.data()
    linear = np.array(linear, dtype=np.float64)
    linear[2::3] -= normal / float(force_scale(convex))
    outcome = solve(quadratic, linear, *rest)
    return np.asarray(program.forces(outcome.x)) if outcome.solved else None
