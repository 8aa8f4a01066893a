"""One problem of the convex objectives as a cone program, and the way back."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from solvers.duality import FORCE_HORIZON
from solvers.problem import GraspForceProblem, Multipliers, force_scale, moment_arm

from .program import POSITIVE, SECOND_ORDER, ZERO


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
    """

    def __init__(self, problem: GraspForceProblem) -> None:
        self._problem = problem
        self._scale = float(force_scale(problem))
        room_above = problem.torque_max - problem.external_torque
        room_below = problem.external_torque - problem.torque_min

        self._pinned = problem.torque_min == problem.torque_max
        self._upper = np.isfinite(problem.torque_max) & ~self._pinned
        self._lower = np.isfinite(problem.torque_min) & ~self._pinned
        fixed = problem.normal_min == problem.normal_max
        slippery = problem.friction == 0
        eye = np.eye(3 * problem.n_contacts)
        normal = eye[2::3]
        torque = problem.hand_jacobian.T
        self._row_scale = np.repeat([1.0, 1.0 / float(moment_arm(problem))], 3)

        self._soft = _Rows.of(
            (
                self._row_scale[:, None] * problem.grasp_map,
                -self._row_scale * problem.external_wrench,
            ),
            (torque[self._pinned], room_above[self._pinned]),
        ).scaled(self._scale)
        self._hard = _Rows.of(
            (normal[fixed], problem.normal_min[fixed]),
            (eye.reshape(-1, 3, eye.shape[1])[slippery, :2].reshape(-1, eye.shape[1]), None),
        ).scaled(self._scale)
        self._torque = _Rows.of(
            (torque[self._upper], room_above[self._upper]),
            (-torque[self._lower], room_below[self._lower]),
        ).scaled(self._scale)
        capped = np.isfinite(problem.normal_max) & ~fixed
        # friction alone keeps a normal force from pulling, so that a zero preload needs no row
        loaded = ((problem.normal_min > 0) | slippery) & ~fixed
        self._normal = _Rows.of(
            (-normal[loaded], -problem.normal_min[loaded]),
            (normal[capped], problem.normal_max[capped]),
        ).scaled(self._scale)
        horizon = np.full(len(normal), FORCE_HORIZON * self._scale)
        self._horizon = _Rows.of((normal, horizon)).scaled(self._scale)
        cones = -eye.reshape(-1, 3, eye.shape[1])[~slippery][:, [2, 0, 1]]
        cones[:, 0] *= problem.friction[~slippery, None]
        self._cones = _Rows.of((cones.reshape(-1, eye.shape[1]), None))
        self._below = _Rows.of((normal, None))

    def data(self) -> tuple[Any, ...]:
        """The problem itself: P, q, A, b, K, as `solve` takes them."""
        size = self._soft.matrix.shape[1]
        objective = self._problem.objective
        quadratic, linear = np.zeros((size, size)), np.zeros(size)
        blocks = [self._soft, self._hard, self._torque, self._normal]
        if objective == "min_norm":
            quadratic = np.eye(size)
        elif objective == "sum_normal":
            linear[2::3] = 1.0
        else:
            quadratic, linear = np.zeros((size + 1, size + 1)), np.append(linear, 1.0)
            blocks.append(self._below)
        blocks.append(self._cones)
        matrix = np.vstack([block.matrix for block in blocks])
        if len(linear) > size:
            gives = [np.full(len(block), -float(block is self._below)) for block in blocks]
            matrix = np.column_stack([matrix, np.concatenate(gives)])
        equalities = len(self._soft) + len(self._hard)
        return (
            quadratic,
            linear,
            matrix,
            np.concatenate([block.bound for block in blocks]),
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
        slack = _Rows.of((np.zeros((1, size)), None))
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
        inequalities = len(self._torque) + len(self._normal) + len(self._horizon)
        return (
            None,
            np.append(np.zeros(size), 1.0),
            np.column_stack([np.vstack([block.matrix for block in blocks]), gives]),
            np.concatenate([block.bound for block in blocks]),
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
class _Rows:
    """Rows A x <= b (or =) with the weights that they were multiplied by."""

    matrix: np.ndarray
    bound: np.ndarray
    weight: np.ndarray

    @classmethod
    def of(cls, *blocks: tuple[np.ndarray, np.ndarray | None]) -> "_Rows":
        """Stacked blocks of rows and bounds; no bounds are zeros."""
        matrix = np.vstack([rows for rows, _ in blocks])
        bounds = [np.zeros(len(rows)) if bound is None else bound for rows, bound in blocks]
        return cls(matrix, np.concatenate(bounds), np.ones(len(matrix)))

    def scaled(self, scale: float) -> "_Rows":
        """For x over `scale`, with rows of length one, shorter where the bound exceeds one."""
        length = np.linalg.norm(self.matrix, axis=1)
        weight = 1.0 / np.where(length > 0, length, 1.0)
        weight /= np.maximum(1.0, np.abs(weight * self.bound / scale))
        return _Rows(weight[:, None] * self.matrix, weight * self.bound / scale, weight)

    def __len__(self) -> int:
        return len(self.bound)
