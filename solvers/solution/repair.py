"""From multipliers to forces that satisfy every constraint: correction, then a shrink along a ray.

All functions take canonical problems (`solvers.problem.canonical_form`) as float64 numpy with one
batch dimension, and forces in their units; where nothing else is said, forces are (B, 3n).
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from solvers.arrays import Array
from solvers.duality import contact_duals, in_metric, project_cones, projection_jacobian
from solvers.judge import EQUILIBRIUM_TOLERANCE
from solvers.problem import (
    CanonicalProblem,
    GraspForceProblem,
    Multipliers,
    apply,
    apply_transposed,
    moved_inwards,
    per_contact,
)

_FLOOR = 1e-4
"""Metric of contacts whose projection does not move at all; they take little part."""

_SLACK = 1e-4
"""How soft torque rows are in the correction, against equilibrium, which is exact."""

_BISECTIONS = 50

_EQUATION = 0.5 * EQUILIBRIUM_TOLERANCE
"""Error of a torque that is given, relative to the size of the forces, that counts as none."""


def corrected_forces(problem: GraspForceProblem, multipliers: Multipliers) -> Array:
    """Forces in exact equilibrium near f^ = Pi_C(-q), which friction, preload and caps fit already.

    f^ is corrected in the metric of the projection's Jacobian D, in which contacts that do not push
    stay still: f = f^ + M A' (A M A' + R)^-1 (target - A f^) with M = D + 1e-4 I, A the equilibrium
    rows and those torque rows that have a price or exceed a limit, the target torques clipped to
    their limits; an orthogonal projection onto equilibrium follows.
    """
    batch, n = problem.friction.shape
    prices = contact_duals(problem, multipliers)
    start = project_cones(problem, -prices)
    metric = projection_jacobian(problem, -prices) + _FLOOR * np.eye(3)
    metric = metric * problem.contact_mask[..., None, None]
    flat = start.reshape(batch, 3 * n)
    torque = apply_transposed(problem.hand_jacobian, flat)
    target = np.clip(torque, problem.torque_min, problem.torque_max)
    in_play = (multipliers.torque != 0) | (target != torque)
    torque_rows = np.swapaxes(problem.hand_jacobian, -1, -2) * in_play[..., None]
    rows = np.concatenate([problem.grasp_map, torque_rows], axis=-2)
    wanted = np.concatenate(
        [-problem.external_wrench - apply(problem.grasp_map, flat), (target - torque) * in_play],
        axis=-1,
    )
    weighted = in_metric(rows, metric)
    gram = weighted @ np.swapaxes(rows, -1, -2)
    soft = np.concatenate([np.zeros((batch, 6)), np.where(in_play, _SLACK, 1.0)], axis=-1)
    gram = gram + soft[..., None, :] * np.eye(gram.shape[-1])
    change = np.linalg.solve(gram, wanted[..., None])[..., 0]
    return balanced_forces(problem, flat + apply_transposed(weighted, change))


def balanced_forces(problem: GraspForceProblem, forces: Array) -> Array:
    """The nearest forces in exact equilibrium."""
    error = apply(problem.grasp_map, forces) + problem.external_wrench
    return forces - apply_transposed(problem.grasp_map, error)


def is_balanced(problem: GraspForceProblem, forces: Array, tolerance: float) -> NDArray[np.bool_]:
    """(B,) whether the error of equilibrium is within the tolerance, relative to the forces' size.

    That size is at least one, the force scale.
    """
    error = apply(problem.grasp_map, forces) + problem.external_wrench
    size = np.maximum(1.0, np.linalg.norm(forces, axis=-1))
    return np.linalg.norm(error, axis=-1) <= tolerance * size


def violation(problem: GraspForceProblem, forces: Array) -> Array:
    """(B,) largest excess over friction, preload, cap and torque limits; negative inside.

    Equilibrium is left out. Torques count over the norm of their column of J_h. Limits that
    coincide to within half of what the judge allows to an equation may be missed by as much.
    """
    force = per_contact(forces)
    size = np.hypot(force[..., 0], force[..., 1])
    normal = force[..., 2]
    excess = np.maximum(size - problem.friction * normal, problem.normal_min - normal)
    excess = np.maximum(excess, normal - problem.normal_max)
    worst = np.max(np.where(problem.contact_mask, excess, -np.inf), axis=-1)
    torque = apply_transposed(problem.hand_jacobian, forces)
    over = np.maximum(torque - problem.torque_max, problem.torque_min - torque)
    equation = _EQUATION * np.maximum(1.0, np.linalg.norm(forces, axis=-1, keepdims=True))
    pinned = problem.torque_max - problem.torque_min <= equation
    over = np.where(pinned, over - equation, over)
    return np.maximum(worst, np.max(over, axis=-1, initial=-np.inf))


def is_feasible(problem: GraspForceProblem, forces: Array) -> NDArray[np.bool_]:
    """(B,) whether balanced forces satisfy all other constraints, with no tolerance."""
    return violation(problem, forces) <= 0.0


def shrunk_forces(problem: GraspForceProblem, forces: Array, interior: Array) -> Array:
    """The feasible point nearest to `forces` on the way there from feasible `interior` forces.

    Both are in equilibrium; the constraints are convex, so that a bisection finds it.
    """
    low, high = np.zeros(len(forces)), np.ones(len(forces))
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        point = interior + middle[:, None] * (forces - interior)
        fits = is_feasible(problem, point)
        low, high = np.where(fits, middle, low), np.where(fits, high, middle)
    whole = is_feasible(problem, forces)
    share = np.where(whole, 1.0, low)[:, None]
    return interior + share * (forces - interior)


def tightened(form: CanonicalProblem, delta: float) -> CanonicalProblem:
    """The same problems with constraints moved inwards, so that their answers lie in the interior.

    Friction and caps by the share delta, preloads by 0.3 delta / sqrt(n), torque limits by delta
    times half their distance.
    """
    problem = form.problem
    count = problem.contact_mask.sum(axis=-1, keepdims=True)
    half = 0.5 * (problem.torque_max - problem.torque_min)
    shift = delta * np.where(np.isfinite(half), half, 1.0)
    inner = moved_inwards(problem, delta, 0.3 * delta / np.sqrt(count), (shift, shift))
    return dataclasses.replace(form, problem=inner)
