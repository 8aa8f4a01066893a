"""Dual bounds and Farkas certificates: what any multipliers (nu, lambda) prove about a problem.

With q = G' nu + J_h lambda and lambda = lambda_+ - lambda_-, the Lagrangian of a grasp force
problem separates over the contacts, so that its minimum over the friction cones has a closed form.
The value

    d = min over C of [objective + q' f] + nu' w + lambda_+' (tau_ext - tau_max)
        + lambda_-' (tau_min - tau_ext)

bounds the optimum from below for *any* (nu, lambda) (weak duality). Numpy or torch, batched or
single; a `ProblemError` names the shapes where multipliers have others.
"""

from typing import Any

from solvers.problem import (
    GraspForceProblem,
    Multipliers,
    apply,
    apply_transposed,
    check_multipliers,
    force_scale,
    per_contact,
)

from .cones import cone_slope, project_cones

FORCE_HORIZON = 1e6
"""An uncapped normal force counts as bounded by this multiple of the problem's force scale in a
proof of infeasibility. A contact's exact price may be zero, and rounding then makes it -1e-17:
without some horizon an infinite force could be said to hide there."""


def contact_duals(problem: GraspForceProblem, multipliers: Multipliers) -> Any:
    """(..., n, 3) q = G' nu + J_h lambda, per contact."""
    check_multipliers(problem, multipliers)
    prices = apply_transposed(problem.grasp_map, multipliers.equilibrium)
    return per_contact(prices + apply(problem.hand_jacobian, multipliers.torque))


def usable(problem: GraspForceProblem, multipliers: Multipliers) -> Multipliers:
    """The multipliers with the prices of infinite torque limits set to zero, as the bound needs."""
    check_multipliers(problem, multipliers)
    xp = problem.xp
    price = multipliers.torque
    zero = xp.zeros_like(price)
    price = xp.where((price > 0) & ~xp.isfinite(problem.torque_max), zero, price)
    price = xp.where((price < 0) & ~xp.isfinite(problem.torque_min), zero, price)
    return Multipliers(multipliers.equilibrium, price)


def dual_bound(problem: GraspForceProblem, multipliers: Multipliers) -> Any:
    """(...,) a lower bound on the optimum from any multipliers; -inf if they say nothing.

    For the linear objectives without caps the bound of most multipliers is -inf, so the multipliers
    are first shrunk towards zero, where they are dual feasible, by the largest factor that makes
    them so. The same is tried for contacts with caps; the better of the two bounds counts.
    """
    xp = problem.xp
    multipliers = usable(problem, multipliers)
    prices = contact_duals(problem, multipliers)
    constant = _constant(problem, multipliers)
    if problem.objective == "min_norm":
        forces = project_cones(problem, -prices)
        return (
            0.5 * xp.sum(forces**2, axis=(-2, -1))
            + xp.sum(prices * forces, axis=(-2, -1))
            + constant
        )
    slope = cone_slope(problem, prices)
    uncapped = problem.contact_mask & ~xp.isfinite(problem.normal_max)
    # with a cap far above the forces, what rounding leaves of a price costs more than shrinking
    return xp.maximum(
        _linear_bound(problem, slope, constant, uncapped),
        _linear_bound(problem, slope, constant, problem.contact_mask),
    )


def _linear_bound(problem: GraspForceProblem, slope: Any, constant: Any, free: Any) -> Any:
    """(...,) dual bound of a linear objective, of multipliers shrunk until `free` contacts rest.

    Args:
        problem: with a linear objective.
        slope: (..., n) see `cone_slope`.
        constant: (...,) the terms of the load and of the torque limits.
        free: (..., n) contacts whose normal force may not gain by growing; the uncapped at least.
    """
    xp = problem.xp
    pull = xp.where(free & (slope < 0), -slope, xp.zeros_like(slope))
    largest = problem.objective == "min_max_normal"
    # what a unit of the objective must outweigh: each contact alone, or all that may grow together
    steepest = xp.sum(pull, axis=-1) if largest else xp.max(pull, axis=-1)
    shrink = xp.where(steepest > 1.0, 1.0 / xp.where(steepest > 1.0, steepest, 1.0), 1.0)
    # a few units in the last place too much would cost the whole bound: stay strictly inside
    inside = 1.0 - (4 + problem.n_contacts) * xp.finfo(shrink.dtype).eps
    shrink = xp.where(steepest > 1.0, shrink * inside, shrink)
    slope = shrink[..., None] * slope
    if largest:
        return _least_over_levels(problem, slope) + shrink * constant
    terms = _normal_terms(problem, 1.0 + slope, problem.normal_max)
    return xp.sum(terms, axis=-1) + shrink * constant


