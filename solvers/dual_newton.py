"""The structured exact solver: Newton ascent on the dual, compiled, with exact repair."""

import numpy as np

from .base import Solver
from .certificates import Multipliers
from .compiled import newton
from .compiled.batch import solve_batch
from .interior_point import InteriorPointSolver
from .judge import Status
from .problem import GraspForceProblem
from .registry import make_solver
from .solution import Candidate

FALLBACKS = ("interior_point", "clarabel")
"""Who answers, in turn, what the Newton ascent does not; Clarabel by the least violation, which
settles what lies closest to the edge of feasibility."""


class DualNewtonSolver(Solver):
    """Globalised semismooth Newton on the dual of `min_norm`, see `solvers.compiled.newton`.

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
        if problem.objective == "min_norm":
            answer = solve_batch(problem, self._threads)
            candidate = Candidate(
                answer.forces,
                Multipliers(answer.nu, answer.price),
                np.zeros(len(problem), dtype="U1"),
            )
            open_ = (answer.code != newton.SOLVED) & (answer.code != newton.INFEASIBLE)
            fallbacks: tuple[str, ...] = FALLBACKS
        else:
            candidate = self._fallbacks["interior_point"].propose(problem)
            open_ = candidate.message != ""
            fallbacks = FALLBACKS[1:]
        return self._fall_back(problem, candidate, open_, fallbacks) if open_.any() else candidate

    def _fall_back(
        self,
        problem: GraspForceProblem,
        candidate: Candidate,
        open_: np.ndarray,
        fallbacks: tuple[str, ...],
    ) -> Candidate:
        """The candidate with the open rows answered by the first fallback that has an answer."""
        forces, multipliers = candidate.forces, candidate.multipliers
        message = candidate.message.astype(object)
        rows = np.flatnonzero(open_)
        for name in fallbacks:
            if name not in self._fallbacks:
                self._fallbacks[name] = make_solver(name)
            rest = self._fallbacks[name].solve(problem[rows])
            answered = rest.status != Status.FAILED.value
            last = answered | (name == fallbacks[-1])
            into = rows[last]
            forces[into] = rest.forces[last]
            multipliers.equilibrium[into] = rest.equilibrium_dual[last]
            multipliers.torque[into] = rest.torque_dual[last]
            by = f"answered by {name}"
            message[into] = np.where(answered, by, np.where(rest.message == "", by, rest.message))[
                last
            ]
            rows = rows[~last]
            if not len(rows):
                break
        return Candidate(forces, multipliers, message.astype(np.str_))
