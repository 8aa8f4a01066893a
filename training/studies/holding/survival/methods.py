"""Forces of several methods for one load, at several efforts.

Effort is the sum of normal forces. A level is N of effort more than the least-norm forces take, for
each contact. Every method plans with the friction and torque limits of the problem that it is given
and knows the weight; only `PASSIVE` knows which disturbances there are, and it does not know when.
"""

from collections.abc import Iterator

import numpy as np

from gfo_env.conditions import JOINT_FRICTION
from solvers import GraspForceProblem, make_solver
from solvers.arrays import Array
from solvers.conic import Rows, cone_rows, force_limits, maximise
from solvers.passive_resistance import most_passive_resistance
from solvers.problem import MAX_QUALITY

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
_OUTSIDE = 1e-6


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
                problem,
                float(budget),
                disturbances,
                length,
                joint_friction=joint_friction,
                exact=False,
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
        np.column_stack([-scale[:, None] * problem.grasp_map, np.zeros(6)]),
        scale * problem.external_wrench,
    )
    spare = np.tile([1.0, 0.0, 0.0], problem.n_contacts)
    cones = Rows(np.column_stack([cone_rows(problem.friction), spare]), np.zeros(size))
    limits = force_limits(problem, budget, size + 1)
    found = maximise(np.append(np.zeros(size), 1.0), zero, limits, cones)
    return None if found is None or found[-1] < -_OUTSIDE else found[:-1]


def _wrench_scale(problem: GraspForceProblem) -> Array:
    """(6,) that makes forces and torques of the grasp map alike in size."""
    arm = np.linalg.norm(problem.grasp_map[3:], axis=0).max()
    return np.repeat([1.0, 1.0 / arm], 3)
