"""The structured exact solver: Newton ascent on the dual, compiled, with exact repair."""

import numpy as np

from solvers.arguments import whole_number
from solvers.base import Solver
from solvers.compiled.newton.batch import Ascent, solve_batch
from solvers.problem import GraspForceProblem, Multipliers
from solvers.solution import Candidate

from .chain import answered_in_turn


def solve_flat(problem: GraspForceProblem, threads: int = 1) -> Ascent:
    """The ascent alone: neither judged nor handed on to a fallback, for searches and losses.

    Args:
        problem: flat, see `GraspForceProblem.flat`; `min_norm`.
        threads: of this process; answers do not depend on it.
    """
    return solve_batch(problem, threads)


class DualNewtonSolver(Solver):
    """Globalised semismooth Newton on the dual of `min_norm`, see `solvers.compiled.newton.ascent`.

    The dual has six variables and the torque limits in play, whatever the number of contacts.
    Forces satisfy every inequality exactly in float64, and equilibrium to rounding; where there are
    none, the multipliers are the proof. Eight problems are solved side by side in the lanes of SIMD
    registers. The linear objectives, which have no curvature to ascend by, go to `interior_point`
    and what it fails at to `clarabel`, as do the few problems that the ascent does not finish;
    `message` names who answered those. The first call compiles, once for a machine.

    Args:
        threads: of this process that share a batch; answers do not depend on it.

    Raises:
        SolverError: unless threads is a positive whole number.
    """

    def __init__(self, threads: int = 1) -> None:
        self._threads = whole_number("threads", threads, 1)

    def propose(self, problem: GraspForceProblem) -> Candidate:
        """Forces and multipliers, or proofs, of a flat problem."""
        if problem.objective != "min_norm":
            return answered_in_turn(problem, self._threads)
        answer = solve_flat(problem, self._threads)
        nu, price = answer.equilibrium_dual, answer.torque_dual
        message = np.zeros(len(problem), dtype="U1")
        rows = np.flatnonzero(~answer.solved & ~answer.infeasible)
        if len(rows):
            rest = answered_in_turn(problem[rows].flat(), self._threads)
            answer.forces[rows] = rest.forces
            nu[rows], price[rows] = rest.multipliers.equilibrium, rest.multipliers.torque
            message = message.astype(rest.message.dtype)
            message[rows] = rest.message
        return Candidate(answer.forces, Multipliers(nu, price), message)
