"""How far contacts reach at given normal forces, as a maximum over contacts or as their sum.

Contact i applies wrenches of the disc a_i {c_i + S_i u : |u| <= 1}, a_i its normal force; h_i(d)
is how far the disc and the origin reach along a wrench direction d. q_lrw is the least over unit d
of the largest h_i(d) (Ferrari and Canny, Planning optimal grasps, 1992, their L1 measure); if every
contact may press with all of its force at once, of the sum of h_i(d) (their L-infinity measure).
"""

import numpy as np

from solvers import GraspForceProblem
from solvers.arrays import Array
from solvers.conic import Rows, maximise
from solvers.problem import MAX_QUALITY
from solvers.quality.directions import spread_directions, weak_directions
from solvers.quality.friction_discs import FrictionDiscs

_DIRECTIONS = 1024
_STARTS = 4
_STEPS = 8
_LEAST_FALL = 1e-4


def discs_of(problem: GraspForceProblem, normal: Array, length: float) -> FrictionDiscs:
    """The discs of contacts that press with `normal` (n,) N; torques are divided by `length`, m."""
    return FrictionDiscs.of_grasp_map(
        problem.grasp_map, problem.friction, np.maximum(normal, 0.0), length
    )


def sum_support(discs: FrictionDiscs, directions: Array) -> Array:
    """(k,) N: the sum over contacts of how far each reaches, and the origin, along (k, 6)."""
    return np.maximum(discs.support(directions), 0.0).sum(axis=1)


def least_supports(problem: GraspForceProblem, normal: Array, length: float) -> tuple[float, float]:
    """q_lrw in N with the maximum over contacts, and with their sum, which is at least as large.

    Both are upper bounds, the least reach along the directions that descents end at.

    Args:
        problem: a single one, without padding; `friction` is the true coefficient.
        normal: (n,) N, normal forces.
        length: m, that torques are divided by.
    """
    normal = np.maximum(normal, 0.0)
    posed = problem.replace(objective=MAX_QUALITY, effort_budget=1.0, characteristic_length=length)
    largest, weak = weak_directions(posed, normal)
    discs = discs_of(problem, normal, length)
    starts = np.vstack([weak, spread_directions(_DIRECTIONS)])
    starts = starts[np.argsort(sum_support(discs, starts))[:_STARTS]]
    ends = np.array([_descend(discs, start) for start in starts])
    added = float(sum_support(discs, ends).min())
    along = float(np.maximum(discs.support(ends), 0.0).max(axis=1).min())
    return min(largest, along), added


def _descend(discs: FrictionDiscs, direction: Array) -> Array:
    """(6,) unit direction along which the sum of reaches is no larger than along `direction`.

    The sum is convex and grows with the length of d. Its least value on the plane through a unit
    direction that is tangent to the sphere is attained outside of the sphere, so that it falls
    further when the direction found is made a unit vector.
    """
    count = len(discs.centres)
    reached = float(sum_support(discs, direction[None])[0])
    for _ in range(_STEPS):
        if reached <= 0.0:
            break
        # unknowns d (6) and a bound t_i >= max(0, c_i'd + |S_i'd|) for each contact
        cones = np.zeros((count, 3, 6 + count))
        cones[:, 0, :6] = discs.centres
        cones[np.arange(count), 0, 6 + np.arange(count)] = -1.0
        cones[:, 1:, :6] = -discs.spans.transpose(0, 2, 1)
        tangent = Rows(-np.append(direction, np.zeros(count))[None], np.array([-1.0]))
        positive = Rows(-np.eye(6 + count)[6:], np.zeros(count))
        found = maximise(
            np.append(np.zeros(6), -np.ones(count)),
            tangent,
            positive,
            Rows(cones.reshape(3 * count, -1), np.zeros(3 * count)),
        )
        if found is None:
            break
        unit = found[:6] / np.linalg.norm(found[:6])
        value = float(sum_support(discs, unit[None])[0])
        if value >= reached * (1.0 - _LEAST_FALL):
            break
        direction, reached = unit, value
    return direction


def resisted_multiples(
    discs: FrictionDiscs, disturbances: Array, length: float, *, together: bool
) -> Array:
    """(k,) the largest multiple of each disturbance that the contacts resist at these forces.

    Args:
        discs: of the contacts.
        disturbances: (k, 6) N, N·m.
        length: m, that the discs' torques are divided by.
        together: whether every contact may press with all of its force at once (the sum of the
            discs), or only shares of one in all (their convex hull).
    """
    count = len(discs.centres)
    # a contact's unknowns: its share of the normal force, and its friction in those units
    blocks = np.concatenate([discs.centres[:, :, None], discs.spans], axis=2)
    wrenches = blocks.transpose(1, 0, 2).reshape(6, 3 * count)
    size = 3 * count + 1
    shares = np.zeros((count, size))
    shares[np.arange(count), 3 * np.arange(count)] = 1.0
    room = Rows(shares if together else shares.sum(axis=0)[None], np.ones(count if together else 1))
    cones = Rows(-np.eye(size)[:-1], np.zeros(size - 1))
    gain = np.append(np.zeros(size - 1), 1.0)
    multiples = np.zeros(len(disturbances))
    for k, wrench in enumerate(disturbances):
        scaled = wrench / np.repeat([1.0, length], 3)
        balance = Rows(-np.column_stack([wrenches, scaled]), np.zeros(6))
        found = maximise(gain, balance, room, cones)
        multiples[k] = 0.0 if found is None else max(found[-1], 0.0)
    return multiples
