"""Optimal forces, and their cost, as differentiable functions of the whole problem, in torch.

Give a `GraspForceProblem` of tensors, some of which require gradients, and any solver by its name:

    problem = GraspForceProblem(grasp_map=..., friction=friction.requires_grad_(), ...)
    optimum = optimal_forces(problem)
    loss(optimum.forces[optimum.solved]).backward()

No solver is differentiated: the answer alone says how it moves with the problem. The forces' fixed
point is f = Pi_C(-q), G f = -w, priced torques at their limits, with q = G' nu + J_h lambda (a
semismooth Newton system, see `solvers.exact.torch_newton`); the implicit function theorem turns a
gradient in the forces into one in the data by a linear solve in 6 unknowns and one for each priced
torque (Amos and Kolter, "OptNet", 2017; Agrawal et al., "Differentiable convex optimization
layers", 2019). The cost needs no solve: its gradient is that of the Lagrangian (Danskin's theorem).

Kinks: where a contact begins to slide or to press, where a force reaches its preload or cap with no
price, or a torque its limit, the forces have no derivative, only one on each side; what comes back
is then an element of the generalised Jacobian, built from one side of every kink. Where the
multipliers are not unique, as with more tight torque limits than the contacts can tell apart, those
of least norm are taken. Second derivatives are refused.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from solvers.base import Solver
from solvers.exact.dual_newton_torch import STATUS_CODES, solve_tensors
from solvers.exact.torch_newton import ascent_step, cholesky_qr, direction, evaluate_dual
from solvers.exceptions import SolverError
from solvers.judge import Status
from solvers.problem import GraspForceProblem, Multipliers, as_problem, canonical
from solvers.registry import solve

from .implicit import FIELDS, KnownOutput, Optimum, forces_gradients, value_gradients

_REFINEMENTS = 2
"""Newton steps that sharpen a solver's multipliers: gradients are as exact as these."""


@dataclass(frozen=True, eq=False)
class OptimalForces:
    """Optimal forces with gradients.

    Args:
        forces: (..., 3n) N; NaN, with gradients zero, where the problem was not solved.
        solved: (...,) bool tensor, True where the status is `optimal`.
        status: (...,) numpy strings, the solver's status.
    """

    forces: Tensor
    solved: Tensor
    status: np.ndarray


@dataclass(frozen=True, eq=False)
class OptimalValue:
    """The least objective with gradients.

    Args:
        value: (...,) N^2 for `min_norm`, N for the linear objectives; NaN, with gradients zero,
            where the problem was not solved.
        solved: (...,) bool tensor, True where the status is `optimal`.
        status: (...,) numpy strings, the solver's status.
    """

    value: Tensor
    solved: Tensor
    status: np.ndarray


def optimal_forces(
    problem: GraspForceProblem, solver: str | Solver = "dual_newton", **settings: Any
) -> OptimalForces:
    """The forces of least norm, differentiable in every field of the problem that wants it.

    The forces are the solver's own. Problems that end other than `optimal` (infeasible ones, say)
    have NaN forces and pass no gradients; they do not disturb the rest of the batch. A loss must
    leave them out by index, as in the module's example: zero times NaN is NaN.

    Args:
        problem: `min_norm` problem(s) of torch tensors on one device; solved in float64.
        solver: name of a solver of `solvers.available_solvers()`, or a solver.
            `dual_newton_torch` never leaves the problem's device.
        settings: for the solver of that name.

    Raises:
        SolverError: for numpy arrays, or another objective: the forces of the linear objectives
            are neither unique nor continuous.
        UnknownSolverError, MissingDependencyError: as in `solvers.solve`.
    """
    if as_problem(problem).objective != "min_norm":
        raise SolverError(
            f"forces that minimise {problem.objective} are not unique and have no gradient; "
            "use min_norm, or optimal_value"
        )
    exact, frame = _split(problem)
    optimum = _optimum(frame, solver, settings)
    gradients = partial(forces_gradients, frame, optimum)
    forces = KnownOutput.apply(optimum.forces, gradients, *exact)
    return OptimalForces(forces.to(problem.friction.dtype), optimum.solved, optimum.status)


