"""The KKT ODE of conic programs: right side, residual and convergence test in one function.

For min 1/2 x'Qx + c'x subject to b - Ax in K, with K a product of the zero cone, an orthant and
second-order cones,

    x' = -(Q x + c + A' u+),     u' = u+ - u,     u+ = Pi_K*(u + A x - b),

rests exactly where the KKT conditions hold. With an orthant and Q = 0 this is phi of Basumatary et
al., "Grasp Force Optimization as a Bilinear Matrix Inequality Problem", section 3, term by term;
the conic form is the same construction with the projection on the dual cone in place of the
positive part.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from .exceptions import SolverError
from .problem import GraspForceProblem
from .scaling import balanced_grasp_map, balanced_wrench, force_scale


@dataclass(frozen=True)
class Cone:
    """A product of cones, in the order of the rows: zero cone, orthant, second-order cones.

    Args:
        zero: rows in the zero cone (equations).
        nonnegative: rows in the orthant (inequalities).
        second_order: number of second-order cones {(t, z): |z| <= t}.
        second_order_size: rows of each, t first.
    """

    zero: int = 0
    nonnegative: int = 0
    second_order: int = 0
    second_order_size: int = 3

    @property
    def rows(self) -> int:
        """Rows of all cones together."""
        return self.zero + self.nonnegative + self.second_order * self.second_order_size


@dataclass(frozen=True, eq=False)
class ConeProgram:
    """min 1/2 x'Qx + c'x subject to b - Ax in K, with any leading batch dimensions.

    Args:
        quadratic: (..., m, m) Q, symmetric and positive semidefinite.
        linear: (..., m) c.
        matrix: (..., k, m) A.
        bound: (..., k) b.
        cone: K, with k rows.

    Raises:
        SolverError: if A, b and K differ in their rows.
    """

    quadratic: Tensor
    linear: Tensor
    matrix: Tensor
    bound: Tensor
    cone: Cone

    def __post_init__(self) -> None:
        rows = (self.matrix.shape[-2], self.bound.shape[-1], self.cone.rows)
        if len(set(rows)) > 1:
            raise SolverError(
                f"A, b and K have {rows[0]}, {rows[1]} and {rows[2]} rows; they must agree"
            )


def project_dual_cone(cone: Cone, points: Tensor) -> Tensor:
    """(..., k) Euclidean projection on K*: free where K is zero, else K itself."""
    free, positive, rest = points.split(
        [cone.zero, cone.nonnegative, cone.second_order * cone.second_order_size], dim=-1
    )
    blocks = rest.unflatten(-1, (cone.second_order, cone.second_order_size))
    top, size = blocks[..., :1], torch.linalg.vector_norm(blocks[..., 1:], dim=-1, keepdim=True)
    height = torch.where(size <= top, top, 0.5 * (top + size).clamp(min=0.0))
    ratio = torch.where(size <= top, 1.0, height / size.clamp(min=torch.finfo(size.dtype).tiny))
    blocks = torch.cat([height, ratio * blocks[..., 1:]], dim=-1)
    return torch.cat([free, positive.clamp(min=0.0), blocks.flatten(-2)], dim=-1)


def kkt_field(program: ConeProgram, x: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
    """x' (..., m) and u' (..., k) of the KKT ODE; both are zero at KKT points, and nowhere else.

    It is the right side for an integrator, the residual of a network that stands for a trajectory
    or for its limit, and, by its size, the test of convergence.
    """
    slack = u + (program.matrix @ x[..., None])[..., 0] - program.bound
    ahead = project_dual_cone(program.cone, slack)
    pull = (program.quadratic @ x[..., None])[..., 0] + program.linear
    pull = pull + (program.matrix.mT @ ahead[..., None])[..., 0]
    return -pull, ahead - u


def grasp_program(problem: GraspForceProblem) -> ConeProgram:
    """Grasp force problem(s) as cone programs in x = f / force scale, dimensionless; torch.

    Rows: equilibrium (6, torque rows over the moment arm), upper and lower torque limits (2 n_tau,
    over the norm of their column of J_h), preload and cap (2 n), friction cones (3 n: mu f_n, f_t1,
    f_t2). Rows without a constraint (infinite limits, padding contacts) are 0 x <= 1, whose
    multiplier decays to zero.
    """
    *batch, n = problem.friction.shape
    scale = force_scale(problem)[..., None]
    eye = torch.eye(3 * n, dtype=scale.dtype, device=scale.device).expand(*batch, 3 * n, 3 * n)
    mask = problem.contact_mask.to(scale.dtype)

    jacobian = problem.hand_jacobian.mT
    columns = torch.linalg.vector_norm(jacobian, dim=-1)
    unit = torch.where(columns > 0, columns, torch.ones_like(columns))
    above = (problem.torque_max - problem.external_torque) / (unit * scale)
    below = (problem.external_torque - problem.torque_min) / (unit * scale)
    normal = eye[..., 2::3, :] * mask[..., None]
    preload = torch.where(problem.contact_mask, -problem.normal_min / scale, torch.inf)
    cap = torch.where(problem.contact_mask, problem.normal_max / scale, torch.inf)
    rows = torch.cat(
        [jacobian / unit[..., None], -jacobian / unit[..., None], -normal, normal], dim=-2
    )
    limits = torch.cat([above, below, preload, cap], dim=-1)
    limited = limits.isfinite()
    rows = rows * limited[..., None]
    limits = torch.where(limited, limits, torch.ones_like(limits))

    blocks = -eye.unflatten(-2, (n, 3))[..., [2, 0, 1], :]
    weights = torch.stack([problem.friction, mask, mask], dim=-1) * mask[..., None]
    cones = (weights[..., None] * blocks).flatten(-3, -2)
    quadratic = problem.objective == "min_norm"
    zeros = torch.zeros_like(eye[..., 0])
    return ConeProgram(
        quadratic=eye if quadratic else torch.zeros_like(eye),
        linear=zeros if quadratic else normal.sum(dim=-2),
        matrix=torch.cat([balanced_grasp_map(problem), rows, cones], dim=-2),
        bound=torch.cat(
            [-balanced_wrench(problem, problem.external_wrench) / scale, limits, zeros], dim=-1
        ),
        cone=Cone(zero=6, nonnegative=limits.shape[-1], second_order=n),
    )
