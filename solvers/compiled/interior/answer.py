"""From the path's last state to an answer in the problem's own units."""

import numpy as np
from numba import njit

from solvers.arrays import Array

from ..arrays import ProblemArrays
from .form import INLINE, OPTIONS, Form, moves_freely
from .kkt import System
from .state import Path

_ROUNDING = 1e-14
"""Error of an equation, relative to the forces, that is left as it is."""

_SLIDING = 10.0
"""Friction times this is the part that tangential forces take in a correction, at most one."""


@njit(**OPTIONS)
def needs_no_force(problem: ProblemArrays) -> bool:
    """Zero forces hold, and are then the optimum of every objective."""
    for k in range(6):
        if problem.external_wrench[k] != 0.0:
            return False
    for i in range(len(problem.normal_min)):
        if problem.normal_min[i] != 0.0:
            return False
    within = True
    for j in range(len(problem.torque_min)):
        within &= problem.torque_min[j] <= problem.external_torque[j] <= problem.torque_max[j]
    return within


@njit(**OPTIONS)
def write_multipliers(
    form: Form, system: System, y: Array, unit: float, nu: Array, price: Array
) -> None:
    """nu and lambda of the problem from those of the form."""
    own = system.height
    for k in range(len(y)):
        own[k] = y[k]
    if not moves_freely(form):
        for k in range(5 + form.counts[3], -1, -1):
            for other in range(k + 1, 6 + form.counts[3]):
                own[k] -= form.mixing[other, k] * own[other]
            own[k] /= form.mixing[k, k]
    for k in range(5, -1, -1):
        value = own[k]
        for other in range(k + 1, 6):
            value -= form.triangle[other, k] * nu[other]
        nu[k] = value / form.triangle[k, k]
    for k in range(6):
        nu[k] *= unit if k < 3 else unit / form.scale[1]
    for j in range(form.counts[1]):
        price[form.joint[j]] = unit * own[6 + j] / form.joint_scale[j]


@njit(**OPTIONS)
def write_forces(
    form: Form, system: System, path: Path, problem: ProblemArrays, forces: Array
) -> float:
    """The path's forces in N, moved to the nearest that meet all equations.

    Components that cannot move stay where they are.

    Returns:
        The equilibrium residual that is left, N.
    """
    n, equations = form.counts[0], 6 + form.counts[3]
    scale = form.scale[0]
    forces[:] = 0.0
    for i in range(n):
        one = form.contact[i]
        for c in range(2):
            forces[3 * one + c] = scale * path.best_x[i, c] if form.slides[i] else 0.0
        normal = scale * (path.best_x[i, 2] if form.presses[i] else form.fixed[i])
        forces[3 * one + 2] = normal
        if not form.presses[i]:
            forces[3 * one + 2] = min(max(normal, problem.normal_min[one]), problem.normal_max[one])
    _factor_gram(form, system.schur)
    gram, error = system.schur, system.height
    free = moves_freely(form)
    size = scale
    for k in range(len(forces)):
        size = max(size, abs(forces[k]))
    for _ in range(2):
        _miss(form, problem, forces, error)
        if not free:
            for a in range(equations):
                for b in range(a):
                    error[a] -= form.mixing[a, b] * error[b]
                # what nothing can balance is left as it is, and rounding is not blown up
                moves = form.kept[a] and abs(error[a]) > _ROUNDING * size
                error[a] = error[a] / form.mixing[a, a] if moves else 0.0
        for a in range(equations):
            for b in range(a):
                error[a] -= gram[a, b] * error[b]
            error[a] /= gram[a, a]
        for a in range(equations - 1, -1, -1):
            for b in range(a + 1, equations):
                error[a] -= gram[b, a] * error[b]
            error[a] /= gram[a, a]
        for i in range(n):
            start = 3 * form.contact[i]
            slide, press = _mobility(form, i)
            for a in range(equations):
                forces[start] -= slide * form.rows[i, a, 0] * error[a]
                forces[start + 1] -= slide * form.rows[i, a, 1] * error[a]
                forces[start + 2] -= press * form.rows[i, a, 2] * error[a]
    _miss(form, problem, forces, error)
    square = 0.0
    for a in range(6):
        square += error[a] * error[a]
    return np.sqrt(square)


@njit(**INLINE)
def _mobility(form: Form, i: int) -> tuple[float, float]:
    """By how much contact i takes part in a correction: tangential forces, normal force.

    Little friction leaves tangential forces little room.
    """
    slide = min(1.0, _SLIDING * form.friction[i]) if form.slides[i] else 0.0
    return slide, 1.0 if form.presses[i] else 0.0


@njit(**OPTIONS)
def _factor_gram(form: Form, gram: Array) -> None:
    """Cholesky factor of the equations' products, in the components that take part."""
    n, equations = form.counts[0], 6 + form.counts[3]
    for a in range(equations):
        for b in range(equations):
            gram[a, b] = 0.0
    for i in range(n):
        slide, press = _mobility(form, i)
        for a in range(equations):
            for b in range(a + 1):
                gram[a, b] += slide * form.rows[i, a, 0] * form.rows[i, b, 0]
                gram[a, b] += slide * form.rows[i, a, 1] * form.rows[i, b, 1]
                gram[a, b] += press * form.rows[i, a, 2] * form.rows[i, b, 2]
    for a in range(equations):
        whole = gram[a, a]
        for b in range(a):
            for c in range(b):
                gram[a, b] -= gram[a, c] * gram[b, c]
            gram[a, b] /= gram[b, b]
            gram[a, a] -= gram[a, b] * gram[a, b]
        # a row that no component can balance is left as it is
        gram[a, a] = np.sqrt(gram[a, a]) if gram[a, a] > 1e-13 * max(whole, 1e-13) else 1e30


@njit(**OPTIONS)
def _miss(form: Form, problem: ProblemArrays, forces: Array, error: Array) -> None:
    """Fill in by how much the forces miss the equations, as `scale_problem` has written them; N."""
    n = form.counts[0]
    for k in range(6):
        error[k] = problem.external_wrench[k]
        for i in range(n):
            start = 3 * form.contact[i]
            for c in range(3):
                error[k] += problem.grasp_map[k, start + c] * forces[start + c]
        error[k] *= 1.0 if k < 3 else 1.0 / form.scale[1]
    for a in range(6):
        for b in range(a):
            error[a] -= form.triangle[a, b] * error[b]
        error[a] /= form.triangle[a, a]
    for k in range(form.counts[3]):
        j = form.joint[k]
        torque = problem.external_torque[j]
        torque -= 0.5 * (problem.torque_min[j] + problem.torque_max[j])
        for i in range(n):
            start = 3 * form.contact[i]
            for c in range(3):
                torque += problem.hand_jacobian[start + c, j] * forces[start + c]
        error[6 + k] = torque / form.joint_scale[k]
