"""What a solver is: an object that proposes forces for a batch of problems, and is judged."""

import dataclasses
from abc import ABC, abstractmethod

import numpy as np

from solvers.exceptions import SolverError
from solvers.judge import Status, Verdict
from solvers.problem import (
    MAX_QUALITY,
    OBJECTIVES,
    GraspForceProblem,
    Multipliers,
    as_problem,
    force_scale,
    moved_inwards,
    needs_no_force,
)
from solvers.solution import (
    Candidate,
    GraspForceSolution,
    finished,
    judge_candidate,
    nearly_feasible,
)

_INWARDS = 1e-9
"""By how much the limits are moved, relative to the force scale."""


class Solver(ABC):
    """Base of all solvers. A subclass says which objectives it solves and proposes candidates."""

    objectives: tuple[str, ...] = OBJECTIVES

    @abstractmethod
    def propose(self, problem: GraspForceProblem) -> Candidate:
        """Forces and multipliers for a float64 numpy problem with one batch dimension."""

    def solve(self, problem: GraspForceProblem) -> GraspForceSolution:
        """Solve one problem or a batch; the answer is judged independently of the solver.

        Forces that miss a constraint by no more than a numerical solver's tolerance are moved
        inside first, see `solvers.solution.finish`.

        Raises:
            ProblemError: for what is no problem.
            SolverError: if this solver lacks the problem's objective.
        """
        return GraspForceSolution.packed(problem, *self.judged(as_problem(problem).flat()))

    def judged(self, problem: GraspForceProblem) -> tuple[Candidate, Verdict]:
        """`solve` for a flat problem, see `GraspForceProblem.flat`: the answer is not packed."""
        if problem.objective not in self.objectives:
            raise SolverError(
                f"{type(self).__name__} solves {' and '.join(self.objectives)}, "
                f"not {problem.objective}; use the solver "
                + ("'quality_search'" if problem.objective == MAX_QUALITY else "'dual_newton'")
            )
        candidate = self.propose(problem)
        verdict = judge_candidate(problem, candidate)
        near = nearly_feasible(verdict)
        if near.any():
            candidate = finished(problem, candidate, np.flatnonzero(near))
            verdict = judge_candidate(problem, candidate)
        return _explained(candidate, verdict), verdict


def _explained(candidate: Candidate, verdict: Verdict) -> Candidate:
    """The candidate with a reason for every failure that the solver says nothing about."""
    failed = verdict.status == Status.FAILED.value
    if not failed.any():
        return candidate
    silent = failed & (candidate.message == "")
    answered = np.isfinite(verdict.equilibrium_residual)
    reason = np.where(
        answered,
        "the forces miss a constraint, and the multipliers prove nothing",
        "the solver ended with neither forces nor a proof",
    )
    return dataclasses.replace(candidate, message=np.where(silent, reason, candidate.message))


class InstanceSolver(Solver):
    """A solver that works through a batch one problem at a time."""

    @abstractmethod
    def propose_one(self, problem: GraspForceProblem) -> Candidate:
        """Forces and multipliers for one float64 numpy problem without padding contacts."""

    def propose(self, problem: GraspForceProblem) -> Candidate:
        """The candidates of all problems; where zero forces hold, they are the optimum.

        The problems are handed over with their limits moved inwards by `_INWARDS`, so that what a
        numerical tolerance lets through still keeps the true ones.
        """
        count, n, n_tau = len(problem), problem.n_contacts, problem.n_joints
        idle = needs_no_force(problem)
        scale = _INWARDS * force_scale(problem)[:, None]
        lever = np.linalg.norm(problem.hand_jacobian, axis=-2)
        problem = moved_inwards(problem, _INWARDS, scale, (scale * lever, scale * lever))
        forces = np.zeros((count, n, 3))
        equilibrium = np.full((count, 6), np.nan)
        torque = np.full((count, n_tau), np.nan)
        messages = []
        for index in range(count):
            one = problem[index]
            mask = one.contact_mask
            one = one.without_padding()
            candidate = _no_force(one) if idle[index] else self.propose_one(one)
            forces[index, mask] = candidate.forces.reshape(-1, 3)
            equilibrium[index] = candidate.multipliers.equilibrium
            torque[index] = candidate.multipliers.torque
            messages.append(str(candidate.message))
        return Candidate(
            forces=forces.reshape(count, 3 * n),
            multipliers=Multipliers(equilibrium, torque),
            message=np.array(messages, dtype=np.str_),
        )


def _no_force(problem: GraspForceProblem) -> Candidate:
    multipliers = Multipliers(np.zeros(6), np.zeros(problem.n_joints))
    return Candidate(np.zeros(3 * problem.n_contacts), multipliers, np.array(""))
