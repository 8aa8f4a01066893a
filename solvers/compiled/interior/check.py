"""What forces and multipliers are worth: strict feasibility, and proofs of infeasibility."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..objectives import MIN_MAX_NORMAL
from .form import OPTIONS, Floats, Form

PROOF = 4e-9
"""Relative Farkas value at which the path stops: above what the judge asks for, which adds the same
terms up in other coordinates."""

_ALMOST = 1e-8
"""How far beyond the edge multipliers of a linear objective still count as feasible."""

_HORIZON = 1e6
"""`solvers.duality.FORCE_HORIZON`, in units of the force scale."""


@njit(**OPTIONS)
def farkas(form: Form, y: Floats) -> float:
    """`solvers.duality.farkas_value` of multipliers in the units of the form."""
    value = size = 0.0
    for k in range(6):
        term = -y[k] * form.load[k]
        value += term
        size += abs(term)
    for j in range(form.counts[1]):
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
            if j >= 0:
                limit = form.torque_upper[j] if price > 0.0 else form.torque_lower[j]
                price = price if np.isfinite(limit) else 0.0
            q0 += form.rows[i, a, 0] * price
            q1 += form.rows[i, a, 1] * price
            q2 += form.rows[i, a, 2] * price
        slope = q2 - form.friction[i] * np.sqrt(q0 * q0 + q1 * q1)
        cap = form.upper[i] if np.isfinite(form.upper[i]) else _HORIZON
        term = slope * (cap if slope < 0.0 else form.lower[i])
        value += term
        size += abs(term)
    return value / size if size > 0.0 else 0.0


@njit(**OPTIONS)
def _slope(form: Form, y: Floats, i: int) -> float:
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
def shrink(form: Form, x: Floats, y: Floats, objective: int) -> None:
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
def all_numbers(array: Floats, finite: bool) -> bool:
    """No NaN, and nothing infinite where `finite`."""
    sound = True
    for value in array.flat:
        sound &= not (np.isnan(value) or (finite and np.isinf(value)))
    return sound


@njit(**OPTIONS)
def strictly_feasible(
    forces: Floats,
    hand_jacobian: Floats,
    friction: Floats,
    torque_min: Floats,
    torque_max: Floats,
    external_torque: Floats,
    normal_min: Floats,
    normal_max: Floats,
    mask: NDArray[np.bool_],
) -> bool:
    """Whether every inequality holds exactly, in float64 and in the problem's own units."""
    for i in range(len(friction)):
        if not mask[i]:
            continue
        normal = forces[3 * i + 2]
        size = np.sqrt(forces[3 * i] * forces[3 * i] + forces[3 * i + 1] * forces[3 * i + 1])
        if not (size <= friction[i] * normal and normal_min[i] <= normal <= normal_max[i]):
            return False
    for j in range(len(torque_min)):
        torque = 0.0
        for k in range(len(forces)):
            torque += hand_jacobian[k, j] * forces[k]
        torque += external_torque[j]
        if not torque_min[j] <= torque <= torque_max[j]:
            return False
    return True
