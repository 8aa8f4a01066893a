"""Grasp quality: the lowest resisted wrench q_lrw, and force closure.

A point contact that presses with normal force N can apply the forces N (n + mu disc): a slice of
its friction cone, hence a disc of wrenches [force; torque / length]. q_lrw is the radius of the
largest ball about the origin inside the convex hull of the origin and all these discs. (The origin
belongs to it because the paper's weights satisfy sum(alpha) <= 1; so q_lrw is zero, not negative,
where contacts cannot close.) Dividing torques by a length is what lets newtons and newton metres
share one norm: the length, and the number of edges per cone, are part of the number.

Source: the paper's section "Validation based on Grasp Quality Measure" (the L1 metric of Ferrari
and Canny, Planning optimal grasps, ICRA 1992) and its section "Force Closure Constraints".
"""

import operator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gfo_env.checks import checked_array, checked_arrays, is_number
from gfo_env.exceptions import QualityError
from solvers.arrays import Array
from solvers.conic import POSITIVE, SECOND_ORDER, ZERO, solve
from solvers.quality.friction_discs import FrictionDiscs, spans_all_wrenches, support_bounds

from .contacts import UNIT_TOLERANCE

# Clarabel is accurate to 1e-8; the margin that it maximises lies between 0 and 1.
_LEAST_MARGIN = 1e-7


@dataclass(frozen=True)
class QualityInterval:
    """q_lrw of the true friction cones lies in [lower, upper].

    lower, upper: newtons, or a pure number where every normal force was left at 1. `lower` is q_lrw
        of pyramids inscribed in the cones, `upper` the least reach of the true cones over the
        directions that were tried.
    edges: edges per pyramid; after refinement, the most on any one of them.
    length: the divisor of torques [m].
    """

    lower: float
    upper: float
    edges: int
    length: float


def lowest_resisted_wrench(
    positions: ArrayLike,
    normals: ArrayLike,
    friction: ArrayLike,
    *,
    normal_forces: ArrayLike | None = None,
    edges: int = 8,
    length: float | None = None,
    relative_width: float | None = None,
) -> QualityInterval:
    """q_lrw of a grasp, as an interval that contains its value for the true (round) friction cones.

    Args:
        positions: (n, 3) contact points relative to the object's centre of mass [m]; n may be 0.
        normals: (n, 3) unit normals, into the object, in the frame of `positions`.
        friction: (n,) coefficients of friction, >= 0.
        normal_forces: (n,) normal forces [N], >= 0; 1 for every contact if None.
        edges: edges of the pyramid inscribed in each cone, >= 3. The first lies along a tangent
            that is a fixed function of the normal, so doubling `edges` keeps those there were.
        length: divisor of torques [m]. q_lrw takes the object's largest radius about its centre of
            mass, which the caller knows. The default is the largest distance of a contact from it:
            usable for one grasp, but grasps measured by different lengths do not compare.
        relative_width: if given, edges are added where they matter, starting from `edges`, until
            upper - lower <= relative_width * upper.

    Returns:
        The interval; [0, 0] where the wrenches do not span all six dimensions. A bound below 1e-8
        of the largest wrench is returned as 0.

    Raises:
        QualityError: an argument is malformed, or 40 rounds of refinement did not reach
            `relative_width`: the grasp is on the very edge of force closure, or the width is below
            what double precision can tell (about 1e-6).

    Time grows steeply with n * edges: about 1, 3 and 7 ms for 3, 5 and 8 contacts at 8 edges.
    Refining from 4 edges to one per cent takes about 4, 9 and 15 ms.
    """
    points, axes, coefficients = checked_contacts(positions, normals, friction)
    if normal_forces is None:
        forces = np.ones(len(points))
    else:
        forces = checked_array("normal_forces", normal_forces, (len(points),), QualityError)
    if (forces < 0).any():
        raise QualityError("normal_forces must be >= 0: a contact pushes and never pulls.")
    try:
        edges = operator.index(edges)
    except TypeError as error:
        raise QualityError(f"edges must be a whole number, not {edges!r}.") from error
    if edges < 3:
        raise QualityError(f"edges must be >= 3 for a pyramid to have an inside, not {edges}.")
    if length is None:
        length = float(np.linalg.norm(points, axis=1).max(initial=0.0))
        if length == 0:
            raise QualityError("length must be given: no contact is away from the origin.")
    if not (is_number(length) and 0 < length < np.inf):
        raise QualityError(f"length must be a positive number of metres, not {length!r}.")
    if relative_width is not None and not (is_number(relative_width) and 0 < relative_width < 1):
        raise QualityError(f"relative_width must lie between 0 and 1, not {relative_width!r}.")

    pressing = forces > 0
    discs = FrictionDiscs.of_contacts(
        points[pressing], axes[pressing], coefficients[pressing], forces[pressing], length
    )

    def narrow_enough(lower: float, upper: float) -> bool:
        return relative_width is None or upper - lower <= relative_width * upper

    bounds = support_bounds(discs, edges, narrow_enough)
    lower, upper = bounds.lower, bounds.upper
    if not narrow_enough(lower, upper):
        raise QualityError(
            f"relative_width={relative_width} was not reached: q_lrw lies in [{lower:.6g}, "
            f"{upper:.6g}], and refinement came no narrower than {1 - lower / upper:.1e}."
        )
    return QualityInterval(lower, upper, bounds.edges, float(length))


