"""The structured interior-point solver: exact, compiled, for every convex objective."""

import numpy as np

from solvers.arguments import whole_number
from solvers.base import Solver
from solvers.compiled.interior import batch as interior
from solvers.problem import GraspForceProblem, Multipliers
from solvers.solution import Candidate

_MESSAGES = {
    interior.SOLVED: "",
    interior.INFEASIBLE: "",
    interior.INEXACT: "the constraints leave little room: some, or the optimum, may be missed",
    interior.FAILED: "the interior-point path ended with neither forces nor a proof",
}


class InteriorPointSolver(Solver):
    """Mehrotra's predictor and corrector with Nesterov-Todd scaling on a homogeneous embedding.

    Forces satisfy every inequality exactly in float64 and equilibrium to rounding, as they come
    from a problem that is tightened by 1e-10 of the force scale; multipliers certify a relative gap
    of a few 1e-10. Where no forces exist the multipliers are the proof. Answers do not depend on
    the batch, nor on the number of threads. The first call compiles, once for a machine.

    Args:
        threads: of this process that share a batch.

    Raises:
        SolverError: unless threads is a positive whole number.
    """

    def __init__(self, threads: int = 1) -> None:
        self._threads = whole_number("threads", threads, 1)

    def propose(self, problem: GraspForceProblem) -> Candidate:
        """The kernel's answers, in the problem's own units."""
        forces, nu, price, code = interior.solve_batch(problem, self._threads)
        real = np.repeat(problem.contact_mask, 3, axis=-1)
        return Candidate(
            forces=np.where(real, forces, 0.0),
            multipliers=Multipliers(nu, price),
            message=np.array([_MESSAGES[one] for one in code.tolist()], dtype=np.str_),
        )
