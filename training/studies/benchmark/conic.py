"""Grasp force problems as conic programs of one shape, the form that general solvers take.

minimise 1/2 x'x subject to b - Ax in K, x the forces over their scale. Rows, in this order:
equilibrium (zero cone), upper and lower torque limits, preloads, caps (nonnegative cone), and one
second-order cone (mu f_n, f_t1, f_t2) for each contact. Rows are scaled to length one, as in
`solvers.exact.clarabel_`; limits that a problem does not have are rows 0'x <= 1, which are always
present, so that problems with as many contacts share one sparsity pattern.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from solvers import GraspForceError, GraspForceProblem
from solvers.arrays import Array
from solvers.conic import cone_rows
from solvers.problem import Multipliers, force_scale, moment_arm

Index = NDArray[np.intp]

EQUALITIES = 6


class BenchmarkError(GraspForceError, ValueError):
    """What is to be measured makes no sense, or cannot be measured here."""


@dataclass(frozen=True, eq=False)
class ConicBatch:
    """Problems with as many contacts each, as conic programs.

    Args:
        index: (B,) which problems of the batch these are.
        contacts: (B, k) the places of their contacts among the padded ones.
        matrix: (B, m, 3k) A.
        bound: (B, m) b.
        weight: (B, m) what the rows were multiplied by.
        real: (B, m) False at the rows of limits that do not exist.
        scale: (B,) N, of the forces.
        n_joints: joint torques of each problem.
    """

    index: Index
    contacts: Index
    matrix: Array
    bound: Array
    weight: Array
    real: NDArray[np.bool_]
    scale: Array
    n_joints: int

    def __len__(self) -> int:
        return len(self.index)

    @property
    def n_contacts(self) -> int:
        """Contacts of each problem."""
        return int(self.contacts.shape[1])

    @property
    def n_variables(self) -> int:
        """Variables of each program."""
        return 3 * self.n_contacts

    @property
    def n_inequalities(self) -> int:
        """Rows of the nonnegative cone, those of limits that do not exist included."""
        return 2 * self.n_joints + 2 * self.n_contacts

    @property
    def n_rows(self) -> int:
        """Rows of A."""
        return int(self.matrix.shape[1])

    def pattern(self) -> NDArray[np.bool_]:
        """(m, 3k) the entries of A that can differ from zero in a problem with k contacts."""
        size = self.n_variables
        pattern = np.zeros((self.n_rows, size), dtype=np.bool_)
        pattern[: EQUALITIES + 2 * self.n_joints] = True
        start = EQUALITIES + 2 * self.n_joints
        normal = np.eye(size, dtype=np.bool_)[2::3]
        pattern[start : start + 2 * self.n_contacts] = np.vstack([normal, normal])
        pattern[-size:] = cone_rows(np.ones((1, self.n_contacts)))[0] != 0
        return pattern

    def rows_of(self, problem: int) -> NDArray[np.bool_]:
        """(m,) the rows of one of the problems that a general solver needs to be told."""
        return self.real[problem]

    def forces(self, x: Array) -> Array:
        """(B, k, 3) N from the variables (B, 3k)."""
        return (self.scale[:, None] * x).reshape(len(x), -1, 3)

    def multipliers(self, dual: Array) -> Multipliers:
        """nu and lambda in the problems' units from the dual variables (B, m) of the rows."""
        unit = self.scale[:, None] * self.weight * dual
        start, joints = EQUALITIES, self.n_joints
        upper = unit[:, start : start + joints]
        lower = unit[:, start + joints : start + 2 * joints]
        return Multipliers(unit[:, :EQUALITIES], upper - lower)


def conic_batches(problem: GraspForceProblem) -> list[ConicBatch]:
    """A batch of `min_norm` problems, numpy float64, sorted by their number of contacts.

    Raises:
        BenchmarkError: for another objective, or a contact without friction, whose cone has no
            inside.
    """
    if problem.objective != "min_norm":
        raise BenchmarkError(f"the peers are measured with min_norm, not {problem.objective}")
    if np.any(problem.friction[problem.contact_mask] <= 0):
        raise BenchmarkError("the peers are measured on problems with friction at every contact")
    counts = problem.contact_mask.sum(axis=-1)
    return [
        _conic(problem, np.flatnonzero(counts == count), int(count)) for count in np.unique(counts)
    ]


