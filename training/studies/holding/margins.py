"""Will a grasp hold? What can be known from the problem and the commanded forces alone.

What acts in the world is not the commanded forces but the joint torques that they become; contact
forces follow from these. For a hand and an object at rest, Gauss' principle of least constraint
says which: those inside the friction cones, with the dry friction of the joints, that minimise

    1/2 a' M a + 1/2 q'' D q'',   M a = G f + w,   D q'' = tau - J_h' f - d,   |d| <= dry friction,

a the acceleration of the object and q'' that of the joints. The contacts can carry the load with
these torques if and only if a = 0; otherwise the object starts to move with a, and the faster, the
sooner it is lost. (The principle ignores that a contact which slides resists with all its friction
against the motion; the simulator does not.)
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata

from gfo_env.conditions import JOINT_FRICTION
from solvers import GraspForceProblem
from solvers.arrays import Array
from solvers.conic import POSITIVE, SECOND_ORDER, cone_rows, solve
from solvers.duality import project_cones

JOINT_INERTIA = 2e-3
"""kg·m2 of every joint: rotor and links; a factor of four either way changes little."""

LARGEST_FORCE = 1e3
"""N: normal forces are known to be smaller, which makes every dual bound finite."""


@dataclass(frozen=True, eq=False)
class Acceleration:
    """How fast an object starts to move, with a proof of it.

    Args:
        value: m/s2, linear acceleration plus radius times angular acceleration.
        error: m/s2, the true value is not farther off than this: from the gap between the primal
            value and a dual bound, which the conic solver has no part in judging.
    """

    value: float
    error: float


def predicted_acceleration(
    problem: GraspForceProblem,
    forces: Array,
    inertia: Array,
    radius: float,
    *,
    joint_inertia: float = JOINT_INERTIA,
    joint_friction: float = JOINT_FRICTION,
) -> Acceleration:
    """The acceleration of the object when the hand at rest is told to press with these forces.

    Args:
        problem: a single one, without padding; `friction` is the true coefficient here.
        forces: (3n,) N, as commanded.
        inertia: (6, 6) of the object about its centre of mass, object frame: kg, kg·m2.
        radius: m, what turns angular into linear acceleration.
        joint_inertia: kg·m2.
        joint_friction: N·m.
    """
    n_forces, n_joints = problem.hand_jacobian.shape
    commanded = forces @ problem.hand_jacobian + problem.external_torque
    torque = np.clip(commanded, problem.torque_min, problem.torque_max) - problem.external_torque
    root = np.linalg.inv(np.linalg.cholesky(inertia))
    weight = 1.0 / np.sqrt(joint_inertia)
    # residual = rows @ (f, d) + constant; its first six entries are a, scaled to unit inertia
    rows = np.block(
        [
            [root @ problem.grasp_map, np.zeros((6, n_joints))],
            [weight * problem.hand_jacobian.T, weight * np.eye(n_joints)],
        ]
    )
    constant = np.concatenate([root @ problem.external_wrench, -weight * torque])
    found = _least_residual(rows, constant, problem.friction, joint_friction)
    free = problem.replace(normal_min=None, normal_max=None)
    inside = project_cones(free, found[:n_forces].reshape(-1, 3)).ravel()
    given = np.append(inside, np.clip(found[n_forces:], -joint_friction, joint_friction))
    residual = rows @ given + constant
    gap = 0.5 * residual @ residual - _dual_bound(
        residual, rows, constant, problem.friction, joint_friction
    )
    motion = root.T @ residual[:6]
    size = np.linalg.norm(motion[:3]) + radius * np.linalg.norm(motion[3:])
    # the objective grows by at least half the square of the distance from its minimum
    slowest = 1.0 / np.sqrt(inertia[0, 0])
    turning = radius / np.sqrt(np.linalg.eigvalsh(inertia[3:, 3:])[0])
    return Acceleration(float(size), float(np.sqrt(2.0 * max(gap, 0.0)) * (slowest + turning)))


def _least_residual(rows: Array, constant: Array, friction: Array, joint_friction: float) -> Array:
    """(3n + n_tau,) forces and joint friction that minimise half the square of the residual."""
    n_forces = 3 * len(friction)
    n_joints = rows.shape[1] - n_forces
    band = np.zeros((2 * n_joints, rows.shape[1]))
    band[:, n_forces:] = np.vstack([np.eye(n_joints), -np.eye(n_joints)])
    cones = np.pad(cone_rows(friction), ((0, 0), (0, n_joints)))
    quadratic = rows.T @ rows
    scale = quadratic.diagonal().max()
    outcome = solve(
        quadratic / scale,
        rows.T @ constant / scale,
        np.vstack([band, cones]),
        np.append(np.full(len(band), joint_friction), np.zeros(n_forces)),
        [POSITIVE(len(band)), *[SECOND_ORDER(3)] * len(friction)],
        tolerance=1e-10,
    )
    # whatever Clarabel says: the gap of what it found is measured
    return outcome.x


def _dual_bound(
    multipliers: Array, rows: Array, constant: Array, friction: Array, joint_friction: float
) -> float:
    """A bound by any multipliers y: y'constant - y'y / 2 + the least of y'rows (f, d)."""
    price = multipliers @ rows
    per_contact = price[: 3 * len(friction)].reshape(-1, 3)
    slope = per_contact[:, 2] - friction * np.linalg.norm(per_contact[:, :2], axis=1)
    return float(
        multipliers @ constant
        - 0.5 * multipliers @ multipliers
        + LARGEST_FORCE * np.minimum(slope, 0.0).sum()
        - joint_friction * np.abs(price[3 * len(friction) :]).sum()
    )


def roc_area(scores: Array, held: NDArray[np.bool_]) -> float:
    """Area under the ROC curve: the chance that a grasp that held scores above one that did not.

    NaN where all of them held, or none.
    """
    good = int(held.sum())
    bad = len(held) - good
    if not good or not bad:
        return float("nan")
    return float((rankdata(scores)[held].sum() - good * (good + 1) / 2) / (good * bad))
