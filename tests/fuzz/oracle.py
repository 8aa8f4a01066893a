"""What Clarabel says of a problem at tolerances of 1e-10, called without any code of the project.

Unknowns are forces over a scale of their own, rows have length one, and limits that coincide are
equations. What Clarabel calls almost solved is not settled.
"""

from dataclasses import dataclass
from typing import Any, Literal

import clarabel
import numpy as np
from scipy import sparse

TOLERANCE = 1e-10


@dataclass(frozen=True)
class Truth:
    """What is known of a problem.

    Args:
        status: "optimal", "infeasible", or "unknown" where Clarabel settles nothing.
        objective: NaN unless optimal.
        accuracy: of the objective, absolute.
    """

    status: Literal["optimal", "infeasible", "unknown"]
    objective: float = np.nan
    accuracy: float = np.nan


class _Rows:
    """Rows of a cone program, of length one in the scaled unknowns: bound - matrix x in a cone."""

    def __init__(self, scale: float) -> None:
        self.scale = scale
        self.matrix: list[Any] = []
        self.bound: list[float] = []
        self.cones: list[Any] = []

    def add(self, rows: Any, bounds: Any, kind: Any) -> bool:
        """Add rows; False if one says that zero is what it is not."""
        kept = 0
        for row, bound in zip(np.atleast_2d(rows), np.atleast_1d(bounds), strict=True):
            largest = np.abs(row).max(initial=0.0)
            if largest == 0.0:
                if bound < 0.0 or (kind is clarabel.ZeroConeT and bound != 0.0):
                    return False
                continue
            length = largest * np.linalg.norm(row / largest)
            far = max(1.0, abs(bound / length / self.scale))
            self.matrix.append(row / length / far)
            self.bound.append(bound / length / self.scale / far)
            kept += 1
        if kept:
            self.cones.append(kind(kept))
        return True


def truth(problem: Any) -> Truth:
    """What Clarabel settles about a single problem of numpy arrays."""
    mask = np.asarray(problem.contact_mask)
    columns = np.repeat(mask, 3)
    grasp_map = problem.grasp_map[:, columns]
    jacobian = problem.hand_jacobian[columns]
    mu, low, high = (
        getattr(problem, name)[mask] for name in ("friction", "normal_min", "normal_max")
    )
    upper = problem.torque_max - problem.external_torque
    lower = problem.torque_min - problem.external_torque
    n = int(mask.sum())
    eye = np.eye(3 * n)
    normal = eye[2::3]
    scale = _scale(grasp_map, problem.external_wrench, low, jacobian, lower, upper)
    if not np.isfinite(scale):
        return Truth("unknown")
    rows = _Rows(scale)
    zero, positive = clarabel.ZeroConeT, clarabel.NonnegativeConeT
    pinned, fixed, slippery = lower == upper, low == high, mu == 0.0
    above, below = np.isfinite(upper) & ~pinned, np.isfinite(lower) & ~pinned
    torque = jacobian.T
    across = eye.reshape(n, 3, -1)[slippery, :2].reshape(-1, 3 * n)
    capped = ~fixed & np.isfinite(high)
    consistent = (
        rows.add(grasp_map, -problem.external_wrench, zero)
        and rows.add(torque[pinned], upper[pinned], zero)
        and rows.add(normal[fixed], low[fixed], zero)
        and rows.add(across, np.zeros(len(across)), zero)
        and rows.add(torque[above], upper[above], positive)
        and rows.add(-torque[below], -lower[below], positive)
        and rows.add(-normal[~fixed], -low[~fixed], positive)
        and rows.add(normal[capped], high[capped], positive)
    )
    if not consistent:
        return Truth("infeasible")
    matrix, bound = np.array(rows.matrix), np.array(rows.bound)
    cones = list(rows.cones)
    for i in np.flatnonzero(~slippery):
        widest = max(mu[i], 1.0)
        matrix = np.vstack([matrix, -mu[i] / widest * normal[i], -eye[3 * i : 3 * i + 2] / widest])
        bound = np.append(bound, np.zeros(3))
        cones.append(clarabel.SecondOrderConeT(3))
    return _solved(problem.objective, matrix, bound, cones, normal, scale)


def _scale(grasp_map: Any, wrench: Any, low: Any, jacobian: Any, lower: Any, upper: Any) -> float:
    """N: the size of the forces that the data asks for; 1 where it asks for none."""
    size = np.abs(grasp_map).max(axis=1)
    size[size == 0.0] = 1.0
    load = np.linalg.lstsq(grasp_map / size[:, None], wrench / size, rcond=None)[0]
    parts = [np.abs(load).max(initial=0.0), low.max(initial=0.0)]
    for column, least, most in zip(jacobian.T, lower, upper, strict=True):
        length = np.abs(column).max(initial=0.0)
        if length > 0.0 and max(least, -most) > 0.0:
            parts.append(max(least, -most) / length)
    return float(max(parts)) or 1.0


def _solved(
    objective: str, matrix: Any, bound: Any, cones: Any, normal: Any, scale: float
) -> Truth:
    size = matrix.shape[1]
    quadratic, cost = np.zeros((size, size)), np.zeros(size)
    if objective == "min_norm":
        quadratic = np.eye(size)
    elif objective == "sum_normal":
        cost = normal.sum(axis=0)
    else:
        quadratic, cost = np.zeros((size + 1, size + 1)), np.append(cost, 1.0)
        matrix = np.pad(matrix, ((0, 0), (0, 1)))
        level = np.column_stack([normal, -np.ones(len(normal))])
        matrix = np.vstack([matrix, level])
        bound = np.append(bound, np.zeros(len(normal)))
        cones = [*cones, clarabel.NonnegativeConeT(len(normal))]
    if not (np.isfinite(matrix).all() and np.isfinite(bound).all()):
        return Truth("unknown")
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    settings.time_limit = 10.0
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = TOLERANCE
    settings.tol_infeas_abs = settings.tol_infeas_rel = TOLERANCE
    answer = clarabel.DefaultSolver(
        sparse.triu(sparse.csc_matrix(quadratic), format="csc"),
        cost,
        sparse.csc_matrix(matrix),
        bound,
        cones,
        settings,
    ).solve()
    status, forces = str(answer.status), scale * np.array(answer.x)[: normal.shape[1]]
    if status == "PrimalInfeasible":
        return Truth("infeasible")
    if status != "Solved":
        return Truth("unknown")
    pressing = forces[2::3]
    value = {
        "min_norm": 0.5 * float(forces @ forces),
        "sum_normal": float(pressing.sum()),
        "min_max_normal": float(pressing.max()),
    }[objective]
    # what Clarabel may miss of a constraint, its price makes a part of the objective
    unit = scale * scale if objective == "min_norm" else scale
    accuracy = 10 * TOLERANCE * (1.0 + float(np.abs(answer.z).sum())) * unit
    return Truth("optimal", value, accuracy)
