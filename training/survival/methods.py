"""Forces of several methods for one load, at several efforts.

Effort is the sum of normal forces. A level is N of effort more than the least-norm forces take, for
each contact. Every method plans with the friction and torque limits of the problem that it is given
and knows the weight; only `PASSIVE` knows which disturbances there are, and it does not know when.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from gfo_env.holding import JOINT_FRICTION
from solvers import GraspForceProblem, make_solver
from solvers.problem import MAX_QUALITY

from .conic import Rows, maximise
from .passive import JOINT_SCALE, LARGEST_MULTIPLE, friction_cones

LEAST_NORM = "least_norm"
UNIFORM = "uniform_preload"
SQUEEZE = "equal_squeeze"
MARGIN = "friction_margin"
QUALITY = "quality_search"
PASSIVE = "passive_resistance"

LABELS = {
    LEAST_NORM: "least norm, no preload",
    UNIFORM: "least norm, uniform preload",
    SQUEEZE: "equal squeeze",
    MARGIN: "most friction to spare",
    QUALITY: "most q_lrw",
    PASSIVE: "most passive resistance",
}

LEVELS = (0.5, 2.0, 5.0)
"""N for each contact."""

TOLERANCE = 0.03
ROUNDS = 40
_TIE = 1e-3
_OUTSIDE = 1e-6

Array = NDArray[np.float64]


def forces_of_methods(
    problem: GraspForceProblem,
    disturbances: Array,
    length: float,
    *,
    joint_friction: float = JOINT_FRICTION,
) -> Iterator[tuple[str, float, Array]]:
    """Method, level in N and forces (3n,) N; nothing where the load cannot be carried.

    Args:
        problem: a single one, without padding, without preload.
        disturbances: (k, 6) wrenches in its frame.
        length: m, largest radius of the object.
        joint_friction: N·m, dry.
    """
    least = make_solver("dual_newton").solve(problem)
    if str(least.status) not in ("optimal", "feasible"):
        return
    forces = np.asarray(least.forces)
    yield LEAST_NORM, 0.0, forces
    budgets = forces[2::3].sum() + problem.n_contacts * np.array(LEVELS)
    posed = problem.replace(
        objective=MAX_QUALITY, effort_budget=budgets, characteristic_length=length
    )
    uniform = np.asarray(make_solver(UNIFORM).solve(posed).forces)
    search = make_solver(QUALITY, tolerance=TOLERANCE, rounds=ROUNDS)
    best = np.asarray(search.solve(posed).forces)
    for k, (level, budget) in enumerate(zip(LEVELS, budgets, strict=True)):
        squeeze = np.zeros_like(forces)
        squeeze[2::3] = uniform[k, 2::3].mean()
        found = {
            UNIFORM: uniform[k],
            SQUEEZE: squeeze,
            MARGIN: most_friction_to_spare(problem, float(budget)),
            QUALITY: best[k],
            PASSIVE: most_passive_resistance(
                problem, float(budget), disturbances, length, joint_friction=joint_friction
            ),
        }
        for method, made in found.items():
            if made is not None and np.isfinite(made).all():
                yield method, level, made


def most_friction_to_spare(problem: GraspForceProblem, budget: float) -> Array | None:
    """(3n,) N: the largest least mu f_n - |f_t| over contacts; None where nothing is feasible.

    Args:
        problem: a single one, without padding.
        budget: N, largest sum of normal forces.
    """
    size = 3 * problem.n_contacts
    scale = _wrench_scale(problem)
    zero = Rows(
        np.column_stack([scale[:, None] * problem.grasp_map, np.zeros(6)]),
        scale * problem.external_wrench,
    )
    cones = friction_cones(problem, np.ones(problem.n_contacts))
    limits = _limits(problem, budget, size + 1)
    found = maximise(np.append(np.zeros(size), 1.0), zero, limits, cones)
    return None if found is None or found[-1] < -_OUTSIDE else found[:-1]


def most_passive_resistance(
    problem: GraspForceProblem,
    budget: float,
    disturbances: Array,
    length: float,
    *,
    joint_friction: float = JOINT_FRICTION,
) -> Array | None:
    """(3n,) N whose least passive resistance over disturbances is largest, in planned friction.

    One program for the commanded forces and, for each disturbance, the contact forces that resist
    it; of equals the one with more effort. None where nothing is feasible.

    Args:
        problem: a single one, without padding.
        budget: N, largest sum of normal forces.
        disturbances: (k, 6) wrenches in the frame of the problem.
        length: m, that torques are scaled with.
        joint_friction: N·m, dry.
    """
    n_forces, n_joints = problem.hand_jacobian.shape
    count = len(disturbances)
    size = (count + 1) * n_forces + 1
    scale = np.repeat([1.0, 1.0 / length], 3)
    copies = np.eye(count + 1)
    # unknowns: commanded forces, forces under each disturbance, the multiple s
    balance = np.zeros((6 * (count + 1), size))
    balance[:, :-1] = np.kron(copies, scale[:, None] * problem.grasp_map)
    balance[6:, -1] = (scale * disturbances).ravel()
    zero = Rows(balance, np.tile(scale * problem.external_wrench, count + 1))
    felt = np.zeros((count * n_joints, size))
    felt[:, n_forces:-1] = np.kron(np.eye(count), problem.hand_jacobian.T)
    felt[:, :n_forces] = -np.tile(problem.hand_jacobian.T, (count, 1))
    limits = _limits(problem, budget, size)
    largest = np.zeros((1, size))
    largest[0, -1] = -1.0
    friction = np.full(len(felt), joint_friction / JOINT_SCALE)
    positive = Rows(
        np.vstack([limits.matrix, felt / JOINT_SCALE, -felt / JOINT_SCALE, largest]),
        np.concatenate([limits.constant, friction, friction, [LARGEST_MULTIPLE]]),
    )
    cone = friction_cones(problem, np.zeros(problem.n_contacts)).matrix[:, :-1]
    cones = np.zeros(((count + 1) * n_forces, size))
    cones[:, :-1] = np.kron(copies, cone)
    gain = np.zeros(size)
    gain[2:n_forces:3] = _TIE / budget
    gain[-1] = 1.0
    found = maximise(gain, zero, positive, Rows(cones, np.zeros(len(cones))))
    return None if found is None else found[:n_forces]


def _limits(problem: GraspForceProblem, budget: float, size: int) -> Rows:
    """Torque limits and budget; the forces are the first of `size` unknowns."""
    torque = np.zeros((problem.n_joints, size))
    torque[:, : 3 * problem.n_contacts] = problem.hand_jacobian.T
    effort = np.zeros((1, size))
    effort[0, 2 : 3 * problem.n_contacts : 3] = -1.0
    return Rows(
        np.vstack([-torque / JOINT_SCALE, torque / JOINT_SCALE, effort]),
        np.concatenate(
            [
                (problem.torque_max - problem.external_torque) / JOINT_SCALE,
                (problem.external_torque - problem.torque_min) / JOINT_SCALE,
                [budget],
            ]
        ),
    )


def _wrench_scale(problem: GraspForceProblem) -> Array:
    """(6,) that makes forces and torques of the grasp map alike in size."""
    arm = np.linalg.norm(problem.grasp_map[3:], axis=0).max()
    return np.repeat([1.0, 1.0 / arm], 3)
