"""The last step of every solver: forces that miss a constraint by rounding are moved inside.

Solvers in floating point leave violations of the size of their tolerances, and the judge allows
none. The forces are fitted to slightly tightened constraints, or else moved towards forces in their
interior, no farther than necessary. Answers that are farther off are left as they are: nothing
here turns a bad answer into a good one.
"""

import dataclasses
from itertools import product

import numpy as np
from numpy.typing import NDArray

from solvers.arrays import Array
from solvers.duality import project_cones
from solvers.judge import EQUILIBRIUM_TOLERANCE, Status, Verdict
from solvers.problem import (
    CanonicalProblem,
    GraspForceProblem,
    apply,
    apply_transposed,
    canonical,
    per_contact,
)

from .repair import balanced_forces, is_balanced, is_feasible, shrunk_forces, tightened, violation
from .solution import Candidate

_NEAR = 1e-6
"""Violation, relative to the size of the forces, that counts as a solver's tolerance."""

_INWARDS = (1e-10, 1e-9, 1e-8)
"""By how much constraints are tightened, in turn, for forces to be projected on."""

_IDLE = 1e-8
"""Force, relative to the largest, of a contact that does not push."""

_ROUNDS = 12
"""Projections in turn on the constraints of each contact and on those of all, where one of each
does not do."""

