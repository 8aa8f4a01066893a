"""Scales that make a grasp force problem independent of its units of length and force."""

from typing import Any

from solvers.arguments import check_vectors

from .fields import WRENCH_SIZE, ProblemFields


def moment_arm(problem: ProblemFields) -> Any:
    """(...,) m: root mean square moment arm of the grasp map, the length that balances its rows.

    Dividing the torque rows by it makes rank checks and residuals independent of the unit of
    length.
    """
    return _arm(problem.xp, problem.grasp_map)


def balanced_grasp_map(problem: ProblemFields) -> Any:
    """(..., 6, 3n): G with torque rows divided by `moment_arm`; dimensionless."""
    return balance_rows(problem.xp, problem.grasp_map)


def balance_rows(xp: Any, grasp_map: Any) -> Any:
    """(..., 6, 3n): a grasp map, of whatever rank, with torque rows divided by its moment arm."""
    length = _arm(xp, grasp_map)[..., None, None]
    return xp.concat([grasp_map[..., :3, :], grasp_map[..., 3:, :] / length], axis=-2)


def _arm(xp: Any, grasp_map: Any) -> Any:
    force, torque = grasp_map[..., :3, :], grasp_map[..., 3:, :]
    size = xp.sum(force**2, axis=(-2, -1))
    arm = xp.sqrt(xp.sum(torque**2, axis=(-2, -1)) / xp.where(size > 0, size, xp.ones_like(size)))
    return xp.where((arm > 0) & (size > 0), arm, xp.ones_like(arm))


def balanced_wrench(problem: ProblemFields, wrench: Any) -> Any:
    """(..., 6) N: a wrench with its torque divided by `moment_arm`."""
    check_vectors("wrench", wrench, problem.batch_shape, (WRENCH_SIZE,))
    length = moment_arm(problem)[..., None]
    return problem.xp.concat([wrench[..., :3], wrench[..., 3:] / length], axis=-1)


def least_force(problem: ProblemFields, wrench: Any) -> Any:
    """(..., 3n) N: the smallest contact forces f (2-norm) with G f = wrench, friction ignored."""
    xp = problem.xp
    balanced = balanced_grasp_map(problem)
    transposed = xp.linalg.matrix_transpose(balanced)
    target = balanced_wrench(problem, wrench)[..., None]
    return (transposed @ xp.linalg.solve(balanced @ transposed, target))[..., 0]


def force_scale(problem: ProblemFields) -> Any:
    """(...,) N: the size that the forces must have, from the data alone; 1 where none are needed.

    sqrt(|G^+ w|^2 + |normal_min|^2 + d^2), where d is the force that brings the joint torques back
    within their limits: the largest excess of external_torque over the length of its column of J_h.
    """
    xp = problem.xp
    load = least_force(problem, problem.external_wrench)
    preload = problem.normal_min * xp.astype(problem.contact_mask, problem.normal_min.dtype)
    square = xp.sum(load**2, axis=-1) + xp.sum(preload**2, axis=-1) + _torque_demand(problem) ** 2
    positive = square > 0
    return xp.sqrt(xp.where(positive, square, xp.ones_like(square)))


def _torque_demand(problem: ProblemFields) -> Any:
    xp = problem.xp
    torque = problem.external_torque
    excess = xp.maximum(torque - problem.torque_max, problem.torque_min - torque)
    column = xp.linalg.vector_norm(problem.hand_jacobian, axis=-2)
    needs = (excess > 0) & (column > 0)
    force = xp.where(needs, excess, xp.zeros_like(excess)) / xp.where(
        needs, column, xp.ones_like(column)
    )
    # a sum over no joints is zero, and a maximum over none an error
    return xp.max(force, axis=-1) if problem.n_joints else xp.sum(force, axis=-1)
