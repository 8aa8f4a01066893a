"""What a solver is: an object that proposes forces for a batch of problems, and is judged."""

from abc import ABC, abstractmethod

import numpy as np

from .certificates import Multipliers
from .exceptions import SolverError
from .problem import OBJECTIVES, GraspForceProblem
from .solution import Candidate, GraspForceSolution


class Solver(ABC):
    """Base of all solvers. A subclass says which objectives it solves and proposes candidates."""

    objectives: tuple[str, ...] = OBJECTIVES

    @abstractmethod
    def propose(self, problem: GraspForceProblem) -> Candidate:
        """Forces and multipliers for a float64 numpy problem with one batch dimension."""

    def solve(self, problem: GraspForceProblem) -> GraspForceSolution:
        """Solve one problem or a batch; the answer is judged independently of the solver.

        Raises:
            SolverError: if this solver lacks the problem's objective.
        """
        if problem.objective not in self.objectives:
            raise SolverError(
                f"{type(self).__name__} solves {' and '.join(self.objectives)}, "
                f"not {problem.objective}; use the solver 'clarabel'"
            )
        batch = problem.batch_shape
        candidate = self.propose(problem.to_numpy().reshape(int(np.prod(batch, dtype=int))))

        def unflatten(array: np.ndarray) -> np.ndarray:
            return array.reshape(batch + array.shape[1:])

        shaped = Candidate(
            forces=unflatten(candidate.forces),
            multipliers=Multipliers(
                unflatten(candidate.multipliers.equilibrium),
                unflatten(candidate.multipliers.torque),
            ),
            message=unflatten(candidate.message),
        )
        return GraspForceSolution.from_candidate(problem, shaped)


class InstanceSolver(Solver):
    """A solver that works through a batch one problem at a time."""

    @abstractmethod
    def propose_one(self, problem: GraspForceProblem) -> Candidate:
        """Forces and multipliers for one float64 numpy problem without padding contacts."""

    def propose(self, problem: GraspForceProblem) -> Candidate:
        """The candidates of all problems; where zero forces hold, they are the optimum."""
        count, n, n_tau = len(problem), problem.n_contacts, problem.n_joints
        forces = np.zeros((count, n, 3))
        equilibrium = np.full((count, 6), np.nan)
        torque = np.full((count, n_tau), np.nan)
        messages = []
        for index in range(count):
            one = problem[index]
            mask = one.contact_mask
            one = one.without_padding()
            candidate = _no_force(one) if _needs_no_force(one) else self.propose_one(one)
            forces[index, mask] = candidate.forces.reshape(-1, 3)
            equilibrium[index] = candidate.multipliers.equilibrium
            torque[index] = candidate.multipliers.torque
            messages.append(str(candidate.message))
        return Candidate(
            forces=forces.reshape(count, 3 * n),
            multipliers=Multipliers(equilibrium, torque),
            message=np.array(messages, dtype=np.str_),
        )


def _needs_no_force(problem: GraspForceProblem) -> bool:
    """Zero forces hold, and are then the optimum of either objective."""
    torque = problem.external_torque
    within = (problem.torque_min <= torque) & (torque <= problem.torque_max)
    return bool(within.all() and not problem.external_wrench.any() and not problem.normal_min.any())


def _no_force(problem: GraspForceProblem) -> Candidate:
    multipliers = Multipliers(np.zeros(6), np.zeros(problem.n_joints))
    return Candidate(np.zeros(3 * problem.n_contacts), multipliers, np.array(""))
