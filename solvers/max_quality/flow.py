"""The points of the flow towards quality: shares of the preload, and exact forces of them.

With a the shares of the preload, g_i the responsibility of contact i (how much of q_lrw it
carries along the weakest directions; they sum to one) and p_i its part of what limits the level of
the preload, the KKT conditions of the most quality are g = p wherever a > 0, and g <= p elsewhere:
more of contact i raises the quality of a given level by its g_i, and lowers the level by its p_i.
The flow in log a is g - p, over a.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solvers.arguments import plain_array
from solvers.arrays import Array
from solvers.compiled.quality.support import farthest_supports
from solvers.problem import GraspForceProblem, Multipliers
from solvers.quality.directions import spread_directions, weakest_directions

from .preload import LeastForces, PreloadedForces, ceiling_duals, preloaded

_KNOWN = 16
_STARTS = 64


@dataclass(frozen=True, eq=False)
class QualityPoint:
    """Shares, their forces, and how these do.

    Args:
        asked: (B, n) shares of the preload that were asked for.
        shares: (B, n) of the normal forces that came of it: as shares of a preload these ask for
            the same forces, and with them every contact is at its preload.
        forces: with the highest preload of those shares.
        quality: (B,) N, estimate of q_lrw from above.
        directions: (B, 16, 6) along which the contacts reach least, weakest first, of those that
            were found for this point and for those before.
        prices: (B, n) p, summing to one.
    """

    asked: Array
    shares: Array
    forces: PreloadedForces
    quality: Array
    directions: Array
    prices: Array

    @property
    def normal(self) -> Array:
        """(B, n) N, normal forces; zero without forces."""
        return np.nan_to_num(self.forces.forces[:, 2::3])

    def utility(self, problem: GraspForceProblem) -> Array:
        """(B,) N: quality less the price of effort; -inf without forces."""
        return utility(problem, self.quality, self.forces.effort)


def quality_point(
    problem: GraspForceProblem,
    least: LeastForces,
    shares: Array,
    limit: Array,
    before: QualityPoint | None = None,
) -> QualityPoint:
    """Answer shares (B, n) by exact forces of an effort up to `limit` (B,), and measure these.

    Directions that were found for the point `before` count, too.
    """
    forces = preloaded(problem, least, shares, limit)
    normal = np.nan_to_num(forces.forces[:, 2::3])
    _, found = weakest_directions(problem, normal, spread_directions(_STARTS))
    known = before.directions if before else np.tile(spread_directions()[:8], (len(problem), 1, 1))
    directions = np.concatenate([found, known], axis=1)
    support = farthest(problem, directions, normal)
    order = np.argsort(support, axis=1)[:, :_KNOWN]
    pressed = normal.sum(axis=1, keepdims=True)
    realised = np.where(pressed > 0.0, normal / np.where(pressed > 0.0, pressed, 1.0), shares)
    ceiling = ceiling_duals(problem, forces.proof) * realised
    total = ceiling.sum(axis=1, keepdims=True)
    proven = forces.by_torque[:, None] & (total > 0.0)
    return QualityPoint(
        asked=shares,
        shares=realised,
        forces=forces,
        quality=np.maximum(support.min(axis=1), 0.0),
        directions=np.take_along_axis(directions, order[:, :, None], axis=1),
        prices=np.where(proven, ceiling / np.where(proven, total, 1.0), realised),
    )


def better_point(problem: GraspForceProblem, points: list[QualityPoint]) -> QualityPoint:
    """Of several points the one that is worth most along the directions of all, row by row."""
    directions = np.concatenate([point.directions for point in points], axis=1)
    support = np.stack([farthest(problem, directions, point.normal) for point in points])
    quality = np.maximum(support.min(axis=2), 0.0)
    spent = np.stack([point.forces.effort for point in points])
    best = np.argmax(utility(problem, quality, spent), axis=0)
    rows = np.arange(len(problem))
    order = np.argsort(support[best, rows], axis=1)[:, :_KNOWN]

    def chosen(part: Callable[[QualityPoint], NDArray[Any]]) -> NDArray[Any]:
        return np.stack([part(point) for point in points])[best, rows]

    forces = PreloadedForces(
        chosen(lambda point: point.forces.forces),
        chosen(lambda point: point.forces.level),
        chosen(lambda point: point.forces.effort),
        chosen(lambda point: point.forces.by_torque).astype(np.bool_),
        Multipliers(
            chosen(lambda point: point.forces.proof.equilibrium),
            chosen(lambda point: point.forces.proof.torque),
        ),
    )
    return QualityPoint(
        asked=chosen(lambda point: point.asked),
        shares=chosen(lambda point: point.shares),
        forces=forces,
        quality=quality[best, rows],
        directions=np.take_along_axis(directions, order[:, :, None], axis=1),
        prices=chosen(lambda point: point.prices),
    )


def utility(problem: GraspForceProblem, quality: Array, spent: Array) -> Array:
    """(..., B) N: quality less the price of the effort spent; -inf where that is NaN, no forces."""
    value = quality - problem.effort_weight * np.nan_to_num(spent)
    return np.where(np.isfinite(spent), value, -np.inf)


def farthest(problem: GraspForceProblem, directions: Array, normal: Array) -> Array:
    """(B, k) N: the reach of the contact that reaches farthest along each direction.

    Args:
        problem: flat, `max_quality`.
        directions: (B, k, 6) unit wrench directions.
        normal: (B, n) N.
    """
    grasp_map, _, friction, *_ = problem.plain_arrays(1)
    count, contacts = friction.shape
    found = np.empty((count, np.shape(directions)[1]))
    farthest_supports(
        grasp_map,
        friction,
        np.where(problem.contact_mask, plain_array("normal", normal, (count, contacts)), 0.0),
        plain_array("characteristic_length", problem.characteristic_length, (count,)),
        plain_array("directions", directions, (*found.shape, 6)),
        found,
    )
    return found


def even_shares(problem: GraspForceProblem) -> Array:
    """(B, n) of a preload that is the same for all contacts."""
    return problem.contact_mask / problem.contact_mask.sum(axis=-1, keepdims=True)
