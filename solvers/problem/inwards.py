"""Limits moved inwards, so that neither rounding nor a tolerance breaks the true ones."""

from typing import Any

from .definition import GraspForceProblem


def moved_inwards(
    problem: GraspForceProblem, share: float, preload: Any, torque: tuple[Any, Any]
) -> GraspForceProblem:
    """The problems with friction and caps times 1 - share, preloads and torque limits moved.

    A limit moves by no more than a quarter of the distance to its opposite, so that limits that
    coincide stay. The kernels have this rule in their own form (`solvers.compiled.newton.setup`,
    `solvers.compiled.interior.form`).

    Args:
        problem: numpy or torch, any batch dimensions.
        share: of friction and caps, between 0 and 1.
        preload: (..., n) by how much preloads grow, in the unit of forces.
        torque: (..., n_tau) by how much lower and upper limits move, in the unit of torques.
    """
    xp = problem.xp
    cap, nothing = problem.normal_max, xp.zeros_like(problem.normal_min)
    room = 0.25 * (cap - problem.normal_min)
    up = xp.where(problem.contact_mask, xp.minimum(nothing + preload, room), nothing)
    # an infinite cap less a share of itself is no number
    down = xp.where(xp.isfinite(cap), xp.minimum(share * cap, room), nothing)
    width = 0.25 * (problem.torque_max - problem.torque_min)
    lower, upper = (xp.minimum(shift, width) for shift in torque)
    return problem.derived(
        friction=problem.friction * (1.0 - share),
        normal_min=problem.normal_min + up,
        normal_max=cap - down,
        torque_min=problem.torque_min + lower,
        torque_max=problem.torque_max - upper,
    )