def scatter(
    problem: GraspForceProblem, parts: list[ConicBatch], answers: list[tuple[Array, Array]]
) -> tuple[Array, Multipliers]:
    """Forces (B, 3n) and multipliers of the whole batch from the (x, dual) of its parts."""
    batch, n = problem.friction.shape
    forces = np.zeros((batch, n, 3))
    nu = np.full((batch, EQUALITIES), np.nan)
    price = np.full((batch, problem.n_joints), np.nan)
    for part, (x, dual) in zip(parts, answers, strict=True):
        forces[part.index[:, None], part.contacts] = part.forces(x)
        multipliers = part.multipliers(dual)
        nu[part.index] = multipliers.equilibrium
        price[part.index] = multipliers.torque
    return forces.reshape(batch, 3 * n), Multipliers(nu, price)


def csc(matrix: Array, pattern: NDArray[np.bool_]) -> Any:
    """A sparse column matrix with the entries of a pattern, zeros among them kept."""
    columns, rows = np.nonzero(pattern.T)
    starts = np.concatenate([[0], np.cumsum(pattern.sum(axis=0))])
    return sparse.csc_matrix((matrix[rows, columns], rows, starts), shape=matrix.shape)


def _conic(problem: GraspForceProblem, index: Index, count: int) -> ConicBatch:
    part = problem[index]
    order = np.argsort(~part.contact_mask, axis=-1, kind="stable")[:, :count]
    columns = (3 * order[..., None] + np.arange(3)).reshape(len(index), 3 * count)
    grasp_map = np.take_along_axis(part.grasp_map, columns[:, None, :], axis=2)
    torque = np.take_along_axis(part.hand_jacobian, columns[..., None], axis=1).swapaxes(1, 2)
    friction, least, most = (
        np.take_along_axis(values, order, axis=1)
        for values in (part.friction, part.normal_min, part.normal_max)
    )
    normal = np.broadcast_to(np.eye(3 * count)[2::3], (len(index), count, 3 * count))
    matrix = np.concatenate([grasp_map, torque, -torque, -normal, normal], axis=1)
    bound = np.concatenate(
        [
            -part.external_wrench,
            part.torque_max - part.external_torque,
            part.external_torque - part.torque_min,
            -least,
            most,
        ],
        axis=1,
    )
    arm = np.repeat(1.0 / moment_arm(part)[:, None], 3, axis=1)
    weight = np.ones(bound.shape)
    weight[:, 3:EQUALITIES] = arm
    # friction alone keeps a normal force from pulling: a preload of zero is no limit
    real = np.isfinite(bound)
    preload = slice(EQUALITIES + 2 * problem.n_joints, EQUALITIES + 2 * problem.n_joints + count)
    real[:, preload] &= least > 0
    scale = force_scale(part)
    length = np.linalg.norm(weight[..., None] * matrix, axis=-1)
    weight /= np.where(length > 0, length, 1.0)
    bound = np.where(real, weight * bound / scale[:, None], 1.0)
    tall = np.maximum(1.0, np.abs(bound))
    weight = np.where(real, weight / tall, 0.0)
    cones = cone_rows(friction)
    return ConicBatch(
        index=index,
        contacts=order,
        matrix=np.concatenate([weight[..., None] * matrix, cones], axis=1),
        bound=np.concatenate([bound / tall, np.zeros((len(index), 3 * count))], axis=1),
        weight=np.concatenate([weight, np.ones((len(index), 3 * count))], axis=1),
        real=np.concatenate([real, np.ones((len(index), 3 * count), dtype=np.bool_)], axis=1),
        scale=scale,
        n_joints=problem.n_joints,
    )
