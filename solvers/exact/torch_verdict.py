"""The judge's verdict on `min_norm` answers in torch, where the answers lie.

The rule is that of `solvers.judge.judge`, written once more: a tensor answer says of itself what
the judge would say of it. Tests compare the two.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from solvers.duality import dual_bound, farkas_value, usable
from solvers.judge import (
    EQUILIBRIUM_TOLERANCE,
    FARKAS_TOLERANCE,
    LARGEST_NUMBER,
    LOAD_SHARE,
    NEGLIGIBLE,
)
from solvers.problem import (
    GraspForceProblem,
    Multipliers,
    force_scale,
    least_force,
    objective_value,
    per_contact,
    tangential_size,
)

_ROUNDING = 8 * torch.finfo(torch.float64).eps
"""Relative error allowed to the evaluation of a constraint, times the sizes of its terms."""


@dataclass(frozen=True, eq=False)
class TensorVerdict:
    """What the judge says of B answers.

    Args:
        feasible: (B,) bool, all constraints hold.
        gap: (B,) (objective - dual bound) / objective; infinite where not feasible.
        allowed_torque: (B,) N·m, by how much torque limits that coincide may be missed.
    """

    feasible: Tensor
    gap: Tensor
    allowed_torque: Tensor


def verdict(problem: GraspForceProblem, forces: Tensor, bound: Tensor) -> TensorVerdict:
    """Measure forces as the judge does.

    Args:
        problem: flat float64 tensors.
        forces: (B, 3n) N; those of padding contacts count as zero, NaN is no answer.
        bound: (B,) dual bound.
    """
    padding = ~problem.contact_mask.repeat_interleave(3, dim=-1)
    answered = (forces.abs() <= LARGEST_NUMBER).all(dim=-1)
    given = forces.masked_fill(padding | ~answered[:, None], 0.0)
    scale = force_scale(problem)
    size = torch.maximum(scale, torch.linalg.vector_norm(given, dim=-1))
    allowance = torch.minimum(EQUILIBRIUM_TOLERANCE * size, LOAD_SHARE * scale)
    columns = torch.linalg.vector_norm(problem.hand_jacobian, dim=-2)
    lever = torch.cat([columns, torch.zeros_like(scale)[:, None]], dim=-1).amax(dim=-1)
    feasible = answered & _balanced(problem, given, size, scale, allowance)
    feasible = feasible & (_excess(problem, given, allowance * lever) <= 0.0)
    objective = objective_value(problem, given)
    least = 0.5 * (NEGLIGIBLE * size) ** 2
    gap = (objective - bound) / torch.maximum(objective, least)
    return TensorVerdict(feasible, torch.where(feasible, gap, torch.inf), allowance * lever)


def proofs(problem: GraspForceProblem, multipliers: Multipliers) -> tuple[Multipliers, Tensor]:
    """(B, .) the multipliers that count, and (B,) where these prove that no forces exist."""
    priced = torch.cat([multipliers.equilibrium, multipliers.torque], dim=-1).abs()
    sound = (priced <= LARGEST_NUMBER).all(dim=-1, keepdim=True)
    given = usable(
        problem,
        Multipliers(
            torch.where(sound, multipliers.equilibrium, 0.0),
            torch.where(sound, multipliers.torque, 0.0),
        ),
    )
    return given, farkas_value(problem, given) > FARKAS_TOLERANCE


def proven_bound(problem: GraspForceProblem, multipliers: Multipliers) -> Tensor:
    """(B,) the dual bound of any multipliers."""
    bound: Tensor = dual_bound(problem, proofs(problem, multipliers)[0])
    return bound


def _balanced(
    problem: GraspForceProblem, forces: Tensor, size: Tensor, scale: Tensor, allowance: Tensor
) -> Tensor:
    """(B,) whether what is left of equilibrium, after rounding, is within the allowance."""
    column = forces[..., None]
    error = (problem.grasp_map @ column)[..., 0] + problem.external_wrench
    terms = (problem.grasp_map.abs() @ column.abs())[..., 0] + problem.external_wrench.abs()
    beyond = error.sign() * (error.abs() - _ROUNDING * terms).clamp(min=0.0)

    def as_force(wrench: Tensor) -> Tensor:
        return torch.linalg.vector_norm(least_force(problem, wrench), dim=-1)

    # rounding hides what enormous forces do not carry: it excuses no more than a share of the load
    whole = as_force(error) + _ROUNDING * size <= LOAD_SHARE * scale
    return (as_force(beyond) <= allowance) & whole


def _excess(problem: GraspForceProblem, forces: Tensor, equation: Tensor) -> Tensor:
    """(B,) a number that is positive where an inequality is missed by more than rounding."""
    contacts = per_contact(forces)
    normal, sliding = contacts[..., 2], tangential_size(torch, contacts)
    friction = sliding - problem.friction * normal
    friction = friction - _ROUNDING * (sliding + problem.friction * normal.abs())
    pressing = torch.maximum(problem.normal_min - normal, normal - problem.normal_max)
    pressing = pressing - _ROUNDING * normal.abs()
    worst = torch.where(problem.contact_mask, torch.maximum(friction, pressing), -torch.inf)
    row, own = forces[:, None], problem.external_torque
    torque = (row @ problem.hand_jacobian)[:, 0] + own
    terms = (row.abs() @ problem.hand_jacobian.abs())[:, 0] + own.abs()
    over = torch.maximum(torque - problem.torque_max, problem.torque_min - torque)
    # limits that coincide are an equation, and no sum of products meets one exactly
    same = problem.torque_max - problem.torque_min <= equation[:, None]
    over = over - _ROUNDING * terms - torch.where(same, equation[:, None], 0.0)
    return torch.cat([worst, over], dim=-1).amax(dim=-1)
