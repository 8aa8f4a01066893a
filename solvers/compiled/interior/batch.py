"""A compiled interior-point solver for batches of grasp force problems."""

from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from typing import Any

import numpy as np
from numba import njit

from solvers.arrays import Array, Indices
from solvers.problem import OBJECTIVES, GraspForceProblem

from ..arrays import ProblemArrays, one_of
from ..cache import digest
from ..constants import MIN_NORM
from .answer import needs_no_force, write_forces, write_multipliers
from .check import all_numbers, contradicts, shrink, strictly_feasible
from .form import (
    ALLOCATING,
    ENTRY,
    OPTIONS,
    Form,
    drop_equations,
    moves_freely,
    new_form,
    reduce_equations,
    scale_problem,
    tighten,
)
from .kkt import System, new_system
from .path import SOLVED as SOLVED_PATH
from .path import STUCK, UNBOUNDED_DUAL, follow
from .state import Path, new_path

SOLVED = 0
"""Forces that satisfy every inequality exactly, with multipliers of their optimum."""
INFEASIBLE = 1
"""Multipliers that prove that there are no forces."""
INEXACT = 2
"""Forces that may miss constraints by rounding, as these leave no interior; or the optimum."""
FAILED = 3
"""Neither; forces and multipliers are the last attempt, or NaN."""

MARGINS = (1e-10, 3e-9, 3e-8, 0.0)
"""How far inside its constraints a problem is solved, relative to the force scale: the first that
leaves every inequality satisfied. Weak friction and little room ask for the second, friction from
1e-8 to 1e3 for the third; where the constraints have no interior, the last."""

_BALANCE = 1e-12
"""Equilibrium residual, relative to the forces, that counts as none."""

_IDLE = 1e-8
"""Normal force, relative to the largest, of a contact that does not push."""

_EQUATION = 0.5e-12
"""Error of a pinned torque that counts as none, relative to the torque that the forces cause
through the longest column of J_h: half of what the judge allows."""

_RELAXED = (-1e-9, -1e-7, -1e-5)
"""A problem whose proof lacks a margin is relaxed by so much: proofs then meet its own cones."""

_CHUNK = 64
"""Problems that a thread takes at once."""


@njit(**OPTIONS)
def _solve_one(
    form: Form,
    system: System,
    path: Path,
    problem: ProblemArrays,
    objective: int,
    forces: Array,
    nu: Array,
    price: Array,
) -> int:
    forces[:] = 0.0
    nu[:] = 0.0
    price[:] = 0.0
    form.frozen[:] = False
    if needs_no_force(problem):
        return SOLVED
    if not (all_numbers(problem) and scale_problem(form, problem)):
        forces[:] = np.nan
        nu[:] = np.nan
        price[:] = np.nan
        return FAILED
    unit = form.scale[0] if objective == MIN_NORM else 1.0
    end = STUCK
    whole = True
    while True:
        if not moves_freely(form):
            contradiction = reduce_equations(form)
            if whole and contradiction >= 0 and contradicts(form, path.y, contradiction):
                write_multipliers(form, system, path.y, unit, nu, price)
                forces[:] = np.nan
                return INFEASIBLE
            drop_equations(form)
        for margin in MARGINS:
            tighten(form, objective, margin)
            end = follow(form, system, path, objective)
            if whole:
                if end != UNBOUNDED_DUAL and objective != MIN_NORM:
                    shrink(form, path.best_x, path.best_y, objective)
                write_multipliers(form, system, path.best_y, unit, nu, price)
                if end == UNBOUNDED_DUAL:
                    forces[:] = np.nan
                    return INFEASIBLE
            # without a margin, whether an inequality holds depends on the order of its sums
            held = end != UNBOUNDED_DUAL and _holds(form, system, path, problem, forces)
            if held and margin > 0.0:
                return SOLVED if end == SOLVED_PATH else INEXACT
        if not whole:
            for k in range(len(forces)):
                forces[k] = path.first[k]
            return INEXACT
        if end == STUCK:
            break
        if not _freeze(form, path, forces):
            return INEXACT
        whole = False
        scale_problem(form, problem)
    for delta in _RELAXED:
        tighten(form, objective, delta)
        if follow(form, system, path, objective) == UNBOUNDED_DUAL:
            write_multipliers(form, system, path.best_y, unit, nu, price)
            forces[:] = np.nan
            return INFEASIBLE
    return FAILED