def is_force_closure(positions: ArrayLike, normals: ArrayLike, friction: ArrayLike) -> bool:
    """Whether the contacts can resist every wrench, if they may press as hard as needed.

    Arguments as for `lowest_resisted_wrench`; `positions` may have any origin. True if q_lrw of
    inscribed pyramids at unit normal forces is positive. Pyramids of few edges miss grasps that
    only just close, so edges are added until the lower bound is positive (True) or the upper bound,
    which knows the true cones, is zero (False). A grasp that 40 rounds leave undecided lies within
    round-off of the boundary and is called False.

    Raises:
        QualityError: an argument is malformed.
    """
    discs = _centred_discs(*checked_contacts(positions, normals, friction))
    return support_bounds(discs, 4, lambda lower, upper: lower > 0 or upper == 0).lower > 0


def has_interior_internal_force(
    positions: ArrayLike, normals: ArrayLike, friction: ArrayLike
) -> bool:
    """The paper's test of force closure: G G' >= eps I, and an internal force inside all cones.

    Equivalent to `is_force_closure` and independent of it: one second-order cone program instead of
    convex hulls. With f_i = g_n n + mu (g_1 t1 + g_2 t2) it maximises the margin m subject to
    |(g_1, g_2)| <= g_n - m and g_n <= 1 at every contact, and G f = 0; eps is the square of 1e-8 of
    the longest column of G. In these coordinates a contact without friction is no special case: its
    tangential columns of G vanish, and its force is interior relative to its normal.

    Arguments as for `is_force_closure`.

    Raises:
        QualityError: an argument is malformed, or the solver gave up.
    """
    discs = _centred_discs(*checked_contacts(positions, normals, friction))
    count = len(discs.centres)
    # Columns g_n, g_1, g_2 of each contact: the order of a second-order cone's own entries.
    columns = np.concatenate([discs.centres[:, :, None], discs.spans], axis=2)
    grasp_map = columns.transpose(1, 0, 2).reshape(6, 3 * count)
    if not spans_all_wrenches(grasp_map.T):
        return False
    pushes = np.kron(np.eye(count), [[1.0, 0.0, 0.0]])
    rows = np.block(
        [
            [grasp_map, np.zeros((6, 1))],
            [pushes, np.zeros((count, 1))],
            [-np.eye(3 * count), pushes.sum(axis=0)[:, None]],
        ]
    )
    right = np.concatenate([np.zeros(6), np.ones(count), np.zeros(3 * count)])
    cost = np.append(np.zeros(3 * count), -1.0)
    cones = [ZERO(6), POSITIVE(count), *[SECOND_ORDER(3)] * count]
    outcome = solve(None, cost, rows, right, cones)
    if not outcome.solved:
        raise QualityError(f"Clarabel could not decide on an internal force: {outcome.status}.")
    return bool(outcome.x[-1] > _LEAST_MARGIN)


def _centred_discs(positions: Array, normals: Array, friction: Array) -> FrictionDiscs:
    """Discs of unit normal force about the contacts' own centre, where closure is best scaled."""
    if len(positions) == 0:
        return FrictionDiscs(np.zeros((0, 6)), np.zeros((0, 6, 2)))
    offsets = positions - positions.mean(axis=0)
    # Contacts all in one point have no torque to divide, and no closure whatever the length.
    length = float(np.linalg.norm(offsets, axis=1).max()) or 1.0
    return FrictionDiscs.of_contacts(offsets, normals, friction, np.ones(len(offsets)), length)


def checked_contacts(
    positions: ArrayLike, normals: ArrayLike, friction: ArrayLike
) -> tuple[Array, Array, Array]:
    """The contacts as float arrays of agreeing shapes, normals at unit length to round-off.

    Args:
        positions: (n, 3) m.
        normals: (n, 3) unit.
        friction: (n,) coefficients >= 0.

    Raises:
        QualityError: an argument is something else.
    """
    points, axes, coefficients = checked_arrays(
        {"positions": positions, "normals": normals, "friction": friction},
        {"positions": ("n", 3), "normals": ("n", 3), "friction": ("n",)},
        QualityError,
    )
    if (coefficients < 0).any():
        raise QualityError("friction must be >= 0.")
    norms = np.linalg.norm(axes, axis=1, keepdims=True)
    if (np.abs(norms - 1.0) > UNIT_TOLERANCE).any():
        raise QualityError("normals must have unit length: divide each by its norm.")
    return points, axes / norms, coefficients