def optimal_value(
    problem: GraspForceProblem, solver: str | Solver = "dual_newton", **settings: Any
) -> OptimalValue:
    """The least value of the objective, differentiable in every field of the problem that wants it.

    For every objective the gradient is that of the Lagrangian at the optimum: the prices of load,
    torque limits, preload and caps, and of the friction cones. Problems that end other than
    `optimal` have the value NaN and pass no gradients.

    Args:
        problem: problem(s) of torch tensors on one device; solved in float64.
        solver: name of a solver of `solvers.available_solvers()`, or a solver.
        settings: for the solver of that name.

    Raises:
        SolverError: for numpy arrays, or an objective that the solver lacks.
        UnknownSolverError, MissingDependencyError: as in `solvers.solve`.
    """
    exact, frame = _split(as_problem(problem))
    optimum = _optimum(frame, solver, settings)
    gradients = partial(value_gradients, frame, optimum)
    value = KnownOutput.apply(optimum.value, gradients, *exact)
    return OptimalValue(value.to(problem.friction.dtype), optimum.solved, optimum.status)


@torch.no_grad()
def _optimum(problem: GraspForceProblem, solver: str | Solver, settings: dict[str, Any]) -> Optimum:
    stays = isinstance(solver, str) and solver == "dual_newton_torch"
    if stays and problem.objective == "min_norm" and settings.keys() <= {"tolerance"}:
        on_device = solve_tensors(problem, **settings)
        answer: Any = on_device
        status = np.array(STATUS_CODES)[on_device.status.cpu().numpy()]
        solved = on_device.is_status(Status.OPTIMAL)
    else:
        answer = solve(problem, solver, **settings)
        status = answer.status
        solved = torch.as_tensor(status == Status.OPTIMAL, device=problem.friction.device)

    wide = solved[..., None]
    known = partial(torch.where, wide, other=0.0)
    multipliers = Multipliers(answer.equilibrium_dual, answer.torque_dual).map(known)
    if problem.objective == "min_norm":
        multipliers = _sharpened(problem, multipliers, answer.forces).map(known)
    return Optimum(
        forces=torch.where(wide, answer.forces, torch.nan),
        value=torch.where(solved, answer.objective, torch.nan),
        multipliers=multipliers,
        solved=solved,
        status=status,
    )


def _sharpened(problem: GraspForceProblem, multipliers: Multipliers, forces: Tensor) -> Multipliers:
    """The multipliers after a few Newton steps, prices of loose torque limits set to zero."""
    flat = problem.reshape(-1)
    form = canonical(flat, cholesky_qr)
    nu = multipliers.equilibrium.reshape(len(flat), 6)
    price = multipliers.torque.reshape(len(flat), problem.n_joints)
    scaled = form.scaled(Multipliers(nu, price))
    inner = form.problem
    pushed = forces.reshape(len(flat), 3 * problem.n_contacts).nan_to_num() / form.scale[:, None]
    torque = (pushed[:, None] @ inner.hand_jacobian)[:, 0]
    limit = torch.where(scaled.torque > 0, inner.torque_max, inner.torque_min)
    tight = (torque - limit).abs() < scaled.torque.abs()
    here = evaluate_dual(
        inner, Multipliers(scaled.equilibrium, torch.where(tight, scaled.torque, 0.0))
    )
    for _ in range(_REFINEMENTS):
        here = ascent_step(inner, here, direction(inner, here))
    sharp = form.multipliers(here.multipliers)
    shape = problem.batch_shape
    return Multipliers(
        sharp.equilibrium.reshape((*shape, 6)), sharp.torque.reshape((*shape, problem.n_joints))
    )


def _split(problem: GraspForceProblem) -> tuple[list[Tensor], GraspForceProblem]:
    """The fields in float64, with their gradients, and the problem without."""
    if not isinstance(problem.grasp_map, Tensor):
        raise SolverError("gradients need torch tensors: call problem.to_torch() first")
    exact = problem.to_torch()
    fields = [getattr(exact, name) for name in FIELDS]
    detached = {name: field.detach() for name, field in zip(FIELDS, fields, strict=True)}
    return fields, exact.derived(**detached)
