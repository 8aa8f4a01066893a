"""Proofs that no forces of a problem have more quality for their effort, and their verification.

A `CoverProof` holds directions of the wrench space and multipliers of cuts. Both are only data:
how far contacts reach along the directions, and where the cuts end by weak duality, is computed
anew from the problem; a complete search over the contacts' shares
(`solvers.compiled.quality.covering`) then finds none that cover the directions at more than the
claimed quality.
"""

from dataclasses import dataclass

import numpy as np

from solvers.arrays import Array
from solvers.compiled.quality.covering import PROVEN
from solvers.problem import GraspForceProblem

from .cuts import CutMultipliers
from .friction_discs import FrictionDiscs
from .share_tree import ShareTree, share_thresholds

_MOST_VISITS = 1_000_000


@dataclass(frozen=True, eq=False)
class CoverProof:
    """Why forces of an effort up to `budget` have a quality of at most `bound`.

    Args:
        budget: N, sum of normal forces.
        bound: N, what is claimed.
        directions: (k, 6) wrench directions, torques over the characteristic length.
        cuts: on the normal forces.
    """

    budget: float
    bound: float
    directions: Array
    cuts: tuple[CutMultipliers, ...]

    def holds(self, problem: GraspForceProblem) -> bool:
        """Whether the claim follows, for one float64 numpy problem without padding."""
        if not self._of_shapes_for(problem) or not (
            np.isfinite(self.bound) and self.bound >= 0.0 and np.all(np.isfinite(self.directions))
        ):
            return False
        limited = problem.derived(effort_budget=np.minimum(problem.effort_budget, self.budget))
        tree = ShareTree(problem.n_contacts)
        thresholds = share_thresholds(unit_discs(problem), self.directions)
        prices = np.reshape([cut.prices for cut in self.cuts], (-1, problem.n_contacts))
        ends = np.array([cut.end(limited) for cut in self.cuts])
        if not np.isfinite(prices).all() or (prices < 0.0).any():
            return False
        while tree.visited < _MOST_VISITS and not tree.full:
            outcome = tree.advance(thresholds, prices, ends, self.bound)
            if outcome.why == PROVEN:
                return True
            if outcome.node >= 0:
                return False
        return False

    def _of_shapes_for(self, problem: GraspForceProblem) -> bool:
        """Whether directions and cuts have the shapes that the class and the problem say."""
        wanted = ((problem.n_contacts,), (6,), (problem.n_joints,))
        return (
            np.ndim(self.directions) == 2
            and np.shape(self.directions)[1] == 6
            and len(self.directions) > 0
            and all(
                (np.shape(cut.prices), np.shape(cut.equilibrium), np.shape(cut.torque)) == wanted
                for cut in self.cuts
            )
        )


def unit_discs(problem: GraspForceProblem) -> FrictionDiscs:
    """The wrenches that each contact can apply per newton of its normal force."""
    return FrictionDiscs.of_grasp_map(
        problem.grasp_map,
        problem.friction,
        np.ones(problem.n_contacts),
        float(problem.characteristic_length),
    )


def proven_bound(
    problem: GraspForceProblem, proofs: tuple[CoverProof, ...], least_effort: float = 0.0
) -> float:
    """A lower bound of effort_weight * effort - q_lrw over all forces, from what of `proofs` holds.

    Proofs for growing budgets divide the efforts into intervals; in each the quality is at most
    what is proven for its end, and the effort at least its beginning. Without a proof the quality
    is at most that of all contacts pressing with the whole budget, each as far as it may.

    Args:
        problem: one float64 numpy problem without padding, `max_quality`.
        proofs: by growing budget.
        least_effort: N, a lower bound of it.
    """
    weight, budget = float(problem.effort_weight), float(problem.effort_budget)
    directions = [proof.directions for proof in proofs] or [np.vstack([np.eye(6), -np.eye(6)])]
    most = np.minimum(problem.normal_max, budget)
    support = unit_discs(problem).scaled(most).support(np.vstack(directions))
    loosest = max(float(support.max(axis=1).min()), 0.0)
    bound, start = np.inf, max(float(np.sum(problem.normal_min)), least_effort)
    for proof in proofs:
        if proof.budget > start and proof.holds(problem):
            bound = min(bound, weight * start - min(proof.bound, loosest))
            start = proof.budget
    if start < budget:
        bound = min(bound, weight * start - loosest)
    return bound
