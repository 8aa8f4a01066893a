"""The KKT ODE of conic programs: right side, residual and convergence test in one function.

For min 1/2 x'Qx + c'x subject to b - Ax in K, with K a product of the zero cone, an orthant and
second-order cones,

    x' = -(Q x + c + A' u+),     u' = u+ - u,     u+ = Pi_K*(u + A x - b),

rests exactly where the KKT conditions hold. With an orthant and Q = 0 this is phi of Basumatary et
al., "Grasp Force Optimization as a Bilinear Matrix Inequality Problem", equation 15, term by term;
the conic form is the same construction with the projection on the dual cone in place of the
positive part.
"""

from dataclasses import dataclass
from itertools import groupby

import torch
from torch import Tensor

from solvers.arguments import check_vectors
from solvers.exceptions import SolverError
from solvers.problem import GraspForceProblem, Multipliers, canonical

OBJECTIVE_WEIGHT = 0.1
"""What `grasp_program` multiplies the objective by. Where the active constraints have the singular
value s and the objective the curvature a, the slowest mode of the flow decays at the rate s^2 / a
where a > 2 s, and (a + s^2) / 2 below: a weight of 1 would make the flow of a grasp, where s is
about 0.1, ten times slower."""


@dataclass(frozen=True)
class Cone:
    """A product of cones, in the order of the rows: zero cone, orthant, second-order cones.

    Args:
        zero: rows in the zero cone (equations).
        nonnegative: rows in the orthant (inequalities).
        second_order: rows of each second-order cone {(t, z): |z| <= t}, t first; a cone of one row
            is a half-line. Equal sizes that follow one another are projected together.

    Raises:
        SolverError: for a negative number of rows, or a second-order cone without any.
    """

    zero: int = 0
    nonnegative: int = 0
    second_order: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if min(self.zero, self.nonnegative) < 0 or min(self.second_order, default=1) < 1:
            raise SolverError(
                f"no cone has a negative number of rows, and a second-order cone has at least one; "
                f"these are {self.zero}, {self.nonnegative} and {self.second_order}"
            )

    @property
    def rows(self) -> int:
        """Rows of all cones together."""
        return self.zero + self.nonnegative + sum(self.second_order)


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
        ProblemError: if Q, c and A differ in their columns.
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
        columns = self.linear.shape[-1]
        batch = tuple(self.linear.shape[:-1])
        check_vectors("matrix", self.matrix, batch, (rows[0], columns))
        check_vectors("quadratic", self.quadratic, batch, (columns, columns))

    def __getitem__(self, index: int | slice | Tensor) -> "ConeProgram":
        """The programs at `index` of the first batch dimension."""
        return ConeProgram(
            self.quadratic[index],
            self.linear[index],
            self.matrix[index],
            self.bound[index],
            self.cone,
        )


def linear_program(cost: Tensor, matrix: Tensor, bound: Tensor) -> ConeProgram:
    """min c'x subject to Ax <= b, the program of the paper's equation 11."""
    return ConeProgram(
        quadratic=torch.zeros_like(cost[..., None] * cost[..., None, :]),
        linear=cost,
        matrix=matrix,
        bound=bound,
        cone=Cone(nonnegative=matrix.shape[-2]),
    )


def project_dual_cone(cone: Cone, points: Tensor) -> Tensor:
    """(..., k) Euclidean projection on K*: free where K is zero, else K itself."""
    free, positive, rest = points.split([cone.zero, cone.nonnegative, sum(cone.second_order)], -1)
    runs = [(size, len(list(run))) for size, run in groupby(cone.second_order)]
    blocks = rest.split([size * count for size, count in runs], -1) if runs else ()
    projected = [
        _project_second_order(block.unflatten(-1, (count, size))).flatten(-2)
        for block, (size, count) in zip(blocks, runs, strict=True)
    ]
    return torch.cat([free, positive.clamp(min=0.0), *projected], dim=-1)


def _project_second_order(points: Tensor) -> Tensor:
    """(..., size) the projection on one second-order cone, t first."""
    top, size = points[..., :1], torch.linalg.vector_norm(points[..., 1:], dim=-1, keepdim=True)
    height = torch.where(size <= top, top, 0.5 * (top + size).clamp(min=0.0))
    ratio = torch.where(size <= top, 1.0, height / size.clamp(min=torch.finfo(size.dtype).tiny))
    return torch.cat([height, ratio * points[..., 1:]], dim=-1)


