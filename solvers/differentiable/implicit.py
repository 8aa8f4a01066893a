"""The gradients of an optimum in the data of its problem, from forces and multipliers alone.

With q = G' nu + J_h lambda the optimum of a `min_norm` problem is the fixed point f = Pi_C(-q),
G f = -w, priced torques at their limits; the implicit function theorem differentiates it. The value
of any objective has the gradient of the Lagrangian, by Danskin's theorem. `solvers.differentiable`
is the way to use this.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from solvers.duality import contact_duals, in_metric, project_cones, projection_jacobian
from solvers.exceptions import SolverError
from solvers.problem import (
    ARRAY_FIELDS,
    GraspForceProblem,
    Multipliers,
    apply,
    apply_transposed,
    force_scale,
    per_contact,
    tangential_size,
)

FIELDS = tuple(name for name in ARRAY_FIELDS if name != "contact_mask")
"""The fields of a problem that have gradients: all arrays but the mask."""

_RANK_TOLERANCE = 1e-10
"""Eigenvalues of the system of the backward pass, its diagonal one, below this count as zero."""

_AT_BOUND = 1e-6
"""Distance of a normal force from preload or cap, over the force scale, that counts as none."""


Gradients = Callable[[Tensor], dict[str, Tensor]]


@dataclass(frozen=True, eq=False)
class Optimum:
    """A solved batch: what the solver said, and where it ended, sharpened.

    Args:
        forces: (..., 3n) the solver's; NaN where not solved.
        value: (...,) their objective; NaN where not solved.
        multipliers: sharpened; zero where not solved.
        solved: (...,) bool tensor.
        status: (...,) numpy strings.
    """

    forces: Tensor
    value: Tensor
    multipliers: Multipliers
    solved: Tensor
    status: np.ndarray


class KnownOutput(torch.autograd.Function):
    """A result that is known already, as a function of the fields of its problem."""

    @staticmethod
    def forward(output: Tensor, gradients: Gradients, *fields: Tensor) -> Tensor:
        """The output; `gradients` turns the gradient in it into those in the `FIELDS`."""
        return output.clone()

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
        """Keep the fields, so that torch notices if they are changed in place."""
        ctx.gradients = inputs[1]
        ctx.save_for_backward(*inputs[2:])

    @staticmethod
    def backward(ctx: Any, wanted: Tensor) -> tuple[Tensor | None, ...]:
        """The gradients in the fields; they have none themselves, and say so if asked."""
        fields = ctx.saved_tensors
        with torch.no_grad():
            gradients = ctx.gradients(wanted)
        found = [gradients[name] for name in FIELDS]
        if torch.is_grad_enabled():
            found = _NoSecond.apply(*found, *fields)
        return None, None, *found


class _NoSecond(torch.autograd.Function):
    """Passes first derivatives on, and refuses to differentiate them."""

    @staticmethod
    def forward(*tensors: Tensor) -> tuple[Tensor, ...]:
        return tuple(tensor.clone() for tensor in tensors[: len(FIELDS)])

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
        pass

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Tensor:
        raise SolverError("optimal forces and values have no second derivatives here")


def value_gradients(
    problem: GraspForceProblem, optimum: Optimum, wanted: Tensor
) -> dict[str, Tensor]:
    """The gradient of the Lagrangian: the prices of everything.

    The cone's own multiplier follows from stationarity, since |f_t| is as large as it may be where
    anything pulls along the tangents; what is left over is the price of preload or cap.

    Args:
        problem: the problem(s), float64 tensors without gradients.
        optimum: their optimum.
        wanted: (...,) gradient in the value.
    """
    nu, price = optimum.multipliers.equilibrium, optimum.multipliers.torque
    prices = contact_duals(problem, optimum.multipliers)
    if problem.objective == "min_norm":
        # of the multipliers alone, which are sharper than the solver's forces
        force = project_cones(problem, -prices)
        pull = prices + force
    else:
        force = per_contact(torch.where(optimum.solved[..., None], optimum.forces, 0.0))
        pull = prices.clone()
        if problem.objective == "sum_normal":
            pull[..., 2] += 1.0
    cone = tangential_size(problem.xp, pull)
    rest = torch.where(problem.contact_mask, pull[..., 2] - problem.friction * cone, 0.0)
    near = _AT_BOUND * force_scale(problem)[..., None]
    at_floor = (rest > 0) & (force[..., 2] - problem.normal_min <= near)
    capped = (rest < 0) & (problem.normal_max - force[..., 2] <= near)
    flat = force.flatten(-2)
    weight = torch.where(optimum.solved, wanted, 0.0)
    gradients = {
        "grasp_map": _outer(nu, flat),
        "hand_jacobian": _outer(flat, price),
        "friction": -cone * force[..., 2],
        "torque_min": (-price).clamp(min=0.0),
        "torque_max": (-price).clamp(max=0.0),
        "external_wrench": nu,
        "external_torque": price,
        "normal_min": torch.where(at_floor, rest, 0.0),
        "normal_max": torch.where(capped, rest, 0.0),
    }
    return {name: _times(weight, gradient) for name, gradient in gradients.items()}


def forces_gradients(
    problem: GraspForceProblem, optimum: Optimum, wanted: Tensor
) -> dict[str, Tensor]:
    """The implicit function theorem at the fixed point, for `min_norm`.

    With A the equilibrium rows and the priced torque rows, and D the projection's Jacobian,
    A D A' y = A D v and u = v - A' y turn the gradient v in the forces into y in the load and in
    the limits, and into u in what moves the projection: its point -q and its cones.

    Args:
        problem: the problem(s), float64 tensors without gradients.
        optimum: their optimum.
        wanted: (..., 3n) v.
    """
    nu, price = optimum.multipliers.equilibrium, optimum.multipliers.torque
    points = -contact_duals(problem, optimum.multipliers)
    flat = project_cones(problem, points).flatten(-2)
    wanted = torch.where(optimum.solved[..., None], wanted, 0.0)

    priced = (price != 0).to(price.dtype)
    rows = torch.cat([problem.grasp_map, problem.hand_jacobian.mT * priced[..., None]], dim=-2)
    curvature = projection_jacobian(problem, points)
    weighted = in_metric(rows, curvature)
    lift = _least_squares(weighted @ rows.mT, apply(weighted, wanted))
    rest = wanted - apply_transposed(rows, lift)
    moved = in_metric(rest[..., None, :], curvature)[..., 0, :]
    balance, torque = lift[..., :6], lift[..., 6:] * priced
    friction, preload, cap = _cone_gradients(problem, points, rest)
    return {
        "grasp_map": -_outer(nu, moved) - _outer(balance, flat),
        "hand_jacobian": -_outer(moved, price) - _outer(flat, torque),
        "friction": friction,
        "torque_min": torch.where(price < 0, torque, 0.0),
        "torque_max": torch.where(price > 0, torque, 0.0),
        "external_wrench": -balance,
        "external_torque": -torque,
        "normal_min": preload,
        "normal_max": cap,
    }


def _outer(left: Tensor, right: Tensor) -> Tensor:
    return left[..., :, None] * right[..., None, :]


def _times(weight: Tensor, array: Tensor) -> Tensor:
    """(...,) weights times an array that has them as its leading dimensions."""
    return weight.reshape((*weight.shape, *[1] * (array.ndim - weight.ndim))) * array


def _least_squares(matrix: Tensor, target: Tensor) -> Tensor:
    """(..., k) the shortest solution of symmetric, possibly singular, systems (..., k, k).

    Their diagonal is scaled to one first, which makes force and torque rows comparable.
    """
    diagonal = matrix.diagonal(dim1=-2, dim2=-1)
    scale = torch.where(diagonal > 0, diagonal, 1.0).rsqrt()
    even = matrix * scale[..., :, None] * scale[..., None, :]
    inverse = torch.linalg.pinv(even, rtol=_RANK_TOLERANCE, hermitian=True)
    return scale * apply(inverse, scale * target)


def _cone_gradients(
    problem: GraspForceProblem, points: Tensor, wanted: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """(..., n) each: `wanted` (..., 3n) times the projection's derivative in mu, preload, cap."""
    with torch.enable_grad():
        cones = [
            getattr(problem, name).detach().clone().requires_grad_()
            for name in ("friction", "normal_min", "normal_max")
        ]
        friction, preload, cap = cones
        there = problem.derived(friction=friction, normal_min=preload, normal_max=cap)
        projected = project_cones(there, points.detach()).flatten(-2)
        gradients = torch.autograd.grad(projected, cones, wanted)
    return gradients[0], gradients[1], gradients[2]