def farkas_value(problem: GraspForceProblem, multipliers: Multipliers) -> Any:
    """(...,) relative margin by which the multipliers prove infeasibility; > 0 proves it.

    The least value over the cones of q' f plus the constant terms, divided by the sum of the
    absolute terms: feasible forces would make it <= 0. Contacts without a cap are cut at
    `FORCE_HORIZON`.
    """
    xp = problem.xp
    multipliers = usable(problem, multipliers)
    slope = cone_slope(problem, contact_duals(problem, multipliers))
    horizon = FORCE_HORIZON * force_scale(problem)[..., None]
    cap = xp.where(xp.isfinite(problem.normal_max), problem.normal_max, horizon)
    upper, lower = _limits(problem, multipliers)
    load = multipliers.equilibrium * problem.external_wrench
    size = xp.sum(xp.abs(load), axis=-1) + xp.sum(xp.abs(upper) + xp.abs(lower), axis=-1)
    terms = _normal_terms(problem, slope, cap)
    size = size + xp.sum(xp.abs(terms), axis=-1)
    value = xp.sum(terms, axis=-1) + _constant(problem, multipliers)
    return value / xp.where(size > 0, size, xp.ones_like(size))


def _normal_terms(problem: GraspForceProblem, slope: Any, cap: Any) -> Any:
    """(..., n) least values of slope_i f_n,i between preload and cap."""
    xp = problem.xp
    # the cap may be infinite, and infinity times zero is no number
    value = slope * xp.where(slope < 0, cap, problem.normal_min)
    return xp.where(problem.contact_mask, value, xp.zeros_like(value))


def _least_over_levels(problem: GraspForceProblem, slope: Any) -> Any:
    """(...,) least value of t + sum_i slope_i f_n,i with f_n,i between preload and min(cap, t).

    Convex and piecewise linear in t, which ends no lower than the largest preload: the least value
    lies there or at a cap. Slopes of uncapped contacts must sum up to -1 or more.
    """
    xp = problem.xp
    zero = xp.zeros_like(slope)
    preload = xp.where(problem.contact_mask, problem.normal_min, zero)
    first = xp.max(preload, axis=-1, keepdims=True)
    cap = problem.normal_max
    levels = xp.where(xp.isfinite(cap) & (cap > first), cap, first + zero)
    levels = xp.concat([first, levels], axis=-1)[..., None]
    growing = xp.where(problem.contact_mask & (slope < 0), slope, zero)[..., None, :]
    resting = xp.where(problem.contact_mask & (slope >= 0), slope * preload, zero)
    values = levels[..., 0] + xp.sum(growing * xp.minimum(cap[..., None, :], levels), axis=-1)
    return xp.min(values, axis=-1) + xp.sum(resting, axis=-1)


def _limits(problem: GraspForceProblem, multipliers: Multipliers) -> tuple[Any, Any]:
    """(..., n_tau) twice: the terms of the upper and of the lower torque limits."""
    xp = problem.xp
    price = multipliers.torque
    zero = xp.zeros_like(price)
    room_above = xp.where(price > 0, problem.external_torque - problem.torque_max, zero)
    room_below = xp.where(price < 0, problem.torque_min - problem.external_torque, zero)
    return xp.where(price > 0, price, zero) * room_above, xp.where(
        price < 0, -price, zero
    ) * room_below


def _constant(problem: GraspForceProblem, multipliers: Multipliers) -> Any:
    xp = problem.xp
    upper, lower = _limits(problem, multipliers)
    load = xp.sum(multipliers.equilibrium * problem.external_wrench, axis=-1)
    return load + xp.sum(upper + lower, axis=-1)
