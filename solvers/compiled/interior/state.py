"""The state of the interior-point path: buffers, starting point, residuals of the embedding."""

from typing import NamedTuple

import numpy as np
from numba import njit

from solvers.arrays import Array

from .form import ALLOCATING, INLINE, OPTIONS, Form


class Measures(NamedTuple):
    """A point of the embedding in numbers."""

    primal: float
    dual: float
    gap: float
    level: float  # residual of t's stationarity
    last: float  # residual of the last row
    product: float  # mean complementarity
    value: float  # b'z


class Goal(NamedTuple):
    """The objective: P, c of the normal forces, c_t."""

    quadratic: float
    linear: float
    level: float


class Path(NamedTuple):
    """Buffers of the state, of the residuals and of the steps; sizes as in `Form`."""

    x: Array  # (n, 3)
    y: Array  # (6 + n_tau,) prices of equalities and, net, of the torques
    s: Array  # (rows,)
    z: Array  # (rows,)
    sc: Array  # (n, 3)
    zc: Array  # (n, 3)
    extra: Array  # t, tau, kappa
    best_x: Array
    best_y: Array
    first: Array  # (3n,) forces of an attempt before, N
    v: Array  # (n_tau + n + 1,) torques, normal forces, 0
    ax: Array  # (6 + n_tau,) A x
    rx: Array  # (n, 3) residuals
    re: Array  # (6 + n_tau,)
    rs: Array  # (rows,)
    rc: Array  # (n, 3)
    px: Array  # (n, 3) solution of the constant right side
    py: Array
    cz: Array  # (rows,) right sides of complementarity
    cc: Array  # (n, 3)
    hx: Array  # (n, 3) right sides
    he: Array
    hz: Array
    hc: Array
    dx: Array  # steps
    dy: Array
    ds: Array
    dz: Array
    dsc: Array
    dzc: Array


@njit(**ALLOCATING)
def new_path(n: int, n_tau: int) -> Path:
    """Empty buffers for up to n contacts and n_tau joints."""
    rows, width = 2 * n_tau + 3 * n, 6 + n_tau
    return Path(
        np.zeros((n, 3)),
        np.zeros(width),
        np.zeros(rows),
        np.zeros(rows),
        np.zeros((n, 3)),
        np.zeros((n, 3)),
        np.zeros(3),
        np.zeros((n, 3)),
        np.zeros(width),
        np.zeros(3 * n),
        np.zeros(n_tau + n + 1),
        np.zeros(width),
        np.zeros((n, 3)),
        np.zeros(width),
        np.zeros(rows),
        np.zeros((n, 3)),
        np.zeros((n, 3)),
        np.zeros(width),
        np.zeros(rows),
        np.zeros((n, 3)),
        np.zeros((n, 3)),
        np.zeros(width),
        np.zeros(rows),
        np.zeros((n, 3)),
        np.zeros((n, 3)),
        np.zeros(width),
        np.zeros(rows),
        np.zeros(rows),
        np.zeros((n, 3)),
        np.zeros((n, 3)),
    )


@njit(**INLINE)
def start(form: Form, path: Path) -> None:
    """Unit forces and prices: as far from every edge as the problem's scale suggests."""
    n, joints, rows = form.counts[0], form.counts[1], form.counts[2]
    path.y[:] = 0.0
    path.extra[0], path.extra[1], path.extra[2] = 2.0, 1.0, 1.0
    for i in range(n):
        path.x[i, 0] = path.x[i, 1] = 0.0
        path.x[i, 2] = 1.0 if form.presses[i] else 0.0
        for c in range(3):
            path.sc[i, c] = path.zc[i, c] = 0.0
        if form.slides[i]:
            path.sc[i, 0] = form.friction[i]
            path.zc[i, 0] = 1.0 / form.friction[i]
    for j in range(rows):
        size = max(1.0, abs(form.bound[j]))
        path.s[j] = size
        path.z[j] = 1.0 / size
        if form.source[j] < joints:
            path.y[6 + form.source[j]] += form.sign[j] * path.z[j]