def kkt_field(program: ConeProgram, x: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
    """x' (..., m) and u' (..., k) of the KKT ODE; both are zero at KKT points, and nowhere else.

    It is the right side for an integrator, the residual of a network that stands for a trajectory
    or for its limit, and, by its size, the test of convergence: the stationarity of the Lagrangian
    fails by |x'|, and b - Ax lies within |u'| of K. One program takes any batch of points.

    Raises:
        ProblemError: for points of other shapes, (..., m) and (..., k).
    """
    batch = tuple(program.linear.shape[:-1])
    check_vectors("x", x, batch, (program.linear.shape[-1],))
    check_vectors("u", u, batch, (program.bound.shape[-1],))
    slack = u + _apply(program.matrix, x) - program.bound
    ahead = project_dual_cone(program.cone, slack)
    pull = _apply(program.quadratic, x) + program.linear + _apply(program.matrix.mT, ahead)
    return -pull, ahead - u


def _apply(matrix: Tensor, vector: Tensor) -> Tensor:
    # one program at many points is one product, three times faster than a batch of products
    return vector @ matrix.mT if matrix.ndim == 2 else (matrix @ vector[..., None])[..., 0]


def grasp_program(problem: GraspForceProblem) -> ConeProgram:
    """Grasp force problem(s) as cone programs in x = f / force scale, dimensionless; torch.

    Rows, in the canonical form (`solvers.problem.canonical_form`): equilibrium (6, orthonormal),
    upper and lower torque limits (2 n_tau), preload and cap (2 n), friction cones (3 n: mu f_n,
    f_t1, f_t2, over mu where that is more than 1). Rows without a constraint (infinite limits,
    padding contacts) are 0 x <= 1, whose multiplier decays to zero. The objective is that of the
    problem, over its unit, times `OBJECTIVE_WEIGHT`.

    Raises:
        SolverError: for `min_max_normal`, which needs one more variable.
    """
    form = canonical(problem).problem
    *batch, n = form.friction.shape
    eye = torch.eye(3 * n, dtype=form.friction.dtype, device=form.friction.device)
    eye = eye.expand(*batch, 3 * n, 3 * n)
    mask = form.contact_mask.to(eye.dtype)

    torque, normal = form.hand_jacobian.mT, eye[..., 2::3, :] * mask[..., None]
    rows = torch.cat([torque, -torque, -normal, normal], dim=-2)
    # the preload's row is what keeps a frictionless contact from pulling
    preload = torch.where(form.contact_mask, -form.normal_min, torch.inf)
    cap = torch.where(form.contact_mask, form.normal_max, torch.inf)
    limits = torch.cat([form.torque_max, -form.torque_min, preload, cap], dim=-1)
    limited = limits.isfinite()
    rows = rows * limited[..., None]
    limits = torch.where(limited, limits, torch.ones_like(limits))

    blocks = -eye.unflatten(-2, (n, 3))[..., [2, 0, 1], :]
    weights = torch.stack([form.friction, mask, mask], dim=-1) * mask[..., None]
    # a row of length mu would make the flow as stiff as mu^2
    weights = weights / form.friction.clamp(min=1.0)[..., None]
    cones = (weights[..., None] * blocks).flatten(-3, -2)
    if problem.objective not in ("min_norm", "sum_normal"):
        raise SolverError(f"the KKT flow knows no {problem.objective}; use the solver 'clarabel'")
    quadratic = problem.objective == "min_norm"
    zeros = torch.zeros_like(eye[..., 0])
    return ConeProgram(
        quadratic=OBJECTIVE_WEIGHT * eye if quadratic else torch.zeros_like(eye),
        linear=zeros if quadratic else OBJECTIVE_WEIGHT * normal.sum(dim=-2),
        matrix=torch.cat([form.grasp_map, rows, cones], dim=-2),
        bound=torch.cat([-form.external_wrench, limits, zeros], dim=-1),
        cone=Cone(zero=6, nonnegative=limits.shape[-1], second_order=(3,) * n),
    )


def grasp_multipliers(problem: GraspForceProblem, u: Tensor) -> Multipliers:
    """nu (..., 6) and lambda (..., n_tau), in the problem's units, of u (..., k) of its program."""
    form = canonical(problem)
    scaled = canonical_multipliers(problem, u)
    # the canonical form measures objectives in units of force squared
    unit = form.scale[..., None] if problem.objective == "sum_normal" else 1.0
    return form.multipliers(Multipliers(scaled.equilibrium / unit, scaled.torque / unit))


def canonical_multipliers(problem: GraspForceProblem, u: Tensor) -> Multipliers:
    """nu and lambda of the canonical form of the problem(s), of u (..., k) of its program."""
    joints = problem.n_joints
    weighted = u / OBJECTIVE_WEIGHT
    above, below = weighted[..., 6 : 6 + joints], weighted[..., 6 + joints : 6 + 2 * joints]
    return Multipliers(weighted[..., :6], above - below)
