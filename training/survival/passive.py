"""Passive resistance: what a hand with constant joint torques resists without moving.

Torque-controlled joints do not stiffen when the object is pushed. Contact forces can change only in
ways that the joints do not feel, but for their dry friction; the palm, which no joint moves,
answers with whatever its cone allows. The passive resistance to a wrench d is the largest s with

    G f = -(w + s d),   f in the true friction cones,   |J_h' f - tau| <= dry friction,

tau what the commanded torques give the contacts. Where these cannot carry the weight, fingers and
object move until they can, or never; tau is then the nearest that can (`settled_torque`). Contact
forces of rigid bodies are not unique, and statics does not say which of them act, only whether
there are any: s is the most that can be hoped for.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gfo_env.holding import JOINT_FRICTION
from solvers import GraspForceProblem

from .conic import Rows, maximise

LARGEST_MULTIPLE = 10.0
"""Passive resistance beyond so many times the disturbance is not looked for: a palm that is pushed
at resists without end."""

JOINT_SCALE = 0.05
"""N·m; conic programs work in multiples of it."""

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PassiveResistance:
    """How many times each disturbance is resisted, and the contact forces that do it.

    Args:
        multiples: (k,) at most `LARGEST_MULTIPLE`; 0 where no torques carry the weight.
        forces: (k, 3n) N, contact forces; NaN where no torques carry the weight.
        torque: (n_tau,) N·m, what joints give the contacts; NaN where none carry the weight.
    """

    multiples: Array
    forces: Array
    torque: Array


def settled_torque(problem: GraspForceProblem, forces: Array, length: float) -> Array | None:
    """(n_tau,) N·m: of all J_h' f that carry the load, the nearest to what the joints are told.

    Equal to J_h' f of the commanded forces where these carry the load within the torque limits;
    None where no forces in the cones carry it.

    Args:
        problem: a single one, without padding; `friction` is the true coefficient.
        forces: (3n,) N, as commanded.
        length: m, that torques on the object are scaled with.
    """
    commanded = forces @ problem.hand_jacobian + problem.external_torque
    told = np.clip(commanded, problem.torque_min, problem.torque_max) - problem.external_torque
    jacobian = problem.hand_jacobian / JOINT_SCALE
    cones = friction_cones(problem, np.zeros(problem.n_contacts))
    found = maximise(
        jacobian @ told / JOINT_SCALE,
        _balance(problem, length),
        Rows(np.zeros((0, len(forces))), np.zeros(0)),
        Rows(cones.matrix[:, :-1], cones.constant),
        jacobian @ jacobian.T,
    )
    return None if found is None else found @ problem.hand_jacobian


def passive_resistance(
    problem: GraspForceProblem,
    forces: Array,
    disturbances: Array,
    length: float,
    *,
    joint_friction: float = JOINT_FRICTION,
) -> PassiveResistance:
    """What the commanded forces resist without any motion, disturbance by disturbance.

    Args:
        problem: a single one, without padding; `friction` is the true coefficient, the load w is
            what acts without disturbance.
        forces: (3n,) N, as commanded.
        disturbances: (k, 6) wrenches in the frame of the problem.
        length: m, that torques on the object are scaled with.
        joint_friction: N·m, dry.
    """
    size = problem.grasp_map.shape[1]
    multiples = np.zeros(len(disturbances))
    found = np.full((len(disturbances), size), np.nan)
    torque = settled_torque(problem, forces, length)
    if torque is None:
        return PassiveResistance(multiples, found, np.full(problem.n_joints, np.nan))
    joints = np.column_stack([problem.hand_jacobian.T, np.zeros(problem.n_joints)]) / JOINT_SCALE
    ends = np.zeros((2, size + 1))
    ends[:, -1] = 1.0, -1.0
    positive = Rows(
        np.vstack([joints, -joints, ends]),
        np.concatenate(
            [
                (joint_friction - torque) / JOINT_SCALE,
                (joint_friction + torque) / JOINT_SCALE,
                [0.0, LARGEST_MULTIPLE],
            ]
        ),
    )
    cones = friction_cones(problem, np.zeros(problem.n_contacts))
    gain = np.append(np.zeros(size), 1.0)
    load = _balance(problem, length)
    for k, wrench in enumerate(disturbances / _torque_units(length)):
        balance = Rows(np.column_stack([load.matrix, wrench]), load.constant)
        best = maximise(gain, balance, positive, cones)
        if best is not None:  # without dry friction the settled forces may be the only ones
            multiples[k], found[k] = np.clip(best[-1], 0.0, LARGEST_MULTIPLE), best[:-1]
    return PassiveResistance(multiples, found, torque)


def _balance(problem: GraspForceProblem, length: float) -> Rows:
    """G f + w, torques over the length."""
    units = _torque_units(length)
    return Rows(problem.grasp_map / units[:, None], problem.external_wrench / units)


def _torque_units(length: float) -> Array:
    return np.repeat([1.0, length], 3)


def friction_cones(problem: GraspForceProblem, spare: Array) -> Rows:
    """Rows (3n, 3n + 1) of the friction cones; the last unknown shrinks each by `spare` (n,)."""
    size = 3 * problem.n_contacts
    matrix = np.zeros((size, size + 1))
    first = np.arange(0, size, 3)
    matrix[first, first + 2] = problem.friction
    matrix[first, -1] = -spare
    matrix[first + 1, first] = 1.0
    matrix[first + 2, first + 1] = 1.0
    return Rows(matrix, np.zeros(size))
