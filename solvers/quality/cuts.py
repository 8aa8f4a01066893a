"""How hard contacts can press together: the convex set of normal forces, asked along rays.

A ray of shares s >= 0 leaves that set at the largest t for which forces have normal components of
at least t s and keep every constraint of the problem, the budget of effort too. The multipliers of
that second-order cone program prove a cut: prices'a <= end for all possible normal forces a.
"""

from dataclasses import dataclass

import numpy as np

from solvers.arrays import Array
from solvers.conic import (
    POSITIVE,
    SECOND_ORDER,
    ZERO,
    Rows,
    cone_rows,
    normal_rows,
    solve,
    torque_rows,
)
from solvers.problem import GraspForceProblem


@dataclass(frozen=True, eq=False)
class CutMultipliers:
    """What proves a cut prices'a <= end on the normal forces a of feasible forces.

    Args:
        prices: (n,) >= 0.
        equilibrium: (6,) nu.
        torque: (n_tau,) lambda; positive parts price the upper limits, negative parts the lower.
        effort: price of the budget, >= 0.
    """

    prices: Array
    equilibrium: Array
    torque: Array
    effort: float

    def end(self, problem: GraspForceProblem) -> float:
        """The right side of the cut, N, by weak duality, for any multipliers whatsoever.

        prices'a over all forces that satisfy the constraints is at most its Lagrangian's largest
        value, which separates over the contacts and has a closed form in each.

        Args:
            problem: one float64 numpy problem, `max_quality`.
        """
        push = problem.hand_jacobian @ self.torque + problem.grasp_map.T @ self.equilibrium
        push = push.reshape(-1, 3)
        slope = self.prices - self.effort - push[:, 2]
        slope = slope + problem.friction * np.hypot(push[:, 0], push[:, 1])
        most = np.minimum(problem.normal_max, problem.effort_budget)
        end = np.sum(np.where(slope > 0.0, slope * most, slope * problem.normal_min))
        end += self.effort * problem.effort_budget - self.equilibrium @ problem.external_wrench
        above, below = self.torque > 0.0, self.torque < 0.0
        room = problem.torque_max - problem.external_torque
        end += self.torque[above] @ room[above]
        room = problem.torque_min - problem.external_torque
        end += self.torque[below] @ room[below]
        return float(end) if np.isfinite(end) else np.inf


@dataclass(frozen=True, eq=False)
class Ray:
    """Where a ray leaves the set of normal forces.

    Args:
        length: t, N.
        forces: (3n,) N, with normal components of at least t times the shares.
        cut: the proof, whose prices'shares is 1.
        end: N, of the cut: at least t.
    """

    length: float
    forces: Array
    cut: CutMultipliers
    end: float


class NormalForces:
    """The normal forces that a problem allows.

    Args:
        problem: one float64 numpy problem without padding, `max_quality`.
    """

    def __init__(self, problem: GraspForceProblem) -> None:
        self.problem = problem
        n, budget = problem.n_contacts, float(problem.effort_budget)
        self._unit = budget
        length = float(problem.characteristic_length)
        self._rows = np.repeat([1.0, 1.0 / length], 3)
        normal = np.eye(3 * n)[2::3]
        above, below = np.isfinite(problem.torque_max), np.isfinite(problem.torque_min)
        torque = torque_rows(problem, above, below)
        limits = normal_rows(problem, np.ones(n, np.bool_), np.isfinite(problem.normal_max))
        rows = Rows.of(
            Rows(
                self._rows[:, None] * problem.grasp_map,
                -self._rows * problem.external_wrench / budget,
            ),
            Rows(-normal, np.zeros(n)),
            Rows(normal.sum(axis=0)[None], np.ones(1)),
            Rows(torque.matrix / length, torque.bound / (length * budget)),
            Rows(limits.matrix, limits.bound / budget),
            Rows(cone_rows(problem.friction), np.zeros(3 * n)),
        )
        self._above, self._below = np.flatnonzero(above), np.flatnonzero(below)
        self._matrix = np.column_stack([rows.matrix, np.zeros(len(rows))])
        self._ends = rows.bound
        self._cones = [ZERO(6), POSITIVE(len(rows) - 6 - 3 * n), *[SECOND_ORDER(3)] * n]
        self._cost = np.append(np.zeros(3 * n), -1.0)

    def ray(self, shares: Array) -> Ray | None:
        """The end of a ray of shares (n,) >= 0, some of them positive; None where there is none."""
        n = len(shares)
        largest = float(shares.max())
        matrix = self._matrix.copy()
        matrix[6 : 6 + n, -1] = shares / largest
        outcome = solve(None, self._cost, matrix, self._ends, self._cones)
        if not outcome.solved:
            return None
        x, z = outcome.x, outcome.dual
        if not (np.isfinite(x).all() and np.isfinite(z).all()):
            return None
        prices = np.maximum(z[6 : 6 + n], 0.0)
        total = float(prices @ shares)
        if total <= 0.0:
            return None
        torque = np.zeros(self.problem.n_joints)
        start = 7 + n
        middle = start + len(self._above)
        length = float(self.problem.characteristic_length)
        torque[self._above] += z[start:middle] / length
        torque[self._below] -= z[middle : middle + len(self._below)] / length
        cut = CutMultipliers(
            prices / total,
            self._rows * z[:6] / total,
            torque / total,
            max(float(z[6 + n]), 0.0) / total,
        )
        return Ray(
            length=self._unit * float(x[-1]) / largest,
            forces=self._unit * x[:-1],
            cut=cut,
            end=cut.end(self.problem),
        )
