"""Naive answers that people use instead of solving the problem: the floor of every comparison."""

import numpy as np

from solvers.base import Solver
from solvers.problem import GraspForceProblem, Multipliers, least_force
from solvers.solution import Candidate


class PseudoinverseSolver(Solver):
    """f = -G^+ w: balances the load with the least forces and knows nothing of friction."""

    def propose(self, problem: GraspForceProblem) -> Candidate:
        """The least-norm forces that balance the load."""
        return _without_multipliers(problem, -least_force(problem, problem.external_wrench))


class EqualSqueezeSolver(Solver):
    """Every contact presses along its normal with the same force, whatever the load's direction.

    The force is the usual rule of thumb: enough that friction alone could carry the load's force,
    |w_force| / sum(mu), and no less than the preload.
    """

    def propose(self, problem: GraspForceProblem) -> Candidate:
        """Equal normal forces, no tangential force."""
        mask = problem.contact_mask
        grip = np.where(mask, problem.friction, 0.0).sum(axis=-1)
        load = np.linalg.norm(problem.external_wrench[..., :3], axis=-1)
        squeeze = load / np.where(grip > 0, grip, 1.0)
        forces = np.zeros((*mask.shape, 3))
        normal = np.maximum(squeeze[..., None], problem.normal_min)
        forces[..., 2] = np.where(mask, np.minimum(normal, problem.normal_max), 0.0)
        return _without_multipliers(problem, forces.reshape(len(problem), 3 * problem.n_contacts))


def _without_multipliers(problem: GraspForceProblem, forces: np.ndarray) -> Candidate:
    batch = problem.batch_shape
    return Candidate(
        forces,
        Multipliers(np.full((*batch, 6), np.nan), np.full((*batch, problem.n_joints), np.nan)),
        np.full(batch, "a heuristic that checks no constraint"),
    )
