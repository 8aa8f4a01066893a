"""The constraints of a grasp as rows of a cone program, and a whole problem as one."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from solvers.arrays import Array, Mask
from solvers.duality import FORCE_HORIZON
from solvers.problem import GraspForceProblem, Multipliers, as_problem, force_scale, moment_arm

from .program import POSITIVE, SECOND_ORDER, ZERO, Rows


def cone_rows(friction: Array) -> Array:
    """(..., 3n, 3n) rows A of -A f = (mu f_n, f_t1, f_t2) at each contact; friction (..., n)."""
    *batch, n = friction.shape
    rows = np.zeros((*batch, n, 3, n, 3))
    contact = np.arange(n)
    rows[..., contact, 0, contact, 2] = -friction
    rows[..., contact, 1, contact, 0] = -1.0
    rows[..., contact, 2, contact, 1] = -1.0
    return rows.reshape(*batch, 3 * n, 3 * n)


def torque_rows(problem: GraspForceProblem, above: Mask, below: Mask) -> Rows:
    """Upper limits of the joints in `above`, then lower ones of those in `below`; N·m."""
    torque = problem.hand_jacobian.T
    return Rows(
        np.vstack([torque[above], -torque[below]]),
        np.concatenate(
            [
                (problem.torque_max - problem.external_torque)[above],
                (problem.external_torque - problem.torque_min)[below],
            ]
        ),
    )


def normal_rows(problem: GraspForceProblem, loaded: Mask, capped: Mask) -> Rows:
    """Preloads of the contacts in `loaded`, then caps of those in `capped`; N."""
    normal = np.eye(3 * problem.n_contacts)[2::3]
    return Rows(
        np.vstack([-normal[loaded], normal[capped]]),
        np.concatenate([-problem.normal_min[loaded], problem.normal_max[capped]]),
    )


JOINT_SCALE = 0.05
"""N·m; `force_limits` works in multiples of it."""


def force_limits(problem: GraspForceProblem, budget: float, size: int) -> Rows:
    """Torque limits, effort within `budget` (N), and preloads and caps where there are any.

    The forces are the first 3n of `size` unknowns. Torque limits must be finite.
    """
    count = 3 * problem.n_contacts
    every = np.ones(problem.n_joints, dtype=np.bool_)
    torque = torque_rows(problem, every, every)
    effort = np.zeros((1, count))
    effort[0, 2::3] = 1.0
    rows = Rows.of(
        Rows(torque.matrix / JOINT_SCALE, torque.bound / JOINT_SCALE),
        Rows(effort, np.array([budget])),
        normal_rows(problem, problem.normal_min > 0.0, np.isfinite(problem.normal_max)),
    )
    return Rows(np.pad(rows.matrix, ((0, 0), (0, size - count))), rows.bound)


class ConicProgram:
    """One problem in Clarabel's form: min 1/2 x'Px + q'x subject to b - Ax in K.

    x is the forces over their scale; for `min_max_normal` the bound on them follows. Rows are
    scaled to a size of about one: equilibrium by the moment arm, torques by the length of their row
    of J_h', and limits far beyond the scale of the forces by their own size, which would otherwise
    hide the rest from Clarabel's relative tolerances.

    In this order: equalities that a violation may soften (equilibrium, pinned torques) and those
    that it may not (pinned normal forces, no tangential force without friction); finite upper, then
    lower torque limits; preloads, then caps; one cone (mu f_n, f_t1, f_t2) for each contact with
    friction. The rows that keep normal forces below that bound stand after the caps.

    Args:
        problem: a single one of numpy arrays; a `ProblemError` says so of any other.
    """

    def __init__(self, problem: GraspForceProblem) -> None:
        as_problem(problem).plain_arrays(0)
        self._problem = problem
        self._scale = float(force_scale(problem))
        self._pinned = problem.torque_min == problem.torque_max
        self._upper = np.isfinite(problem.torque_max) & ~self._pinned
        self._lower = np.isfinite(problem.torque_min) & ~self._pinned
        fixed = problem.normal_min == problem.normal_max
        slippery = problem.friction == 0
        eye = np.eye(3 * problem.n_contacts)
        normal = eye[2::3]
        self._row_scale = np.repeat([1.0, 1.0 / float(moment_arm(problem))], 3)

        def scaled(*blocks: Rows) -> _Scaled:
            return _Scaled.of_scale(self._scale, *blocks)

        self._soft = scaled(
            Rows(
                self._row_scale[:, None] * problem.grasp_map,
                -self._row_scale * problem.external_wrench,
            ),
            torque_rows(problem, self._pinned, np.zeros_like(self._pinned)),
        )
        across = eye.reshape(-1, 3, eye.shape[1])[slippery, :2].reshape(-1, eye.shape[1])
        self._hard = scaled(
            Rows(normal[fixed], problem.normal_min[fixed]), Rows(across, np.zeros(len(across)))
        )
        self._torque = scaled(torque_rows(problem, self._upper, self._lower))
        capped = np.isfinite(problem.normal_max) & ~fixed
        # friction alone keeps a normal force from pulling, so that a zero preload needs no row
        loaded = ((problem.normal_min > 0) | slippery) & ~fixed
        self._normal = scaled(normal_rows(problem, loaded, capped))
        horizon = np.full(len(normal), FORCE_HORIZON * self._scale)
        self._horizon = scaled(Rows(normal, horizon))
        cones = cone_rows(problem.friction)[np.repeat(~slippery, 3)]
        self._cones = Rows(cones, np.zeros(len(cones)))
        self._below = Rows(normal, np.zeros(len(normal)))

    def data(self) -> tuple[Any, ...]:
        """The problem itself: P, q, A, b, K, as `solve` takes them."""
        size = self._soft.matrix.shape[1]
        objective = self._problem.objective
        quadratic, linear = np.zeros((size, size)), np.zeros(size)
        blocks: list[Rows] = [self._soft, self._hard, self._torque, self._normal]
        if objective == "min_norm":
            quadratic = np.eye(size)
        elif objective == "sum_normal":
            linear[2::3] = 1.0
        else:
            quadratic, linear = np.zeros((size + 1, size + 1)), np.append(linear, 1.0)
            blocks.append(self._below)
        blocks.append(self._cones)
        rows = Rows.of(*blocks)
        matrix = rows.matrix
        if len(linear) > size:
            gives = [np.full(len(block), -float(block is self._below)) for block in blocks]
            matrix = np.column_stack([matrix, np.concatenate(gives)])
        equalities = len(self._soft) + len(self._hard)
        return (
            quadratic,
            linear,
            matrix,
            rows.bound,
            [
                ZERO(equalities),
                POSITIVE(len(matrix) - equalities - len(self._cones)),
                *[SECOND_ORDER(3)] * (len(self._cones) // 3),
            ],
        )

    def least_violation_data(self) -> tuple[Any, ...]:
        """The least t by which equilibrium and torque limits must give way, in x and t.

        Normal forces end at `FORCE_HORIZON`, as in the judge's reading of its dual.
        """
        size = self._soft.matrix.shape[1]
        slack = Rows(np.zeros((1, size)), np.zeros(1))
        blocks = (
            slack,
            self._soft,
            self._hard,
            self._torque,
            self._normal,
            self._horizon,
            self._cones,
        )
        gives = np.concatenate(
            [
                np.full(len(block), -1.0 if block in (slack, self._torque) else 0.0)
                for block in blocks
            ]
        )
        rows = Rows.of(*blocks)
        inequalities = len(self._torque) + len(self._normal) + len(self._horizon)
        return (
            None,
            np.append(np.zeros(size), 1.0),
            np.column_stack([rows.matrix, gives]),
            rows.bound,
            [
                SECOND_ORDER(1 + len(self._soft)),
                ZERO(len(self._hard)),
                POSITIVE(inequalities),
                *[SECOND_ORDER(3)] * (len(self._cones) // 3),
            ],
        )

    def forces(self, x: np.ndarray) -> np.ndarray:
        """(3n,) N from Clarabel's variables."""
        return self._scale * x[: self._soft.matrix.shape[1]]

    def multipliers(self, dual: np.ndarray) -> Multipliers:
        """nu and lambda, in the problem's own units, from Clarabel's dual variables."""
        soft = dual[: len(self._soft)] * self._soft.weight
        start = len(self._soft) + len(self._hard)
        torque = dual[start : start + len(self._torque)] * self._torque.weight
        price = np.zeros(self._problem.n_joints)
        above = int(self._upper.sum())
        price[self._pinned] = soft[6:]
        price[self._upper] += torque[:above]
        price[self._lower] -= torque[above:]
        unit = self._scale if self._problem.objective == "min_norm" else 1.0
        return Multipliers(unit * self._row_scale * soft[:6], unit * price)

    def violation_multipliers(self, dual: np.ndarray) -> Multipliers:
        """The same from the dual variables of the least violation."""
        return self.multipliers(dual[1:])


@dataclass(frozen=True, eq=False)
class _Scaled(Rows):
    """Rows for x over a scale, of length one, shorter where the bound exceeds one."""

    weight: Array

    @classmethod
    def of_scale(cls, scale: float, *blocks: Rows) -> "_Scaled":
        """Blocks of rows that were written for forces in N."""
        rows = Rows.of(*blocks)
        length = np.linalg.norm(rows.matrix, axis=1)
        weight = 1.0 / np.where(length > 0, length, 1.0)
        weight /= np.maximum(1.0, np.abs(weight * rows.bound / scale))
        return cls(weight[:, None] * rows.matrix, weight * rows.bound / scale, weight)
