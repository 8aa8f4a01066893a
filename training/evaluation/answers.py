"""Judged answers of solvers to all problems of an evaluation, and the time they took."""

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from solvers import GraspForceProblem, Solver
from solvers.arrays import Array
from solvers.problem import force_scale, residuals


@dataclass(frozen=True, eq=False)
class JudgedAnswers:
    """A solver's judged answers to all loads of all grasps.

    Args:
        forces: (grasps, phases, 3n) N, zero where there is no answer.
        status: (grasps, phases) judged.
        residual: (grasps, phases) equilibrium residual over the size of the forces or of what the
            data asks for, whichever is larger, as the judge has it.
        friction_violation: (grasps, phases) N.
        torque_violation: (grasps, phases) N·m.
        gap: (grasps, phases) certified, NaN unless feasible.
        time_ms: per problem, NaN for a control.
    """

    forces: Array
    status: NDArray[np.str_]
    residual: Array
    friction_violation: Array
    torque_violation: Array
    gap: Array
    time_ms: float


def judged_answers(problems: GraspForceProblem, solver: Solver) -> JudgedAnswers:
    """Solve, judge and time; a first small batch, not timed, pays for imports and compilation."""
    solver.solve(problems[:1])
    started = time.perf_counter()
    solution = solver.solve(problems)
    elapsed = time.perf_counter() - started
    return judged(problems, np.asarray(solution.forces), solution.status, solution.gap, elapsed)


def judged(
    problems: GraspForceProblem,
    forces: Array,
    status: NDArray[np.str_],
    gap: Array,
    elapsed: float,
) -> JudgedAnswers:
    """Answers out of forces, with the verdict on them; forces that are not numbers become zero.

    Args:
        problems: (grasps, phases).
        forces: (grasps, phases, 3n) N.
        status: (grasps, phases), from the judge.
        gap: (grasps, phases), from the judge.
        elapsed: s, for all of them.
    """
    known = np.all(np.isfinite(forces), axis=-1)
    finite = np.where(known[..., None], forces, 0.0)
    size = np.maximum(np.linalg.norm(finite, axis=-1), force_scale(problems))

    def if_known(values: Array) -> Array:
        return np.where(known, values, np.nan)

    return JudgedAnswers(
        forces=finite,
        status=status,
        residual=if_known(residuals.equilibrium_residual(problems, finite) / size),
        friction_violation=if_known(residuals.friction_violation(problems, finite)),
        torque_violation=if_known(residuals.torque_violation(problems, finite)),
        gap=gap,
        time_ms=1e3 * elapsed / known.size,
    )
