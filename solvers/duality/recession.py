"""From multipliers to proofs that no forces exist: relax, then meet the dual cones exactly.

A Farkas vector must satisfy q_n >= mu |q_t| at every contact without a cap, with no tolerance.
Along the multipliers of an infeasible problem, whose dual value grows without bound, that holds
only in the limit. Multipliers of a *relaxed* problem, with slightly wider cones, meet the original
cones with a margin as soon as they come near their own.
"""

import dataclasses
from typing import Any

from array_api_compat import device

from solvers.problem import CanonicalProblem, GraspForceProblem, Multipliers, apply

from .bounds import contact_duals
from .cones import in_metric, project_cones, projection_jacobian

_STEPS = 4
"""Gauss-Newton steps onto the dual cones; more than the relaxation leaves to do."""

_RIDGE = 1e-6

_GIVEN = 1e-9
"""Torque limits closer together than this, in units of the canonical form, are one value."""


def relaxed(form: CanonicalProblem, delta: float) -> CanonicalProblem:
    """The same problems with friction times 1 + delta, plus delta / 10, and preload less delta."""
    problem = form.problem
    xp = problem.xp
    lower = problem.normal_min - delta
    wider = problem.derived(
        friction=problem.friction * (1.0 + delta) + 0.1 * delta,
        normal_min=xp.where(lower > 0, lower, xp.zeros_like(lower)),
    )
    return dataclasses.replace(form, problem=wider)


def given_torques(problem: GraspForceProblem) -> Any:
    """(B, n_tau) bool: torques whose limits coincide, which are equations, with prices of any sign.

    Args:
        problem: canonical, numpy or torch.
    """
    return problem.torque_max - problem.torque_min <= _GIVEN


def recession_direction(problem: GraspForceProblem, multipliers: Multipliers) -> Multipliers:
    """The nearest multipliers whose prices lie in the dual cones: the dual grows along them.

    Gauss-Newton steps on 1/2 |Pi_C0(-q)|^2, C0 the friction cones without preload and cap: the
    squared distance of the prices from the dual cones. Torque prices keep their signs, those of
    torques that are given apart.

    Args:
        problem: canonical problems, numpy or torch, float64, one batch dimension.
        multipliers: (B, 6) and (B, n_tau).
    """
    xp = problem.xp
    batch, n = problem.friction.shape
    cones = problem.derived(
        normal_min=xp.zeros_like(problem.normal_min),
        normal_max=xp.full_like(problem.normal_max, xp.inf),
    )
    nu, price = multipliers.equilibrium, multipliers.torque
    given = given_torques(problem)
    for _ in range(_STEPS):
        prices = contact_duals(problem, Multipliers(nu, price))
        outside = xp.reshape(project_cones(cones, -prices), (batch, 3 * n))
        curvature = projection_jacobian(cones, -prices)
        in_play = xp.astype((price != 0) | given, price.dtype)
        torque_rows = xp.linalg.matrix_transpose(problem.hand_jacobian) * in_play[..., None]
        rows = xp.concat([problem.grasp_map, torque_rows], axis=-2)
        hessian = in_metric(rows, curvature) @ xp.linalg.matrix_transpose(rows)
        identity = xp.eye(rows.shape[-2], dtype=hessian.dtype, device=device(hessian))
        target = apply(rows, outside)[..., None]
        step = xp.linalg.solve(hessian + _RIDGE * identity, target)[..., 0]
        nu = nu + step[:, :6]
        moved = price + step[:, 6:]
        price = xp.where((moved * price > 0) | given, moved, xp.zeros_like(price))
    return Multipliers(nu, price)