@njit(**OPTIONS)
def _holds(form: Form, system: System, path: Path, problem: ProblemArrays, forces: Array) -> bool:
    """Write the path's forces; whether they keep every constraint."""
    miss = write_forces(form, system, path, problem, forces)
    size = 0.0
    for k in range(len(forces)):
        size += forces[k] * forces[k]
    size = np.sqrt(size)
    equation = _EQUATION * max(size, form.scale[0]) * form.scale[2]
    return bool(miss <= _BALANCE * size and strictly_feasible(problem, forces, equation))


@njit(**OPTIONS)
def _freeze(form: Form, path: Path, forces: Array) -> bool:
    """Mark the contacts that do not push in the path's last state; False where all do.

    Constraints without interior leave some contacts no force at all, as a joint without a motor
    does where a contact can only turn it one way. Without these the others may have all the room
    they need; the multipliers stay those of the whole problem, and the forces are kept aside.
    """
    largest = 0.0
    for i in range(form.counts[0]):
        largest = max(largest, abs(path.best_x[i, 2]))
    some = False
    for i in range(form.counts[0]):
        idle = form.lower[i] == 0.0 and abs(path.best_x[i, 2]) <= _IDLE * largest
        form.frozen[i] = idle
        some |= idle
    for k in range(len(forces)):
        path.first[k] = forces[k]
    return some


@njit(**ALLOCATING)
def _solve_range(
    first: int,
    last: int,
    problems: ProblemArrays,
    objective: int,
    forces: Array,
    nu: Array,
    price: Array,
    code: Indices,
) -> None:
    """Problems first to last - 1, one after the other."""
    n, n_tau = problems.friction.shape[1], problems.torque_min.shape[1]
    form, system, path = new_form(n, n_tau), new_system(n, n_tau), new_path(n, n_tau)
    for one in range(first, last):
        problem = one_of(problems, one)
        code[one] = _solve_one(
            form, system, path, problem, objective, forces[one], nu[one], price[one]
        )


def _entry(sources: str) -> Any:
    @njit(**ENTRY)
    def solve_range(first, last, arrays, objective, answer):  # type: ignore[no-untyped-def]
        sources  # noqa: B018 - see `cache.digest`
        _solve_range(first, last, ProblemArrays(*arrays), objective, *answer)

    return solve_range


_solve = _entry(digest())


def solve_batch(
    problem: GraspForceProblem, threads: int = 1
) -> tuple[Array, Array, Array, Indices]:
    """Solve B problems in their own units; each answer is the same whatever the batch and threads.

    Args:
        problem: float64 numpy, one batch dimension; any of `solvers.problem.OBJECTIVES`.
        threads: of this process; each takes a chunk of problems at a time.

    Returns:
        forces (B, 3n) in N, NaN where there is a proof; nu (B, 6); lambda (B, n_tau); and the code
        (B,) int64: SOLVED, INFEASIBLE, INEXACT or FAILED.
    """
    arrays = problem.plain_arrays(1)
    objective = OBJECTIVES.index(problem.objective)
    count = len(problem)
    forces, nu = np.empty((count, 3 * problem.n_contacts)), np.empty((count, 6))
    price, code = np.empty((count, problem.n_joints)), np.empty(count, np.int64)
    answer = (forces, nu, price, code)

    def solve_chunk(first: int) -> None:
        _solve(first, min(first + _CHUNK, count), arrays, objective, answer)

    # threads of Python, not numba's: those would change how many every other library takes
    chunks = range(0, count, _CHUNK)
    several = threads > 1 and len(chunks) > 1
    with ThreadPoolExecutor(threads) if several else nullcontext() as pool:
        for _ in map(solve_chunk, chunks) if pool is None else pool.map(solve_chunk, chunks):
            pass
    return answer
