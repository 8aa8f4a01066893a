"""What can be known of commanded forces without simulating: the static measures."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gfo_env.objects import GraspObject
from solvers import GraspForceProblem
from solvers.arrays import Array
from solvers.passive_resistance import passive_resistance

from ..margins import predicted_acceleration
from .support import discs_of, least_supports, resisted_multiples

WRENCHES, FORCES, GRASP, JOINTS = "wrenches", "forces", "grasp", "joints"


@dataclass(frozen=True)
class Measure:
    """A static quantity.

    Args:
        label: for the reader.
        kind: what it knows of: `WRENCHES` that contacts can apply, `FORCES` and effort, the `GRASP`
            and its object, or which of it the hand's `JOINTS` let happen.
        sign: 1 if more of it is expected to hold better, else -1.
    """

    label: str
    kind: str
    sign: int = 1


MEASURES = {
    "quality": Measure("q_lrw", WRENCHES),
    "quality_weight": Measure("q_lrw over weight", WRENCHES),
    "sum_quality": Measure("added q_lrw", WRENCHES),
    "sum_quality_weight": Measure("added q_lrw over weight", WRENCHES),
    "task_quality": Measure("q_lrw along the disturbances", WRENCHES),
    "task_sum_quality": Measure("added q_lrw along the disturbances", WRENCHES),
    "smallest_singular_value": Measure("smallest singular value of G", WRENCHES),
    "spare_friction": Measure("friction to spare", FORCES),
    "spare_friction_weight": Measure("friction to spare over weight", FORCES),
    "effort": Measure("effort", FORCES),
    "effort_weight": Measure("effort over weight", FORCES),
    "palm_share": Measure("share of effort on the palm", FORCES),
    "contacts": Measure("contacts", GRASP),
    "palm_contacts": Measure("contacts with the palm", GRASP),
    "friction": Measure("coefficient of friction", GRASP),
    "mass": Measure("small mass", GRASP, -1),
    "radius": Measure("small object radius", GRASP, -1),
    "structural_stiffness": Measure("stiffness that joints do not feel", JOINTS),
    "acceleration_worst": Measure("worst predicted acceleration", JOINTS, -1),
    "acceleration_mean": Measure("mean predicted acceleration", JOINTS, -1),
    "passive_least": Measure("least passive resistance", JOINTS),
    "passive_mean": Measure("mean passive resistance", JOINTS),
}
"""By name; those of `JOINTS` know the hand Jacobian."""

_PALM = 1e-9


def measure(
    problem: GraspForceProblem,
    forces: Array,
    disturbances: Array,
    body: GraspObject,
    joint_friction: float,
) -> dict[str, float]:
    """Every measure of `MEASURES`.

    Args:
        problem: a single one, without padding, under the weight; `friction` is the true
            coefficient.
        forces: (3n,) N, as commanded.
        disturbances: (k, 6) wrenches in its frame.
        body: with the mass that is held.
        joint_friction: N·m, dry.
    """
    normal = np.maximum(forces[2::3], 0.0)
    length = body.radius
    weight = float(np.linalg.norm(problem.external_wrench[:3]))
    quality, added = least_supports(problem, normal, length)
    discs = discs_of(problem, normal, length)
    spare = float((problem.friction * forces[2::3] - np.hypot(forces[0::3], forces[1::3])).min())
    effort = float(normal.sum())
    palm = palm_contacts(problem)
    scaled = problem.grasp_map / np.repeat([1.0, length], 3)[:, None]
    accelerations = _accelerations(problem, forces, disturbances, body, joint_friction)
    passive = passive_resistance(
        problem, forces, disturbances, length, joint_friction=joint_friction
    ).multiples
    return {
        "quality": quality,
        "quality_weight": quality / weight,
        "sum_quality": added,
        "sum_quality_weight": added / weight,
        "task_quality": float(
            resisted_multiples(discs, disturbances, length, together=False).min()
        ),
        "task_sum_quality": float(
            resisted_multiples(discs, disturbances, length, together=True).min()
        ),
        "smallest_singular_value": float(np.linalg.svd(scaled, compute_uv=False)[-1]),
        "spare_friction": spare,
        "spare_friction_weight": spare / weight,
        "effort": effort,
        "effort_weight": effort / weight,
        "palm_share": float(normal[palm].sum()) / max(effort, 1e-12),
        "contacts": float(problem.n_contacts),
        "palm_contacts": float(palm.sum()),
        "friction": float(problem.friction.mean()),
        "mass": float(body.mass),
        "radius": float(length),
        "structural_stiffness": structural_stiffness(problem, length),
        "acceleration_worst": float(accelerations.max()),
        "acceleration_mean": float(accelerations.mean()),
        "passive_least": float(passive.min()),
        "passive_mean": harmonic_mean(passive),
    }


def palm_contacts(problem: GraspForceProblem) -> NDArray[np.bool_]:
    """(n,) contacts whose forces no joint feels."""
    felt = np.abs(problem.hand_jacobian).reshape(problem.n_contacts, -1).max(axis=1)
    return np.asarray(felt < _PALM)


def structural_stiffness(problem: GraspForceProblem, length: float) -> float:
    """Least stiffness that contacts of unit stiffness give the object where all joints give way.

    The smallest eigenvalue of G P G', P the projector on the contact forces that no joint feels
    (the null space of J_h'), torques divided by `length` (m). With joints that do not move P is the
    identity, and the value is the square of the smallest singular value of G.
    """
    left, sizes, _ = np.linalg.svd(problem.hand_jacobian)
    unfelt = left[:, np.count_nonzero(sizes > 1e-6 * max(sizes.max(initial=0.0), 1e-12)) :]
    scaled = problem.grasp_map / np.repeat([1.0, length], 3)[:, None]
    if unfelt.shape[1] < 6:
        return 0.0
    return float(np.linalg.svd(scaled @ unfelt, compute_uv=False)[5] ** 2)


def harmonic_mean(values: Array) -> float:
    """The harmonic mean of numbers that are not negative; 0 if one of them is."""
    return float(len(values) / (1.0 / values).sum()) if (values > 0.0).all() else 0.0


def _accelerations(
    problem: GraspForceProblem,
    forces: Array,
    disturbances: Array,
    body: GraspObject,
    joint_friction: float,
) -> Array:
    """(k + 1,) m/s2 under the weight alone, and under each disturbance with it."""
    inertia = np.zeros((6, 6))
    inertia[:3, :3] = body.mass * np.eye(3)
    inertia[3:, 3:] = body.inertia
    loads = problem.external_wrench + np.vstack([np.zeros(6), disturbances])
    return np.array(
        [
            predicted_acceleration(
                problem.derived(external_wrench=load),
                forces,
                inertia,
                body.radius,
                joint_friction=joint_friction,
            ).value
            for load in loads
        ]
    )
