"""A compiled interior-point solver for batches of grasp force problems."""

from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..cache import digest
from ..objectives import MIN_NORM
from .answer import needs_no_force, write_forces, write_multipliers
from .check import all_numbers, shrink, strictly_feasible
from .form import ALLOCATING, ENTRY, OPTIONS, Floats, Form, new_form, scale_problem, tighten
from .kkt import System, new_system
from .path import STUCK, UNBOUNDED_DUAL, follow
from .state import Path, new_path

Booleans = NDArray[np.bool_]
Integers = NDArray[np.int64]

SOLVED = 0
"""Forces that satisfy every inequality exactly, with multipliers of their optimum."""
INFEASIBLE = 1
"""Multipliers that prove that there are no forces."""
INEXACT = 2
"""Optimal forces that may miss constraints by rounding: these leave no interior."""
FAILED = 3
"""Neither; forces and multipliers are the last attempt, or NaN."""

MARGINS = (1e-10, 3e-9, 0.0)
"""How far inside its constraints a problem is solved, relative to the force scale: the first that
leaves every inequality satisfied. Weak friction and little room ask for the second; where the
constraints have no interior, the last."""

_BALANCE = 1e-12
"""Equilibrium residual, relative to the forces, that counts as none."""

_RELAXED = (-1e-9, -1e-7, -1e-5)
"""A problem whose proof lacks a margin is relaxed by so much: proofs then meet its own cones."""

_CHUNK = 64
"""Problems that a thread takes at once."""


@njit(**OPTIONS)
def _solve_one(
    form: Form,
    system: System,
    path: Path,
    grasp_map: Floats,
    hand_jacobian: Floats,
    friction: Floats,
    torque_min: Floats,
    torque_max: Floats,
    wrench: Floats,
    external_torque: Floats,
    normal_min: Floats,
    normal_max: Floats,
    mask: Booleans,
    objective: int,
    forces: Floats,
    nu: Floats,
    price: Floats,
) -> int:
    forces[:] = 0.0
    nu[:] = 0.0
    price[:] = 0.0
    if needs_no_force(torque_min, torque_max, wrench, external_torque, normal_min):
        return SOLVED
    numbers = (
        all_numbers(grasp_map, True)
        and all_numbers(hand_jacobian, True)
        and all_numbers(friction, True)
        and all_numbers(wrench, True)
        and all_numbers(external_torque, True)
        and all_numbers(normal_min, True)
        and all_numbers(torque_min, False)
        and all_numbers(torque_max, False)
        and all_numbers(normal_max, False)
    )
    if not numbers or not scale_problem(
        form,
        grasp_map,
        hand_jacobian,
        friction,
        torque_min,
        torque_max,
        wrench,
        external_torque,
        normal_min,
        normal_max,
        mask,
    ):
        forces[:] = np.nan
        nu[:] = np.nan
        price[:] = np.nan
        return FAILED
    unit = form.scale[0] if objective == MIN_NORM else 1.0
    end = STUCK
    for margin in MARGINS:
        tighten(form, objective, margin)
        end = follow(form, system, path, objective)
        if end != UNBOUNDED_DUAL and objective != MIN_NORM:
            shrink(form, path.best_x, path.best_y, objective)
        write_multipliers(form, path.best_y, unit, nu, price)
        if end == UNBOUNDED_DUAL:
            forces[:] = np.nan
            return INFEASIBLE
        miss = write_forces(form, system, path, grasp_map, wrench, normal_min, normal_max, forces)
        if end == STUCK:
            continue
        size = 0.0
        for k in range(len(forces)):
            size += forces[k] * forces[k]
        strict = miss <= _BALANCE * np.sqrt(size) and strictly_feasible(
            forces,
            hand_jacobian,
            friction,
            torque_min,
            torque_max,
            external_torque,
            normal_min,
            normal_max,
            mask,
        )
        # without a margin, whether an inequality holds depends on the order of its sums
        if strict and margin > 0.0:
            for j in range(form.counts[1]):
                if form.pinned[j]:
                    return INEXACT
            return SOLVED
    if end != STUCK:
        return INEXACT
    for delta in _RELAXED:
        tighten(form, objective, delta)
        if follow(form, system, path, objective) == UNBOUNDED_DUAL:
            write_multipliers(form, path.best_y, unit, nu, price)
            forces[:] = np.nan
            return INFEASIBLE
    return FAILED


