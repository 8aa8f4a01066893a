"""The structured exact solver: Newton ascent on the dual, compiled, with exact repair."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from solvers.base import Solver
from solvers.compiled.newton.batch import Ascent, solve_batch
from solvers.judge import Status
from solvers.problem import GraspForceProblem, Multipliers
from solvers.registry import make_solver
from solvers.solution import Candidate

from .interior_point import InteriorPointSolver

FALLBACKS = ("interior_point", "clarabel")
"""Who answers, in turn, what the Newton ascent does not; Clarabel by the least violation, which
settles what lies closest to the edge of feasibility."""


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
    registers. The linear objectives, which have no curvature to ascend by, go to `interior_point`,
    as do the few problems that the ascent does not finish; `message` names who answered those. The
    first call compiles, once for a machine.

    Args:
        threads: of this process that share a batch; answers do not depend on it.

    Raises:
        SolverError: unless threads is a positive whole number.
    """

    def __init__(self, threads: int = 1) -> None:
        self._fallbacks: dict[str, Solver] = {"interior_point": InteriorPointSolver(threads)}
        self._threads = threads

    def propose(self, problem: GraspForceProblem) -> Candidate:
        """Forces and multipliers, or proofs, of a flat problem."""
        count = len(problem)
        if problem.objective == "min_norm":
            answer = solve_flat(problem, self._threads)
            forces, multipliers = (
                answer.forces,
                Multipliers(answer.equilibrium_dual, answer.torque_dual),
            )
            rows = np.flatnonzero(~answer.solved & ~answer.infeasible)
        else:
            forces = np.empty((count, 3 * problem.n_contacts))
            multipliers = Multipliers(np.empty((count, 6)), np.empty((count, problem.n_joints)))
            rows = np.arange(count)
        candidate = Candidate(forces, multipliers, np.zeros(count, dtype="U1"))
        return self._fall_back(problem, candidate, rows) if len(rows) else candidate

    def _fall_back(
        self, problem: GraspForceProblem, candidate: Candidate, rows: NDArray[np.intp]
    ) -> Candidate:
        """The candidate with each of `rows` answered by the first fallback that does not fail.

        Where all fail, the last attempt stays.
        """
        message = candidate.message.astype(object)
        for name in FALLBACKS:
            if name not in self._fallbacks:
                self._fallbacks[name] = make_solver(name)
            rest = self._fallbacks[name].solve(problem[rows])
            candidate.forces[rows] = rest.forces
            candidate.multipliers.equilibrium[rows] = rest.equilibrium_dual
            candidate.multipliers.torque[rows] = rest.torque_dual
            failed = rest.status == Status.FAILED.value
            # the linear objectives are the interior point's own
            own = name == "interior_point" and problem.objective != "min_norm"
            by = "" if own else f"answered by {name}"
            message[rows] = np.where(failed & (rest.message != ""), rest.message, by)
            rows = rows[failed]
            if not len(rows):
                break
        return dataclasses.replace(candidate, message=message.astype(np.str_))
