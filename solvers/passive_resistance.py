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
from numbers import Real
from typing import Any

import numpy as np

from solvers.arguments import plain_array
from solvers.arrays import Array
from solvers.conic import JOINT_SCALE, Rows, cone_rows, force_limits, maximise
from solvers.exceptions import ProblemError, SolverError
from solvers.judge import Status, judge
from solvers.problem import GraspForceProblem, Multipliers, as_problem
from solvers.solution import Candidate, finished

LARGEST_MULTIPLE = 10.0
"""Passive resistance beyond so many times the disturbance is not looked for: a palm that is pushed
at resists without end."""

_TIE = 1e-3
"""Multiples that all of the budget is worth: of equals, forces with more effort."""

_SPARED = 1e-7
"""Share of the budget that is kept for moving forces inside their constraints."""


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

    Raises:
        ProblemError: an argument of another shape, or out of its range.
        SolverError: Clarabel found neither forces nor that there are none.
    """
    forces = _checked(problem, forces, length)
    commanded = forces @ problem.hand_jacobian + problem.external_torque
    told = np.clip(commanded, problem.torque_min, problem.torque_max) - problem.external_torque
    jacobian = problem.hand_jacobian / JOINT_SCALE
    size = len(forces)
    found = maximise(
        jacobian @ told / JOINT_SCALE,
        _balance(problem, length),
        Rows(np.zeros((0, size)), np.zeros(0)),
        Rows(cone_rows(problem.friction), np.zeros(size)),
        jacobian @ jacobian.T,
    )
    return None if found is None else found @ problem.hand_jacobian


def passive_resistance(
    problem: GraspForceProblem,
    forces: Array,
    disturbances: Array,
    length: float,
    *,
    joint_friction: float,
) -> PassiveResistance:
    """What the commanded forces resist without any motion, disturbance by disturbance.

    Args:
        problem: a single one, without padding; `friction` is the true coefficient, the load w is
            what acts without disturbance.
        forces: (3n,) N, as commanded, in the contact frames.
        disturbances: (k, 6) wrenches in the frame of the problem, N and N·m.
        length: m, that torques on the object are scaled with.
        joint_friction: N·m, dry.

    Raises:
        ProblemError: an argument of another shape, or out of its range.
        SolverError: Clarabel found neither forces nor that there are none.
    """
    forces = _checked(problem, forces, length)
    disturbances = _checked_disturbances(disturbances, joint_friction)
    size = problem.grasp_map.shape[1]
    multiples = np.zeros(len(disturbances))
    found = np.full((len(disturbances), size), np.nan)
    torque = settled_torque(problem, forces, length)
    if torque is None:
        return PassiveResistance(multiples, found, np.full(problem.n_joints, np.nan))
    joints = np.column_stack([problem.hand_jacobian.T, np.zeros(problem.n_joints)]) / JOINT_SCALE
    ends = np.zeros((2, size + 1))
    ends[:, -1] = -1.0, 1.0
    positive = Rows(
        np.vstack([-joints, joints, ends]),
        np.concatenate(
            [
                (joint_friction - torque) / JOINT_SCALE,
                (joint_friction + torque) / JOINT_SCALE,
                [0.0, LARGEST_MULTIPLE],
            ]
        ),
    )
    cones = Rows(np.pad(cone_rows(problem.friction), ((0, 0), (0, 1))), np.zeros(size))
    gain = np.append(np.zeros(size), 1.0)
    load = _balance(problem, length)
    for k, wrench in enumerate(disturbances / _torque_units(length)):
        balance = Rows(np.column_stack([load.matrix, -wrench]), load.bound)
        best = maximise(gain, balance, positive, cones)
        if best is not None:  # without dry friction the settled forces may be the only ones
            multiples[k], found[k] = np.clip(best[-1], 0.0, LARGEST_MULTIPLE), best[:-1]
    return PassiveResistance(multiples, found, torque)


def most_passive_resistance(
    problem: GraspForceProblem,
    budget: float,
    disturbances: Array,
    length: float,
    *,
    joint_friction: float,
    exact: bool = True,
) -> Array | None:
    """(3n,) N: the forces whose least passive resistance over disturbances d_1 to d_k is largest.

    One cone program for the commanded forces f and, for each disturbance, the contact forces f_i
    that resist it:

        maximise    s + 0.001 sum of f_n / budget
        subject to  G f = -w,   f in the friction cones,   normal_min <= f_n <= normal_max,
                    torque_min <= J_h' f + tau_ext <= torque_max,   sum of f_n <= budget,
                    G f_i = -(w + s d_i),   f_i in the friction cones,
                    |J_h' (f_i - f)| <= joint friction,   s <= `LARGEST_MULTIPLE`.

    The friction of the problem is what f is planned with and what resists: pass less than the true
    coefficient to keep a reserve. `docs/holding.md` shakes grasps with such forces.

    Args:
        problem: a single one, without padding; its objective plays no part.
        budget: N, largest sum of normal forces.
        disturbances: (k, 6) wrenches in the frame of the problem, N and N·m.
        length: m, that torques on the object are scaled with: its largest radius.
        joint_friction: N·m, dry, in every joint.
        exact: whether to move f inside its constraints, so that the judge finds it feasible,
            instead of leaving the rounding of Clarabel, about 1e-9.

    Returns:
        The forces in the contact frames; None where there are none that keep the constraints.

    Raises:
        ProblemError: an argument of another shape, or out of its range.
        SolverError: Clarabel found neither forces nor that there are none, or the constraints leave
            so little room that rounding fills it.
    """
    _checked(problem, np.zeros(3 * as_problem(problem).n_contacts), length)
    disturbances = _checked_disturbances(disturbances, joint_friction)
    if not _between(0.0, budget):
        raise ProblemError(f"the budget must be a positive number of newtons, not {budget!r}")
    planned = _planned(
        problem,
        budget * (1.0 - _SPARED) if exact else budget,
        disturbances,
        length,
        joint_friction,
    )
    if planned is None or not exact:
        return planned
    forces = _moved_inside(problem, planned)
    if forces is None or forces[2::3].sum() > budget:
        raise SolverError("the constraints leave too little room for forces that keep them exactly")
    return forces


def _planned(
    problem: GraspForceProblem,
    budget: float,
    disturbances: Array,
    length: float,
    joint_friction: float,
) -> Array | None:
    """(3n,) N: the program of `most_passive_resistance`, as Clarabel solves it."""
    n_forces, n_joints = problem.hand_jacobian.shape
    count = len(disturbances)
    size = (count + 1) * n_forces + 1
    scale = np.repeat([1.0, 1.0 / length], 3)
    copies = np.eye(count + 1)
    # unknowns: commanded forces, forces under each disturbance, the multiple s
    balance = np.zeros((6 * (count + 1), size))
    balance[:, :-1] = np.kron(copies, scale[:, None] * problem.grasp_map)
    balance[6:, -1] = (scale * disturbances).ravel()
    zero = Rows(-balance, np.tile(scale * problem.external_wrench, count + 1))
    felt = np.zeros((count * n_joints, size))
    felt[:, n_forces:-1] = np.kron(np.eye(count), problem.hand_jacobian.T)
    felt[:, :n_forces] = -np.tile(problem.hand_jacobian.T, (count, 1))
    limits = force_limits(problem, budget, size)
    largest = np.zeros((1, size))
    largest[0, -1] = 1.0
    friction = np.full(len(felt), joint_friction / JOINT_SCALE)
    positive = Rows(
        np.vstack([limits.matrix, -felt / JOINT_SCALE, felt / JOINT_SCALE, largest]),
        np.concatenate([limits.bound, friction, friction, [LARGEST_MULTIPLE]]),
    )
    cones = np.zeros(((count + 1) * n_forces, size))
    cones[:, :-1] = np.kron(copies, cone_rows(problem.friction))
    gain = np.zeros(size)
    gain[2:n_forces:3] = _TIE / budget
    gain[-1] = 1.0
    found = maximise(gain, zero, positive, Rows(cones, np.zeros(len(cones))))
    return None if found is None else found[:n_forces]


def _moved_inside(problem: GraspForceProblem, forces: Array) -> Array | None:
    """(3n,) N: forces next to these that the judge finds feasible; None if there are none."""
    flat = problem.constraints().flat()
    unknown = Multipliers(np.full((1, 6), np.nan), np.full((1, problem.n_joints), np.nan))
    candidate = Candidate(forces[None], unknown, np.array([""]))
    moved = finished(flat, candidate, np.array([0])).forces
    feasible = judge(flat, moved, unknown).status[0] in (Status.FEASIBLE, Status.OPTIMAL)
    return np.asarray(moved[0]) if feasible else None


def _checked(problem: GraspForceProblem, forces: Array, length: float) -> Array:
    """The forces as an array, if the programs can answer them, the problem and the length."""
    if as_problem(problem).batch_shape or not problem.contact_mask.all():
        raise ProblemError("the problem must be a single one, without padding contacts")
    problem.plain_arrays(0)
    if not _between(0.0, length):
        raise ProblemError(f"the length must be a positive number of metres, not {length!r}")
    count = 3 * problem.n_contacts
    try:
        array = plain_array("forces", forces, (count,))
    except ProblemError as error:
        raise ProblemError(f"forces must be {count} finite numbers: {error}") from error
    if not np.isfinite(array).all():
        raise ProblemError(f"forces must be {count} finite numbers; some are not")
    return array


def _checked_disturbances(disturbances: Array, joint_friction: float) -> Array:
    rows = np.shape(disturbances)[0] if np.ndim(disturbances) else 0
    array = plain_array("disturbances", disturbances, (max(rows, 1), 6))
    if not np.isfinite(array).all():
        raise ProblemError("disturbances must be finite wrenches, one or more rows of 6")
    if not (joint_friction == 0.0 or _between(0.0, joint_friction)):
        raise ProblemError(
            f"joint_friction must be 0 N·m or more, and finite, not {joint_friction!r}"
        )
    return array


def _between(low: float, number: Any) -> bool:
    return isinstance(number, Real) and low < float(number) < np.inf


def _balance(problem: GraspForceProblem, length: float) -> Rows:
    """G f + w, torques over the length."""
    units = _torque_units(length)
    return Rows(-problem.grasp_map / units[:, None], problem.external_wrench / units)


def _torque_units(length: float) -> Array:
    return np.repeat([1.0, length], 3)
