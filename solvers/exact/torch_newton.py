"""Semismooth Newton steps on the concave dual, for many `min_norm` problems at once, in torch.

With the forces eliminated at f^ = Pi_C(-q), q = G' nu + J_h lambda, the dual value is concave and
once differentiable in (nu, lambda); a line search on it makes Newton's method global. Every
operation here has a fixed shape and no branch on the data, so that a device never waits for the
host. Problems are canonical (`solvers.problem.canonical_form`), float64, with one batch dimension.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from solvers.duality import in_metric, project_cones, projection_jacobian
from solvers.problem import GraspForceProblem, Multipliers, moved_inwards

MARGIN = 1e-10
"""By how much the constraints are tightened, relative to themselves, so that rounding in the last
corrections never leaves the original ones."""

_GIVEN = 1e-9
"""Torque limits closer together than this are one value, and an equation: relative to one, in units
of the force scale, and to the limits."""

_LARGEST_LIMIT = 1e9
"""No limit is compared with more than this, and infinite ones with no more than finite ones."""

_FAR = 1e30
"""Stands for an infinite torque limit, whose price is always zero."""

_FLOOR = 1e-11
_RIDGE = 1e-4
_LEAST_RIDGE = 1e-9
_EASE = 0.3
"""Added to the Hessian: a floor, and a share of the residual up to one. While whole steps succeed,
as they do on the long way to large multipliers, the share shrinks by a factor down to the least."""

_SHRINK = 0.15
_LENGTHS = 3
_ARMIJO = 1e-4
"""Line search: factor between lengths, lengths tried at once, least share of the promised gain."""

_SHIFT = 1e-14
"""Added to a Gram matrix, relative to its trace, lest rounding makes it indefinite."""

_NOISE = 1e-14
"""Rounding of a dual value, relative to its terms: a smaller loss is none."""


@dataclass(frozen=True, eq=False)
class Point:
    """Multipliers of B problems and what they mean.

    Args:
        multipliers: (B, 6) nu and (B, n_tau) lambda.
        prices: (B, n, 3) q.
        forces: (B, n, 3) f^ = Pi_C(-q).
        value: (B,) dual value.
        length: (B,) the longest step that the next line search tries.
        ridge: (B,) share of the residual on the Hessian's diagonal.
    """

    multipliers: Multipliers
    prices: Tensor
    forces: Tensor
    value: Tensor
    length: Tensor
    ridge: Tensor

    def __getitem__(self, index: Tensor) -> "Point":
        """The points at `index` of the batch."""
        return Point(*(part[index] for part in vars(self).values()))


@dataclass(frozen=True, eq=False)
class Direction:
    """The Newton direction at a point, and the system that it solves.

    Args:
        rows: (B, 6 + n_tau, 3n) equilibrium and torque rows; zero where a torque is not in play.
        curvature: (B, n, 3, 3) Jacobian D of the projection.
        gradient: (B, 6 + n_tau) of the dual value, zero in the rows not in play.
        step: (B, 6 + n_tau) solution of (A D A' + ridge) step = gradient.
        residual: (B,) norm of the gradient.
    """

    rows: Tensor
    curvature: Tensor
    gradient: Tensor
    step: Tensor
    residual: Tensor

    def __getitem__(self, index: Tensor) -> "Direction":
        """The directions at `index` of the batch."""
        return Direction(*(part[index] for part in vars(self).values()))


def cholesky_qr(matrix: Tensor) -> tuple[Tensor, Tensor]:
    """(..., m, 6) orthonormal basis and (..., 6, 6) triangular factor of (..., m, 6) matrices.

    Two Cholesky factorisations of the Gram matrix after a shifted one (Fukaya et al., "Shifted
    Cholesky QR for computing the QR factorization of ill-conditioned matrices", 2020): batched QR
    on a GPU goes through the batch one by one.
    """
    eye = torch.eye(matrix.shape[-1], dtype=matrix.dtype, device=matrix.device)
    basis, factor = matrix, eye
    for shift in (_SHIFT, 0.0, 0.0):
        gram = basis.mT @ basis
        size = gram.diagonal(dim1=-2, dim2=-1).sum(dim=-1)
        lower = torch.linalg.cholesky_ex(gram + shift * size[..., None, None] * eye).L
        basis = torch.linalg.solve_triangular(lower, basis.mT, upper=False).mT
        factor = lower.mT @ factor
    return basis, factor


def tightened(problem: GraspForceProblem, margin: float = MARGIN) -> GraspForceProblem:
    """The problem with all inequalities tightened; what is given by one value stays given.

    Friction, caps and preloads by the margin times themselves; torque limits by the margin times
    their size or one, whichever is larger. Torque limits that all but coincide meet in the middle.
    """

    def inward(limit: Tensor) -> Tensor:
        return margin * torch.where(torch.isfinite(limit), limit.abs().clamp(min=1.0), 0.0)

    shifts = inward(problem.torque_min), inward(problem.torque_max)
    inner = moved_inwards(problem, margin, margin * problem.normal_min, shifts)
    low, high = problem.torque_min, problem.torque_max
    size = torch.minimum(low.abs(), high.abs()).clamp(max=_LARGEST_LIMIT)
    near = high - low <= _GIVEN * (1.0 + size)
    middle = low + 0.5 * (high - low)
    return inner.derived(
        torque_min=torch.where(near, middle, inner.torque_min),
        torque_max=torch.where(near, middle, inner.torque_max),
    )


def given_torques(problem: GraspForceProblem) -> Tensor:
    """(B, n_tau) bool: the torque is an equation, whose price has either sign."""
    given: Tensor = problem.torque_min == problem.torque_max
    return given


def cold_start(problem: GraspForceProblem) -> Multipliers:
    """nu = 2 (G G')^-1 w and lambda = 0; the rows of a canonical grasp map are orthonormal."""
    return Multipliers(2.0 * problem.external_wrench, problem.xp.zeros_like(problem.torque_min))


def evaluate_dual(problem: GraspForceProblem, multipliers: Multipliers) -> Point:
    """The point at (B, .) multipliers."""
    nu, price = multipliers.equilibrium[None], multipliers.torque[None]
    prices, forces, value = _evaluate(problem, nu, price)
    one = torch.ones_like(value[0])
    return Point(multipliers, prices[0], forces[0], value[0], one, _RIDGE * one)


def direction(problem: GraspForceProblem, here: Point) -> Direction:
    """The Newton direction; rows in play have a price, exceed a limit, or are equations.

    Where the factorisation fails, which takes a Hessian of nothing but rounding, it is the
    gradient.
    """
    price = here.multipliers.torque
    flat = here.forces.flatten(-2)
    torque = (flat[:, None] @ problem.hand_jacobian)[:, 0]
    clipped = torque.clamp(problem.torque_min, problem.torque_max)
    in_play = (price != 0) | (clipped != torque) | given_torques(problem)
    limit = torch.where(price < 0, problem.torque_min, clipped)
    limit = torch.where(price > 0, problem.torque_max, limit)
    miss = torch.where(in_play, torque - limit, 0.0)
    balance = (problem.grasp_map @ flat[..., None])[..., 0] + problem.external_wrench
    gradient = torch.cat([balance, miss], dim=-1)
    residual = torch.linalg.vector_norm(gradient, dim=-1)

    rows = torch.cat([problem.grasp_map, problem.hand_jacobian.mT * in_play[..., None]], dim=-2)
    curvature = projection_jacobian(problem, -here.prices)
    hessian = in_metric(rows, curvature) @ rows.mT
    ridge = (_FLOOR + here.ridge * residual.clamp(max=1.0))[:, None].expand_as(gradient)
    idle = torch.cat([torch.zeros_like(balance), (~in_play).to(ridge.dtype)], dim=-1)
    factor, info = torch.linalg.cholesky_ex(hessian + torch.diag_embed(ridge + idle))
    step = torch.cholesky_solve(gradient[..., None], factor)[..., 0]
    sound = (info == 0) & step.isfinite().all(dim=-1)
    step = torch.where(sound[:, None], step, gradient)
    return Direction(rows, curvature, gradient, step, residual)


def ascent_step(problem: GraspForceProblem, here: Point, ahead: Direction) -> Point:
    """The longest of a few steps that gains enough; where none does, shorter ones come next time.

    A torque price that changes its sign stops at zero, where its limit leaves play; that of an
    equation does not.
    """
    powers = torch.arange(_LENGTHS, device=here.value.device, dtype=here.value.dtype)
    lengths = here.length * _SHRINK ** powers[:, None]  # (K, B)
    price = here.multipliers.torque
    moved = price + lengths[..., None] * ahead.step[:, 6:]
    # a price leaves zero only towards the limit that is exceeded
    sign = torch.where(price != 0, price, ahead.gradient[:, 6:])
    moved = torch.where((moved * sign < 0) & ~given_torques(problem), 0.0, moved)
    nu = here.multipliers.equilibrium + lengths[..., None] * ahead.step[:, :6]
    prices, forces, value = _evaluate(problem, nu, moved)

    slope = torch.linalg.vecdot(ahead.gradient, ahead.step)
    # prices far larger than the forces, at the edge of feasibility, cancel in the value
    size = (here.prices * here.forces).abs().sum(dim=(-2, -1))
    noise = _NOISE * (1.0 + here.value.abs() + size)
    enough = value >= here.value + _ARMIJO * lengths * slope - noise
    gains = enough.any(dim=0)
    first = enough.to(torch.int8).argmax(dim=0)
    batch = torch.arange(first.shape[0], device=first.device)

    def chosen(trials: Tensor, current: Tensor) -> Tensor:
        keep = gains.reshape(-1, *[1] * (current.ndim - 1))
        return torch.where(keep, trials[first, batch], current)

    taken = torch.where(gains, lengths[first, batch], 0.0)
    longer = (taken / _SHRINK**2).clamp(max=1.0)
    eased = (_EASE * here.ridge).clamp(min=_LEAST_RIDGE)
    return Point(
        Multipliers(
            chosen(nu, here.multipliers.equilibrium), chosen(moved, here.multipliers.torque)
        ),
        chosen(prices, here.prices),
        chosen(forces, here.forces),
        chosen(value, here.value),
        torch.where(gains, longer, lengths[-1] * _SHRINK),
        torch.where(taken == 1.0, eased, _RIDGE),
    )


def _evaluate(
    problem: GraspForceProblem, nu: Tensor, price: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Prices and forces (K, B, n, 3) and dual values (K, B) of multipliers (K, B, .)."""
    trials, batch = nu.shape[:2]
    flat = problem.grasp_map.mT @ nu.permute(1, 2, 0)  # (B, 3n, K)
    flat = flat + problem.hand_jacobian @ price.permute(1, 2, 0)
    prices = flat.permute(2, 0, 1).reshape(trials, batch, problem.n_contacts, 3)
    forces = project_cones(problem, -prices)
    limit = torch.where(price > 0, problem.torque_max, problem.torque_min).clamp(-_FAR, _FAR)
    value = (forces * (0.5 * forces + prices)).sum(dim=(-2, -1))
    value = value + torch.linalg.vecdot(nu, problem.external_wrench.expand_as(nu))
    return prices, forces, value - torch.linalg.vecdot(price, limit)
