"""The KKT flow of the multipliers of a grasp force problem, and its accelerated steps, in torch.

Eliminating the forces from the KKT ODE (`solvers.kkt`; Basumatary et al., section 3) at their own
equilibrium, f^ = Pi_C(-q) with q = G' nu + J_h lambda, leaves the flow of the multipliers

    nu' = G f^ + w,     lambda' = (lambda + tau - tau^U)_+ + (lambda + tau - tau^L)_- - lambda,

which climbs the concave dual: the gradient in nu, the proximal step in lambda.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from solvers.duality import (
    contact_duals,
    dual_bound,
    in_metric,
    project_cones,
    projection_jacobian,
)
from solvers.problem import GraspForceProblem, Multipliers, apply, apply_transposed

_FAR = 1e6
"""Stands for infinity: a torque limit, in units of the problem's own scale."""

_LEAST = 1e-4
"""Added to the Hessian's diagonal: several joints may move the same contacts the same way."""


@dataclass(frozen=True, eq=False)
class Evaluation:
    """The flow's right side at multipliers (y, lambda) of a canonical problem.

    Args:
        prices: (B, n, 3) q.
        forces: (B, n, 3) f^ = Pi_C(-q).
        equilibrium: (B, 6) Q' f^ + w, the dual's gradient in y.
        torque: (B, n_tau) tau of f^, the gradient in lambda before the limits.
        excess: (B, n_tau) tau beyond its limits.
    """

    prices: Tensor
    forces: Tensor
    equilibrium: Tensor
    torque: Tensor
    excess: Tensor


def evaluate(problem: GraspForceProblem, multipliers: Multipliers) -> Evaluation:
    """The flow's right side for canonical problems; see `Evaluation`."""
    batch, n = problem.friction.shape
    basis, jacobian = problem.grasp_map, problem.hand_jacobian
    prices = basis.mT @ multipliers.equilibrium[..., None]
    prices = (prices + jacobian @ multipliers.torque[..., None]).reshape(batch, n, 3)
    forces = project_cones(problem, -prices)
    flat = forces.reshape(batch, 3 * n, 1)
    torque = (jacobian.mT @ flat)[..., 0]
    return Evaluation(
        prices=prices,
        forces=forces,
        equilibrium=(basis @ flat)[..., 0] + problem.external_wrench,
        torque=torque,
        excess=torque - torque.clamp(problem.torque_min, problem.torque_max),
    )


def kkt_flow(problem: GraspForceProblem, multipliers: Multipliers) -> Multipliers:
    """Phi(y; p), the right side of y' = Phi(y; p): zero at the optimum, and nowhere else.

    Args:
        problem: B canonical problems.
        multipliers: (..., B, 6) and (..., B, n_tau), any number of points for each problem.
    """
    forces = project_cones(problem, -contact_duals(problem, multipliers)).flatten(-2)
    torque = apply_transposed(problem.hand_jacobian, forces)
    return Multipliers(
        apply(problem.grasp_map, forces) + problem.external_wrench,
        proximal(multipliers.torque, torque, problem, 1.0) - multipliers.torque,
    )


def newton_direction(
    problem: GraspForceProblem, here: Multipliers, now: Evaluation, softness: Tensor
) -> Multipliers:
    """Semismooth Newton direction of the dual, softened by `softness` (B, n) > 0 at each contact.

    It solves A (D + E) A' step = gradient, with the Jacobian D of the projection, the softness on
    the diagonal of E, and in A the equilibrium rows and those torque rows that have a price or
    exceed a limit. Where rounding spoils the factorisation the direction means nothing.
    """
    in_play = ((here.torque != 0) | (now.excess != 0)).to(softness.dtype)
    torque_rows = problem.hand_jacobian.mT * in_play[..., None]
    rows = torch.cat([problem.grasp_map, torque_rows], dim=-2)
    limit = torch.where(
        here.torque > 0,
        problem.torque_max,
        torch.where(here.torque < 0, problem.torque_min, now.torque - now.excess),
    )
    miss = torch.where(in_play > 0, now.torque - limit.clamp(-_FAR, _FAR), 0.0)
    gradient = torch.cat([now.equilibrium, miss], dim=-1)
    curvature = projection_jacobian(problem, -now.prices)
    curvature = curvature + softness[..., None, None] * torch.eye(3, device=softness.device)
    hessian = in_metric(rows, curvature) @ rows.mT
    idle = torch.cat([torch.full_like(now.equilibrium, _LEAST), 1.0 - in_play + _LEAST], dim=-1)
    # float32 cannot factor what nearly dependent torque rows leave of the Hessian
    factor = torch.linalg.cholesky_ex((hessian + torch.diag_embed(idle)).double()).L
    step = torch.cholesky_solve(gradient[..., None].double(), factor)[..., 0].to(miss.dtype)
    return Multipliers(step[..., :6], step[..., 6:])


def momentum(step: int) -> float:
    """FISTA's extrapolation factor after step 0, 1, ... (Beck and Teboulle, 2009)."""
    t = 1.0
    for _ in range(step):
        t = (1.0 + math.sqrt(1.0 + 4.0 * t * t)) / 2.0
    return (t - 1.0) / ((1.0 + math.sqrt(1.0 + 4.0 * t * t)) / 2.0)


def flow_step(
    problem: GraspForceProblem, step: Tensor, here: Multipliers, now: Evaluation
) -> Multipliers:
    """The Euler step of length `step` (B, 1); up to 1 / L it never lowers the dual value."""
    return Multipliers(
        here.equilibrium + step * now.equilibrium,
        proximal(here.torque, now.torque, problem, step),
    )


def along(start: Multipliers, end: Multipliers, factor: Tensor | float) -> Multipliers:
    """The point start + factor (end - start)."""
    return Multipliers(
        start.equilibrium + factor * (end.equilibrium - start.equilibrium),
        start.torque + factor * (end.torque - start.torque),
    )


def stacked(points: list[Multipliers]) -> Multipliers:
    """Several points as one, in a new leading dimension."""
    return Multipliers(
        torch.stack([point.equilibrium for point in points]),
        torch.stack([point.torque for point in points]),
    )


def best_index(problem: GraspForceProblem, points: Multipliers) -> Tensor:
    """(B,) which of the stacked points has the largest dual bound, per problem."""
    with torch.no_grad():
        bound = torch.nan_to_num(dual_bound(problem, points), nan=-math.inf)
        return torch.argmax(bound, dim=0)


def select(points: Multipliers, index: Tensor) -> Multipliers:
    """The point number `index` (B,) of the stacked points, per problem."""
    rows = torch.arange(index.shape[0], device=index.device)
    return points[index, rows]


def best_iterate(problem: GraspForceProblem, points: Multipliers) -> Multipliers:
    """The stacked point with the largest dual bound, per problem."""
    return select(points, best_index(problem, points))


def proximal(
    price: Tensor, torque: Tensor, problem: GraspForceProblem, step: Tensor | float
) -> Tensor:
    """Proximal step of the torque prices: they leave zero only where a limit is exceeded."""
    # an infinite limit is never reached, but infinity times the step has no gradient
    above = (price + step * (torque - problem.torque_max.clamp(max=_FAR))).clamp(min=0.0)
    below = (price + step * (torque - problem.torque_min.clamp(min=-_FAR))).clamp(max=0.0)
    return above + below