@njit(**ALLOCATING)
def _solve_range(
    first: int,
    last: int,
    grasp_map: Floats,
    hand_jacobian: Floats,
    friction: Floats,
    torque_min: Floats,
    torque_max: Floats,
    wrench: Floats,
    external_torque: Floats,
    normal_min: Floats,
    normal_max: Floats,
    mask: Booleans,
    objective: int,
    forces: Floats,
    nu: Floats,
    price: Floats,
    code: Integers,
) -> None:
    """Problems first to last - 1, one after the other."""
    n, n_tau = friction.shape[1], torque_min.shape[1]
    form, system, path = new_form(n, n_tau), new_system(n, n_tau), new_path(n, n_tau)
    for one in range(first, last):
        code[one] = _solve_one(
            form,
            system,
            path,
            grasp_map[one],
            hand_jacobian[one],
            friction[one],
            torque_min[one],
            torque_max[one],
            wrench[one],
            external_torque[one],
            normal_min[one],
            normal_max[one],
            mask[one],
            objective,
            forces[one],
            nu[one],
            price[one],
        )


def _entry(sources: str) -> Any:
    @njit(**ENTRY)
    def solve_range(*arguments):  # type: ignore[no-untyped-def]
        sources  # noqa: B018 - see `sources.digest`
        _solve_range(*arguments)

    return solve_range


_solve = _entry(digest())


def solve_batch(
    grasp_map: Floats,
    hand_jacobian: Floats,
    friction: Floats,
    torque_min: Floats,
    torque_max: Floats,
    external_wrench: Floats,
    external_torque: Floats,
    normal_min: Floats,
    normal_max: Floats,
    contact_mask: Booleans,
    objective: int,
    threads: int = 1,
) -> tuple[Floats, Floats, Floats, Integers]:
    """Solve B problems in their own units; each answer is the same whatever the batch and threads.

    The fields of `GraspForceProblem` as float64 numpy arrays with one batch dimension, in order.

    Args:
        grasp_map: (B, 6, 3n).
        hand_jacobian: (B, 3n, n_tau).
        friction: (B, n).
        torque_min: (B, n_tau).
        torque_max: (B, n_tau).
        external_wrench: (B, 6).
        external_torque: (B, n_tau).
        normal_min: (B, n).
        normal_max: (B, n).
        contact_mask: (B, n) bool.
        objective: position in `solvers.problem.OBJECTIVES`.
        threads: how many problems to solve at a time.

    Returns:
        forces (B, 3n) in N, NaN where there is a proof; nu (B, 6); lambda (B, n_tau); and the code
        (B,) int64: SOLVED, INFEASIBLE, INEXACT or FAILED.
    """
    arrays = [
        np.require(array, dtype=np.float64, requirements=["C", "W"])
        for array in (
            grasp_map,
            hand_jacobian,
            friction,
            torque_min,
            torque_max,
            external_wrench,
            external_torque,
            normal_min,
            normal_max,
        )
    ]
    mask = np.require(contact_mask, dtype=np.bool_, requirements=["C", "W"])
    count, n = arrays[2].shape
    forces, nu = np.empty((count, 3 * n)), np.empty((count, 6))
    price, code = np.empty((count, arrays[3].shape[1])), np.empty(count, np.int64)
    answer = (forces, nu, price, code)

    def solve_chunk(first: int) -> None:
        _solve(first, min(first + _CHUNK, count), *arrays, mask, objective, *answer)

    # threads of Python, not numba's: those would change how many every other library takes
    chunks = range(0, count, _CHUNK)
    several = threads > 1 and len(chunks) > 1
    with ThreadPoolExecutor(threads) if several else nullcontext() as pool:
        for _ in map(solve_chunk, chunks) if pool is None else pool.map(solve_chunk, chunks):
            pass
    return answer