@njit(**INLINE)
def rows_of(form: Form, x: Array, v: Array, equal: Array) -> None:
    """Fill v with torques and normal forces, and `equal` with A x."""
    n, joints = form.counts[0], form.counts[1]
    for k in range(6 + joints):
        equal[k] = 0.0
    for i in range(n):
        x0, x1, x2 = x[i, 0], x[i, 1], x[i, 2]
        for a in range(form.touched[i]):
            equal[form.row[i, a]] += (
                form.rows[i, a, 0] * x0 + form.rows[i, a, 1] * x1 + form.rows[i, a, 2] * x2
            )
        v[joints + i] = x2
    for j in range(joints):
        v[j] = equal[6 + j]
    v[joints + n] = 0.0


@njit(**INLINE)
def stationarity(
    form: Form,
    goal: Goal,
    x: Array,
    y: Array,
    z: Array,
    zc: Array,
    tau: float,
    out: Array,
    cones: bool,
) -> None:
    """Fill `out` (n, 3) with P x + A' y + normal rows' z + c tau, and the cones' part if asked."""
    n, joints, rows = form.counts[0], form.counts[1], form.counts[2]
    for i in range(n):
        for c in range(3):
            out[i, c] = goal.quadratic * x[i, c]
        out[i, 2] += goal.linear * tau
        for a in range(form.touched[i]):
            price = y[form.row[i, a]]
            for c in range(3):
                out[i, c] += form.rows[i, a, c] * price
    for j in range(rows):
        i = form.source[j] - joints
        if 0 <= i < n:
            out[i, 2] += form.sign[j] * z[j]
    for i in range(n):
        if cones and form.slides[i]:
            out[i, 0] -= zc[i, 1]
            out[i, 1] -= zc[i, 2]
            out[i, 2] -= form.friction[i] * zc[i, 0]
        if cones and not form.slides[i]:
            out[i, 0] = out[i, 1] = 0.0
        if cones and not form.presses[i]:
            out[i, 2] = 0.0


@njit(**OPTIONS)
def residuals(form: Form, path: Path, goal: Goal) -> Measures:
    """Fill the residuals of the embedding, and measure the point."""
    n, joints, rows = form.counts[0], form.counts[1], form.counts[2]
    t, tau, kappa = path.extra[0], path.extra[1], path.extra[2]
    stationarity(form, goal, path.x, path.y, path.z, path.zc, tau, path.rx, True)
    rows_of(form, path.x, path.v, path.re)
    primal = dual = energy = cost = value = product = 0.0
    for k in range(6 + joints):
        if k < 6 or form.pinned[k - 6]:
            path.re[k] -= form.equal[k] * tau
            primal = max(primal, abs(path.re[k]) / (1.0 + abs(form.equal[k])))
            value += form.equal[k] * path.y[k]
        else:
            path.re[k] = 0.0
    residual = goal.level * tau
    for j in range(rows):
        along = form.sign[j] * path.v[form.source[j]] + form.level[j] * t
        path.rs[j] = along + path.s[j] - form.bound[j] * tau
        primal = max(primal, abs(path.rs[j]) / (1.0 + abs(form.bound[j])))
        residual += form.level[j] * path.z[j]
        value += form.bound[j] * path.z[j]
        product += path.s[j] * path.z[j]
    count = rows + 1
    for i in range(n):
        cost += goal.linear * path.x[i, 2]
        for c in range(3):
            energy += path.x[i, c] * path.x[i, c] * goal.quadratic
            dual = max(dual, abs(path.rx[i, c]))
        if form.slides[i]:
            count += 1
            path.rc[i, 0] = path.sc[i, 0] - form.friction[i] * path.x[i, 2] - form.offset[i] * tau
            path.rc[i, 1] = path.sc[i, 1] - path.x[i, 0]
            path.rc[i, 2] = path.sc[i, 2] - path.x[i, 1]
            value += form.offset[i] * path.zc[i, 0]
            for c in range(3):
                primal = max(primal, abs(path.rc[i, c]))
                product += path.sc[i, c] * path.zc[i, c]
    cost += goal.level * t
    last = energy / tau + cost + value + kappa
    best = (0.5 * energy / tau + cost) / tau
    size = max(1e-3, abs(best))
    return Measures(
        primal / tau,
        max(dual, abs(residual)) / tau,
        abs(energy / tau + cost + value) / (tau * size),
        residual,
        last,
        (product + kappa * tau) / count,
        value,
    )
