"""From a Newton step to forces that satisfy every constraint exactly, checked, in torch."""

from dataclasses import dataclass

import torch
from torch import Tensor

from solvers.duality import dual_bound, in_metric
from solvers.judge import EQUILIBRIUM_TOLERANCE
from solvers.problem import (
    CanonicalProblem,
    GraspForceProblem,
    Multipliers,
    balanced_wrench,
    friction_violation,
    normal_violation,
    objective_value,
    per_contact,
    torque_violation,
)

from .torch_newton import Direction, Point
from .torch_verdict import verdict

_SMALLEST = 1e-16
"""N^2 over the squared force scale: an objective below it counts as this large in a gap."""

_ROOM = 1e-12
"""Room between preload and cap, relative to them, that no force is moved in."""

_BALANCE_RIDGE = 1e-8
_BALANCINGS = 2
"""Last corrections of equilibrium: how soft in directions in which no contact pushes, how many."""


@dataclass(frozen=True, eq=False)
class FinishedForces:
    """Forces and multipliers of B problems in their own units, and what a check of them says.

    Args:
        forces: (B, 3n) N.
        multipliers: nu and lambda.
        objective: (B,) half the squared norm of the forces.
        dual_bound: (B,) of the original problem.
        gap: (B,) (objective - dual_bound) / objective; infinite where the judge finds the forces
            not feasible.
        exact: (B,) bool, no inequality is violated at all, but for limits that coincide.
        distance: (B,) the gap of exact forces in the tightened problem, which convergence brings to
            rounding; infinite for others.
    """

    forces: Tensor
    multipliers: Multipliers
    objective: Tensor
    dual_bound: Tensor
    gap: Tensor
    exact: Tensor
    distance: Tensor


def finished_forces(
    problem: GraspForceProblem, form: CanonicalProblem, here: Point, ahead: Direction
) -> FinishedForces:
    """The forces at the end of a Newton step in the tightened problem, against the original one.

    f = f^ - D A' step satisfies equilibrium and the torque limits in play to first order, and D
    keeps the forces on their cones; an exact projection onto equilibrium follows. Normal
    forces that are given are those to the bit.

    Args:
        problem: the original problems.
        form: their canonical form, not tightened.
        here: the point in the tightened canonical problem.
        ahead: the direction there.
    """
    movable = _movable(problem)
    change = in_metric((ahead.step[:, None] @ ahead.rows), ahead.curvature)[:, 0]
    flat = here.forces.flatten(-2) - change * movable
    scaled = _with_given(problem, form.scale[:, None] * flat)
    forces = _balanced(problem, form, scaled, movable)
    multipliers = form.multipliers(here.multipliers)
    objective = objective_value(problem, forces)
    bound = dual_bound(problem, multipliers)
    found = verdict(problem, forces, bound)
    exact = found.feasible & _is_exact(problem, form, forces, found.allowed_torque)
    least = _SMALLEST * form.scale**2
    distance = (objective - form.scale**2 * here.value) / torch.maximum(objective, least)
    distance = torch.where(exact, distance.abs(), torch.inf)
    return FinishedForces(forces, multipliers, objective, bound, found.gap, exact, distance)


def _is_exact(
    problem: GraspForceProblem, form: CanonicalProblem, forces: Tensor, equation: Tensor
) -> Tensor:
    """(B,) whether forces satisfy every inequality exactly, and equations to rounding."""
    size = torch.maximum(form.scale, torch.linalg.vector_norm(forces, dim=-1))
    error = form.scale * torch.linalg.vector_norm(_imbalance(problem, form, forces), dim=-1)
    holds = (friction_violation(problem, forces) <= 0) & (normal_violation(problem, forces) <= 0)
    # limits that coincide are an equation, which the judge has accepted
    given = problem.torque_max - problem.torque_min <= equation[:, None]
    free = problem.derived(
        torque_min=problem.torque_min.masked_fill(given, -torch.inf),
        torque_max=problem.torque_max.masked_fill(given, torch.inf),
    )
    holds = holds & (torque_violation(free, forces) <= 0)
    return holds & (error <= EQUILIBRIUM_TOLERANCE * size)


def _movable(problem: GraspForceProblem) -> Tensor:
    """(B, 3n) 1 where a component may change, 0 where it is pinned: padding, no friction, no room.

    A correction that moved one of these would leave the constraints by its rounding alone.
    """
    sliding = problem.contact_mask & (problem.friction > 0)
    pressing = problem.contact_mask & ~_given(problem)
    parts = torch.stack([sliding, sliding, pressing], dim=-1)
    return parts.flatten(-2).to(problem.friction.dtype)


def _given(problem: GraspForceProblem) -> Tensor:
    """(B, n) bool, where preload and cap leave a normal force no room but for rounding."""
    room = problem.normal_max - problem.normal_min
    return room <= _ROOM * problem.normal_min


def _with_given(problem: GraspForceProblem, forces: Tensor) -> Tensor:
    """Forces (B, 3n) N whose normal components are those that preload and cap give."""
    contacts = per_contact(forces)
    normal = contacts[..., 2]
    within = normal.clamp(problem.normal_min, problem.normal_max)
    normal = torch.where(_given(problem) & problem.contact_mask, within, normal)
    return torch.cat([contacts[..., :2], normal[..., None]], dim=-1).flatten(-2)


def _imbalance(problem: GraspForceProblem, form: CanonicalProblem, forces: Tensor) -> Tensor:
    """(B, 6) equilibrium error of forces in N, as canonical forces that would cause it."""
    error = (problem.grasp_map @ forces[..., None])[..., 0] + problem.external_wrench
    balanced = balanced_wrench(problem, error) / form.scale[:, None]
    # R' x = error, R upper triangular
    return torch.linalg.solve_triangular(form.factor.mT, balanced[..., None], upper=False)[..., 0]


def _balanced(
    problem: GraspForceProblem, form: CanonicalProblem, forces: Tensor, movable: Tensor
) -> Tensor:
    """Forces in exact equilibrium, each contact moved in proportion to its own size.

    So a contact that does not push stays where it is, and one that hardly pushes keeps its margin
    to the cone, which is relative too.
    """
    size = torch.linalg.vector_norm(per_contact(forces), dim=-1)
    largest = size.amax(dim=-1, keepdim=True)
    share = size / torch.where(largest > 0, largest, 1.0)
    weight = share.repeat_interleave(3, dim=-1) * movable
    basis = form.problem.grasp_map
    weighted = basis * weight[:, None]
    gram = weighted @ basis.mT
    identity = torch.eye(gram.shape[-1], dtype=gram.dtype, device=gram.device)
    factor = torch.linalg.cholesky_ex(gram + _BALANCE_RIDGE * identity).L
    for _ in range(_BALANCINGS):
        error = _imbalance(problem, form, forces)
        lift = torch.cholesky_solve(error[..., None], factor)
        forces = forces - form.scale[:, None] * (weighted.mT @ lift)[..., 0]
    return forces
