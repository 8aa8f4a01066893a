"""What forces and multipliers are worth: strict feasibility, and proofs of infeasibility."""

import numpy as np
from numba import njit

from solvers.arrays import Array

from ..arrays import ProblemArrays
from ..constants import FORCE_HORIZON, MIN_MAX_NORMAL
from .form import OPTIONS, Form

PROOF = 4e-9
"""Relative Farkas value at which the path stops: above what the judge asks for, which adds the same
terms up in other coordinates."""

_ALMOST = 1e-8
"""How far beyond the edge multipliers of a linear objective still count as feasible."""


@njit(**OPTIONS)
def farkas(form: Form, y: Array) -> float:
    """`solvers.duality.farkas_value` of multipliers in the units of the form."""
    value = size = 0.0
    for k in range(6 + form.counts[3]):
        term = -y[k] * form.load[k]
        value += term
        size += abs(term)
    for j in range(form.counts[3], form.counts[1]):
        price = y[6 + j]
        limit = form.torque_upper[j] if price > 0.0 else form.torque_lower[j]
        if price != 0.0 and np.isfinite(limit):
            term = -price * limit
            value += term
            size += abs(term)
    for i in range(form.counts[0]):
        q0 = q1 = q2 = 0.0
        for a in range(form.touched[i]):
            price = y[form.row[i, a]]
            j = form.row[i, a] - 6
            if j >= form.counts[3]:
                limit = form.torque_upper[j] if price > 0.0 else form.torque_lower[j]
                price = price if np.isfinite(limit) else 0.0
            q0 += form.rows[i, a, 0] * price
            q1 += form.rows[i, a, 1] * price
            q2 += form.rows[i, a, 2] * price
        slope = q2 - form.friction[i] * np.sqrt(q0 * q0 + q1 * q1)
        cap = form.upper[i] if np.isfinite(form.upper[i]) else FORCE_HORIZON
        term = slope * (cap if slope < 0.0 else form.lower[i])
        value += term
        size += abs(term)
    return value / size if size > 0.0 else 0.0


@njit(**OPTIONS)
def contradicts(form: Form, y: Array, k: int) -> bool:
    """Whether equation k alone, from which all that moves has vanished, proves infeasibility.

    Fills y with the proof.
    """
    for sign in (1.0, -1.0):
        y[:] = 0.0
        y[k] = sign
        if farkas(form, y) > PROOF:
            return True
    return False


@njit(**OPTIONS)
def _slope(form: Form, y: Array, i: int) -> float:
    """Least value of the prices of contact i over its cone's slice with a normal force of one."""
    q0 = q1 = q2 = 0.0
    for a in range(form.touched[i]):
        price = y[form.row[i, a]]
        q0 += form.rows[i, a, 0] * price
        q1 += form.rows[i, a, 1] * price
        q2 += form.rows[i, a, 2] * price
    slope: float = q2 - form.friction[i] * np.sqrt(q0 * q0 + q1 * q1)
    return slope


@njit(**OPTIONS)
def shrink(form: Form, x: Array, y: Array, objective: int) -> None:
    """Shorten multipliers of a linear objective that are dual feasible up to rounding.

    A cap far beyond the forces would otherwise multiply the rounding error into the bound.
    """
    steepest = 1.0
    together = 0.0
    for i in range(form.counts[0]):
        if x[i, 2] < 0.5 * form.upper[i]:
            slope = -_slope(form, y, i)
            together += max(slope, 0.0)
            steepest = max(steepest, slope)
    if objective == MIN_MAX_NORMAL:
        steepest = max(together, 1.0)
    if 1.0 < steepest < 1.0 + _ALMOST:
        factor = (1.0 - 1e-15 * (4 + form.counts[0])) / steepest
        for k in range(6 + form.counts[1]):
            y[k] *= factor


@njit(**OPTIONS)
def all_numbers(problem: ProblemArrays) -> bool:
    """No NaN, and nothing infinite but limits that are not there."""
    return (
        _sound(problem.grasp_map, True)
        and _sound(problem.hand_jacobian, True)
        and _sound(problem.friction, True)
        and _sound(problem.external_wrench, True)
        and _sound(problem.external_torque, True)
        and _sound(problem.normal_min, True)
        and _sound(problem.torque_min, False)
        and _sound(problem.torque_max, False)
        and _sound(problem.normal_max, False)
    )


@njit(**OPTIONS)
def _sound(array: Array, finite: bool) -> bool:
    """No NaN, and nothing infinite where `finite`."""
    sound = True
    for value in array.flat:
        sound &= not (np.isnan(value) or (finite and np.isinf(value)))
    return sound


@njit(**OPTIONS)
def strictly_feasible(problem: ProblemArrays, forces: Array, equation: float) -> bool:
    """Whether every inequality holds exactly, in float64 and in the problem's own units.

    Torque limits no farther apart than `equation`, in N·m, are one, and may be missed by as much.
    """
    for i in range(len(problem.friction)):
        if not problem.contact_mask[i]:
            continue
        normal = forces[3 * i + 2]
        size = np.sqrt(forces[3 * i] * forces[3 * i] + forces[3 * i + 1] * forces[3 * i + 1])
        within = problem.normal_min[i] <= normal <= problem.normal_max[i]
        if not (size <= problem.friction[i] * normal and within):
            return False
    for j in range(len(problem.torque_min)):
        torque = 0.0
        for k in range(len(forces)):
            torque += problem.hand_jacobian[k, j] * forces[k]
        torque += problem.external_torque[j]
        low, high = problem.torque_min[j], problem.torque_max[j]
        allowed = equation if high - low <= equation else 0.0
        if not low - allowed <= torque <= high + allowed:
            return False
    return True
