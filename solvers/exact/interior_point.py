"""The structured interior-point solver: exact, compiled, for every convex objective."""

import numpy as np

from solvers.base import Solver
from solvers.compiled.interior import batch as interior
from solvers.exceptions import SolverError
from solvers.problem import GraspForceProblem, Multipliers
from solvers.solution import Candidate

_MESSAGES = {
    interior.SOLVED: "",
    interior.INFEASIBLE: "",
    interior.INEXACT: "the constraints leave little room: some, or the optimum, may be missed",
    interior.FAILED: "the interior-point path ended with neither forces nor a proof",
}


def checked_threads(threads: int) -> int:
    """The number of threads, if it is one.

    Raises:
        SolverError: otherwise.
    """
    if isinstance(threads, bool) or not isinstance(threads, int) or threads < 1:
        raise SolverError(f"threads must be a whole number of at least 1, not {threads!r}")
    return threads


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
        self._threads = checked_threads(threads)

    def propose(self, problem: GraspForceProblem) -> Candidate:
        """The kernel's answers, in the problem's own units."""
        forces, nu, price, code = interior.solve_batch(problem, self._threads)
        real = np.repeat(problem.contact_mask, 3, axis=-1)
        return Candidate(
            forces=np.where(real, forces, 0.0),
            multipliers=Multipliers(nu, price),
            message=np.array([_MESSAGES[one] for one in code.tolist()], dtype=np.str_),
        )
