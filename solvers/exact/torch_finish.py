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

_SMALLEST = 1e-16
"""N^2 over the squared force scale: an objective below it counts as this large in a gap."""

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
        gap: (B,) (objective - dual_bound) / objective; infinite where the forces are not feasible.
        distance: (B,) the same gap in the tightened problem, which convergence brings to rounding.
    """

    forces: Tensor
    multipliers: Multipliers
    objective: Tensor
    dual_bound: Tensor
    gap: Tensor
    distance: Tensor


def finished_forces(
    problem: GraspForceProblem, form: CanonicalProblem, here: Point, ahead: Direction
) -> FinishedForces:
    """The forces at the end of a Newton step in the tightened problem, against the original one.

    f = f^ - D A' step satisfies equilibrium and the torque limits in play to first order, and D
    keeps the forces on their cones; an exact projection onto equilibrium follows. Feasible means
    that no inequality is violated at all.

    Args:
        problem: the original problems.
        form: their canonical form, not tightened.
        here: the point in the tightened canonical problem.
        ahead: the direction there.
    """
    movable = _movable(problem)
    change = in_metric((ahead.step[:, None] @ ahead.rows), ahead.curvature)[:, 0]
    flat = here.forces.flatten(-2) - change * movable
    forces = _balanced(problem, form, form.scale[:, None] * flat, movable)
    multipliers = form.multipliers(here.multipliers)
    objective = objective_value(problem, forces)
    bound = dual_bound(problem, multipliers)
    least = _SMALLEST * form.scale**2
    feasible = is_feasible(problem, form, forces)

    def gap(lower: Tensor) -> Tensor:
        relative = (objective - lower) / torch.maximum(objective, least)
        return torch.where(feasible, relative, torch.inf)

    distance = gap(form.scale**2 * here.value).abs()
    return FinishedForces(forces, multipliers, objective, bound, gap(bound), distance)


def is_feasible(problem: GraspForceProblem, form: CanonicalProblem, forces: Tensor) -> Tensor:
    """(B,) whether forces satisfy every inequality exactly, and equilibrium to rounding."""
    size = torch.maximum(form.scale, torch.linalg.vector_norm(forces, dim=-1))
    error = form.scale * torch.linalg.vector_norm(_imbalance(problem, form, forces), dim=-1)
    holds = (friction_violation(problem, forces) <= 0) & (normal_violation(problem, forces) <= 0)
    holds = holds & (torque_violation(problem, forces) <= 0)
    return holds & (error <= EQUILIBRIUM_TOLERANCE * size)


def _movable(problem: GraspForceProblem) -> Tensor:
    """(B, 3n) 1 where a component may change, 0 where it is pinned: padding, no friction, no room.

    A correction that moved one of these would leave the constraints by its rounding alone.
    """
    sliding = problem.contact_mask & (problem.friction > 0)
    pressing = problem.contact_mask & (problem.normal_max > problem.normal_min)
    parts = torch.stack([sliding, sliding, pressing], dim=-1)
    return parts.flatten(-2).to(problem.friction.dtype)


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