_DEPTHS = (0.1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
"""Distances from all limits, in units of the force scale, at which interior forces are sought."""

_RIDGE = 1e-10
"""Of the balancing equations, relative: some contacts may carry nothing."""

_PASSES = 4

_BALANCED = 0.5 * EQUILIBRIUM_TOLERANCE
"""Error of equilibrium that counts as none: half of what the judge allows, who rounds otherwise."""


def nearly_feasible(verdict: Verdict) -> NDArray[np.bool_]:
    """(...,) answers that failed, in equilibrium but for a solver's tolerance."""
    failed: NDArray[np.bool_] = np.asarray(verdict.status == Status.FAILED.value)
    if not failed.any():
        return failed
    worst = np.maximum(verdict.equilibrium_residual, verdict.friction_violation)
    return failed & (np.maximum(worst, verdict.normal_violation) <= _NEAR * verdict.size)


def finished(problem: GraspForceProblem, candidate: Candidate, rows: NDArray[np.intp]) -> Candidate:
    """The candidate with the forces of `rows` moved inside their constraints where they are near.

    Args:
        problem: float64 numpy, one batch dimension.
        candidate: its answers.
        rows: those that `nearly_feasible` names.
    """
    form = canonical(problem[rows])
    given = candidate.forces[rows] / form.scale[:, None]
    given = np.where(np.repeat(form.problem.contact_mask, 3, axis=-1), given, 0.0)
    size = np.maximum(1.0, np.linalg.norm(given, axis=-1))
    balanced = balanced_forces(form.problem, given)
    off = np.linalg.norm(balanced - given, axis=-1)
    near = np.maximum(off, violation(form.problem, balanced)) <= _NEAR * size
    inside = np.zeros_like(near)
    result = balanced
    for rounds, resting, delta in product((1, _ROUNDS), (False, True), _INWARDS):
        wanted = np.flatnonzero(near & ~inside)
        if not len(wanted):
            break
        here = form[wanted]
        room = _without_idle(here, given[wanted]) if resting else here
        inner = tightened(room, delta).problem
        moved = given[wanted]
        for _ in range(rounds):
            moved = _fitted(inner, moved)
            fits = _holds(here.problem, moved)
            result[wanted[fits]] = moved[fits]
            inside[wanted[fits]] = True
            if fits.all():
                break
    outside = np.flatnonzero(near & ~inside)
    if len(outside):
        moved, found = _towards_interior(form[outside], balanced[outside])
        result[outside[found]] = moved[found]
        inside[outside[found]] = True
    forces = candidate.forces.copy()
    forces[rows[inside]] = form.scale[inside, None] * result[inside]
    return dataclasses.replace(candidate, forces=forces)


def _without_idle(form: CanonicalProblem, forces: Array) -> CanonicalProblem:
    """The problems whose contacts that do not push may not: perhaps nothing lets them."""
    problem = form.problem
    size = np.linalg.norm(per_contact(forces), axis=-1)
    idle = (size <= _IDLE * size.max(axis=-1, keepdims=True)) & (problem.normal_min == 0.0)
    cap = np.where(idle, 0.0, problem.normal_max)
    return dataclasses.replace(form, problem=problem.derived(normal_max=cap))


def _towards_interior(form: CanonicalProblem, forces: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Forces moved towards interior ones, as little as any of `_DEPTHS` allows; whether there are.

    Deep interiors are far off, but only a small share of the way there is needed; near the edge of
    feasibility none but shallow ones exist.
    """
    problem = form.problem
    nearest = forces.copy()
    least = np.full(len(forces), np.inf)
    for depth in _DEPTHS:
        interior = _interior(problem, depth)
        moved = shrunk_forces(problem, forces, interior)
        way = np.linalg.norm(moved - forces, axis=-1)
        better = (way < least) & _holds(problem, interior)
        nearest[better], least[better] = moved[better], way[better]
    return nearest, np.isfinite(least)


def _interior(problem: GraspForceProblem, depth: float) -> Array:
    """Best forces of those that stay `depth` away from every limit; NaN where there are none.

    Cones whose tips are moved along the normals by the depth are the same cones for what remains of
    the forces, which then carries what that part of the normal forces does not. Contacts that are
    given a normal force, and limits that coincide, stay as they are.
    """
    from solvers.compiled.newton.batch import solve_batch

    room = 0.5 * (problem.normal_max - problem.normal_min)
    shift = np.minimum(depth, room) * problem.contact_mask
    tips = np.zeros((*shift.shape, 3))
    tips[..., 2] = shift
    tips = tips.reshape(len(tips), -1)
    half = 0.5 * (problem.torque_max - problem.torque_min)
    margin = np.minimum(depth * np.linalg.norm(problem.hand_jacobian, axis=-2), half)
    inner = problem.derived(
        external_wrench=problem.external_wrench + apply(problem.grasp_map, tips),
        external_torque=problem.external_torque + apply_transposed(problem.hand_jacobian, tips),
        normal_max=problem.normal_max - 2.0 * shift,
        torque_min=problem.torque_min + margin,
        torque_max=problem.torque_max - margin,
    )
    return np.asarray(solve_batch(inner.flat()).forces + tips)


def _fitted(problem: GraspForceProblem, forces: Array) -> Array:
    """Forces projected on the constraints of each contact, then balanced without leaving them.

    Equilibrium, and the torque limits that are exceeded, are met by the smallest change in which
    each contact counts by the square of its own force: contacts that do not push stay at zero, and
    components without any room where they are.
    """
    batch, n = problem.friction.shape
    fitted = project_cones(problem, per_contact(forces))
    weight = np.sum(fitted**2, axis=-1, keepdims=True) * np.ones(3)
    weight[..., :2] *= (problem.friction > 0)[..., None]
    weight[..., 2] *= problem.normal_min < problem.normal_max
    weight = weight.reshape(batch, 3 * n)
    flat = fitted.reshape(batch, 3 * n)
    for _ in range(_PASSES):
        torque = apply_transposed(problem.hand_jacobian, flat)
        target = np.clip(torque, problem.torque_min, problem.torque_max)
        beyond = target != torque
        torque_rows = np.swapaxes(problem.hand_jacobian, -1, -2) * beyond[..., None]
        rows = np.concatenate([problem.grasp_map, torque_rows], axis=-2)
        error = apply(problem.grasp_map, flat) + problem.external_wrench
        missing = np.concatenate([-error, target - torque], axis=-1)
        weighted = rows * weight[:, None, :]
        gram = weighted @ np.swapaxes(rows, -1, -2)
        ridge = _RIDGE * (np.trace(gram, axis1=-2, axis2=-1)[:, None] + np.finfo(float).tiny)
        ridge = ridge + np.concatenate([np.zeros((batch, 6)), ~beyond], axis=-1)
        gram = gram + ridge[:, None, :] * np.eye(gram.shape[-1])
        change = np.linalg.solve(gram, missing[..., None])[..., 0]
        flat = flat + apply_transposed(weighted, change)
    return flat


def _holds(problem: GraspForceProblem, forces: Array) -> NDArray[np.bool_]:
    """(B,) forces that keep every constraint, as the judge will find too."""
    return is_feasible(problem, forces) & is_balanced(problem, forces, _BALANCED)
