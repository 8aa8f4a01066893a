"""The exact answer to a network's shares, as a function that torch differentiates.

Where the effort ends the level t of the preload, the forces are those of least norm with the
preload t s, and t moves so that their effort stays what it may be: with A the derivative of the
normal forces in the preloads (the implicit function theorem, `solvers.differentiable.implicit`),
the gradient v in the normal forces becomes t (u - (u's / r's) r) in the shares and u's / r's in the
effort allowed, u = A'v and r = A'1. Where torque limits end the level, it moves along the cut that
their multipliers prove (`solvers.max_quality.preload.ceiling_duals`), and contacts at their
preload move with it.
"""

from typing import Any

import numpy as np
import torch
from torch import Tensor

from solvers.differentiable import Optimum, forces_gradients
from solvers.exact.dual_newton import solve_flat
from solvers.max_quality.flow import QualityPoint, quality_point
from solvers.max_quality.preload import LeastForces, ceiling_duals
from solvers.problem import GraspForceProblem, Multipliers

_AT_PRELOAD = 1e-3


def answered(
    problem: GraspForceProblem,
    least: LeastForces,
    shares: Tensor,
    limit: Tensor,
    before: QualityPoint | None = None,
) -> tuple[QualityPoint, Tensor]:
    """The point of shares (B, n) and limits (B,), and its normal forces (B, n) with gradients.

    Args:
        problem: flat float64 numpy problems, `max_quality`.
        least: where every preload begins.
        shares: of the preload.
        limit: N, effort that is allowed.
        before: the point of the step before.
    """
    point = quality_point(
        problem,
        least,
        shares.detach().double().numpy(),
        limit.detach().double().numpy(),
        before,
    )
    normal = _Normals.apply(shares.double(), limit.double(), problem, point)
    return point, normal


class _Normals(torch.autograd.Function):
    """The normal forces of a point that is known already."""

    @staticmethod
    def forward(
        ctx: Any, shares: Tensor, limit: Tensor, problem: GraspForceProblem, point: QualityPoint
    ) -> Tensor:
        ctx.problem, ctx.point = problem, point
        return torch.from_numpy(point.normal)

    @staticmethod
    def backward(ctx: Any, wanted: Tensor) -> tuple[Any, ...]:
        problem, point = ctx.problem, ctx.point
        shares = torch.from_numpy(point.asked)
        level = torch.from_numpy(point.forces.level)[:, None]
        answer = _at_level(problem, point)
        by_effort = ~point.forces.by_torque & answer.solved & (point.forces.level > 0.0)
        gradient, of_limit = torch.zeros_like(shares), torch.zeros(len(shares), dtype=torch.double)
        rows = np.flatnonzero(by_effort)
        if len(rows):
            ones = torch.ones_like(wanted[rows])
            pull, rise = _through(problem[rows], point, answer, rows, wanted[rows], ones)
            spent = (rise * shares[rows]).sum(dim=1)
            fair = (pull * shares[rows]).sum(dim=1) / torch.where(spent > 1e-6, spent, torch.inf)
            gradient[rows] = level[rows] * (pull - fair[:, None] * rise)
            of_limit[rows] = fair
        rows = np.flatnonzero(point.forces.by_torque & (point.forces.level > 0.0))
        if len(rows):
            normal = torch.from_numpy(point.normal[rows])
            asked = level[rows] * shares[rows]
            pull = torch.where(normal <= asked * (1.0 + _AT_PRELOAD), wanted[rows], 0.0)
            price = torch.from_numpy(ceiling_duals(problem[rows], point.forces.proof[rows]))
            total = (price * shares[rows]).sum(dim=1, keepdim=True)
            price = torch.where(total > 0.0, price / torch.where(total > 0.0, total, 1.0), 1.0)
            along = (pull * shares[rows]).sum(dim=1, keepdim=True)
            gradient[rows] = level[rows] * (pull - along * price)
        return gradient, of_limit, None, None


def _at_level(problem: GraspForceProblem, point: QualityPoint) -> Any:
    return solve_flat(_asked(problem, point))


def _asked(problem: GraspForceProblem, point: QualityPoint) -> GraspForceProblem:
    asked = np.minimum(point.forces.level[:, None] * point.asked, problem.normal_max)
    return problem.constraints().derived(normal_min=np.maximum(problem.normal_min, asked))


def _through(
    problem: GraspForceProblem,
    point: QualityPoint,
    answer: Any,
    rows: np.ndarray,
    wanted: Tensor,
    ones: Tensor,
) -> tuple[Tensor, Tensor]:
    """A' times `wanted` and times `ones`, (k, n) each, for the chosen rows."""
    asked = point.forces.level[rows, None] * point.asked[rows]
    moves = (asked > problem.normal_min) & (asked < problem.normal_max)
    convex = problem.constraints().derived(
        normal_min=np.maximum(problem.normal_min, np.minimum(asked, problem.normal_max))
    )
    twice = np.concatenate([np.arange(len(rows))] * 2)
    duals = Multipliers(answer.equilibrium_dual, answer.torque_dual)
    forces = torch.from_numpy(answer.forces[rows][twice])
    solved = torch.ones(len(twice), dtype=torch.bool)
    optimum = Optimum(
        forces=forces,
        value=0.5 * (forces**2).sum(dim=1),
        multipliers=duals[rows][twice].map(torch.from_numpy),
        solved=solved,
        status=np.full(len(twice), "optimal"),
    )
    vector = torch.zeros_like(forces)
    vector[:, 2::3] = torch.cat([wanted, ones])
    preload = forces_gradients(convex[twice].to_torch(), optimum, vector)["normal_min"]
    pull, rise = (preload * torch.from_numpy(moves[twice])).chunk(2)
    return pull, rise
