"""A few Newton steps on the concave dual, batched: they turn good multipliers into exact ones.

Maximising the dual instead of solving the KKT equations makes a semismooth Newton method global:
the dual value is concave, so that a line search on it always has somewhere to go.
"""

import numpy as np

from solvers.arrays import Array
from solvers.duality import (
    contact_duals,
    dual_bound,
    given_torques,
    in_metric,
    project_cones,
    projection_jacobian,
)
from solvers.problem import GraspForceProblem, Multipliers, apply, apply_transposed

_REGULARISATION = (1e-11, 1e-4)
"""Added to the Hessian: a floor, and a share of the residual up to one."""

_SHRINK = 0.4
_TRIALS = 10
_ARMIJO = 1e-4
"""Line search: factor, number of lengths, and least share of the promised gain."""


def polished(problem: GraspForceProblem, start: Multipliers, steps: int) -> Multipliers:
    """Multipliers after Newton steps with a line search on the dual value, which never falls.

    Args:
        problem: canonical problems (`solvers.problem.canonical_form`), float64 numpy, one batch
        dimension.
        start: (B, 6) and (B, n_tau).
        steps: how many.
    """
    here = start
    for _ in range(steps):
        gradient, step = _newton(problem, here)
        here = _line_search(problem, here, gradient, step)
    return here


def dual_residual(problem: GraspForceProblem, here: Multipliers) -> Array:
    """(B,) norm of the dual's gradient in the rows in play; zero at the optimum alone."""
    return np.linalg.norm(_newton(problem, here)[0], axis=-1)


def _newton(problem: GraspForceProblem, here: Multipliers) -> tuple[Array, Array]:
    """(B, 6 + n_tau) twice: the dual's gradient in the rows in play, and the Newton step."""
    batch, n = problem.friction.shape
    prices = contact_duals(problem, here)
    forces = project_cones(problem, -prices).reshape(batch, 3 * n)
    torque = apply_transposed(problem.hand_jacobian, forces)
    clipped = np.clip(torque, problem.torque_min, problem.torque_max)
    limit = np.where(here.torque > 0, problem.torque_max, problem.torque_min)
    limit = np.where(here.torque == 0, clipped, limit)
    in_play = (here.torque != 0) | (clipped != torque) | given_torques(problem)
    miss = np.zeros_like(torque)
    np.subtract(torque, limit, out=miss, where=in_play)
    balance = apply(problem.grasp_map, forces) + problem.external_wrench
    gradient = np.concatenate([balance, miss], axis=-1)
    rows = np.concatenate(
        [problem.grasp_map, np.swapaxes(problem.hand_jacobian, -1, -2) * in_play[..., None]],
        axis=-2,
    )
    curvature = projection_jacobian(problem, -prices)
    hessian = in_metric(rows, curvature) @ np.swapaxes(rows, -1, -2)
    residual = np.linalg.norm(gradient, axis=-1, keepdims=True)
    floor, share = _REGULARISATION
    ridge = np.tile(floor + share * np.minimum(1.0, residual), rows.shape[-2])
    ridge[:, 6:] += ~in_play
    hessian = hessian + ridge[..., None, :] * np.eye(rows.shape[-2])
    step: Array = np.linalg.solve(hessian, gradient[..., None])[..., 0]
    return gradient, step


def _line_search(
    problem: GraspForceProblem, here: Multipliers, gradient: Array, step: Array
) -> Multipliers:
    """The first of a few ever shorter steps that gains enough; none, if no step does."""
    value = dual_bound(problem, here)
    slope = np.sum(gradient * step, axis=-1)
    best, given = here, given_torques(problem)
    open_ = np.ones(len(step), dtype=bool)
    length = 1.0
    for _ in range(_TRIALS):
        price = here.torque + length * step[:, 6:]
        # a price that changes its sign stops at zero, where its limit leaves play, and one that is
        # zero leaves it only on the side where its limit is exceeded; an equation's goes anywhere
        side = np.where(here.torque != 0, here.torque, gradient[:, 6:])
        price = np.where((price * side < 0) & ~given, 0.0, price)
        trial = Multipliers(here.equilibrium + length * step[:, :6], price)
        gains = open_ & (dual_bound(problem, trial) >= value + _ARMIJO * length * slope)
        best = Multipliers(
            np.where(gains[:, None], trial.equilibrium, best.equilibrium),
            np.where(gains[:, None], trial.torque, best.torque),
        )
        open_ &= ~gains
        if not open_.any():
            break
        length *= _SHRINK
    return best
