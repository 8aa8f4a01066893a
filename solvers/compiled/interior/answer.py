"""From the path's last state to an answer in the problem's own units."""

import numpy as np
from numba import njit

from solvers.arrays import Array

from ..arrays import ProblemArrays
from .form import OPTIONS, Form
from .kkt import System
from .state import Path


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
def write_multipliers(form: Form, y: Array, unit: float, nu: Array, price: Array) -> None:
    """nu and lambda of the problem from those of the form."""
    for k in range(5, -1, -1):
        value = y[k]
        for other in range(k + 1, 6):
            value -= form.triangle[other, k] * nu[other]
        nu[k] = value / form.triangle[k, k]
    for k in range(6):
        nu[k] *= unit if k < 3 else unit / form.scale[1]
    for j in range(form.counts[1]):
        price[form.joint[j]] = unit * y[6 + j] / form.joint_scale[j]


@njit(**OPTIONS)
def write_forces(
    form: Form, system: System, path: Path, problem: ProblemArrays, forces: Array
) -> float:
    """The path's forces in N, moved to exact equilibrium: the nearest such forces.

    Components that cannot move stay where they are.

    Returns:
        The equilibrium residual that is left, N.
    """
    grasp_map, wrench = problem.grasp_map, problem.external_wrench
    n = form.counts[0]
    scale, arm = form.scale[0], form.scale[1]
    triangle = form.triangle
    forces[:] = 0.0
    for i in range(n):
        one = form.contact[i]
        for c in range(2):
            forces[3 * one + c] = scale * path.best_x[i, c] if form.slides[i] else 0.0
        normal = scale * (path.best_x[i, 2] if form.presses[i] else form.fixed[i])
        forces[3 * one + 2] = normal
        if not form.presses[i]:
            forces[3 * one + 2] = min(max(normal, problem.normal_min[one]), problem.normal_max[one])
    gram, error = system.schur, system.height
    for a in range(6):
        for b in range(6):
            gram[a, b] = 0.0
    for i in range(n):
        for a in range(6):
            for b in range(a + 1):
                if form.slides[i]:
                    gram[a, b] += form.rows[i, a, 0] * form.rows[i, b, 0]
                    gram[a, b] += form.rows[i, a, 1] * form.rows[i, b, 1]
                if form.presses[i]:
                    gram[a, b] += form.rows[i, a, 2] * form.rows[i, b, 2]
    for a in range(6):
        whole = gram[a, a]
        for b in range(a):
            for c in range(b):
                gram[a, b] -= gram[a, c] * gram[b, c]
            gram[a, b] /= gram[b, b]
            gram[a, a] -= gram[a, b] * gram[a, b]
        # a row that no free component can balance is left as it is
        gram[a, a] = np.sqrt(gram[a, a]) if gram[a, a] > 1e-13 * max(whole, 1e-13) else 1e30
    miss = 0.0
    for turn in range(3):
        for k in range(6):
            error[k] = wrench[k]
            for i in range(n):
                start = 3 * form.contact[i]
                for c in range(3):
                    error[k] += grasp_map[k, start + c] * forces[start + c]
            error[k] *= 1.0 if k < 3 else 1.0 / arm
        for a in range(6):
            for b in range(a):
                error[a] -= triangle[a, b] * error[b]
            error[a] /= triangle[a, a]
        if turn == 2:
            for a in range(6):
                miss += error[a] * error[a]
            break
        for a in range(6):
            for b in range(a):
                error[a] -= gram[a, b] * error[b]
            error[a] /= gram[a, a]
        for a in range(5, -1, -1):
            for b in range(a + 1, 6):
                error[a] -= gram[b, a] * error[b]
            error[a] /= gram[a, a]
        for i in range(n):
            start = 3 * form.contact[i]
            for a in range(6):
                if form.slides[i]:
                    forces[start] -= form.rows[i, a, 0] * error[a]
                    forces[start + 1] -= form.rows[i, a, 1] * error[a]
                if form.presses[i]:
                    forces[start + 2] -= form.rows[i, a, 2] * error[a]
    return np.sqrt(miss)
