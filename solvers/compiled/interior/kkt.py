"""The linear systems of an interior-point step, through 3x3 blocks and a dual Schur complement.

For right sides (r, r_t) of the stationarity rows, h of the equalities and y of the cones, `solve`
finds dx, dt and the change dy of the rows' multipliers with

    P dx + A' dy + (terms of cones and normal forces) = r,      A_k dx = h_k,

where the terms of cones are W^-2 (their rows times dx) - y. Eliminating dx and dt contact by
contact leaves a positive definite system as wide as the rows: 6 and a row for every joint with
limits. The blocks' inverses are sums of positive terms, so that no digits cancel near the edge of a
cone.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from solvers.arrays import Array, Indices

from .cone import scaling_point
from .form import ALLOCATING, INLINE, OPTIONS, Form

_DEPENDENT = 1e-14
_SOFT = 1e-10
"""Pivots below the first, relative to their row, are taken for the second."""


class System(NamedTuple):
    """Buffers of the factors and of the solution; sizes as in `Form`."""

    point: Array  # (n, 14) scaling points of the cones
    weight: Array  # (rows,) z / s
    total: Array  # (n_tau + n + 1,) weights summed over the rows of one source
    share: Array  # (n_tau + n + 1,) of that, the rows that t bounds
    axes: Array  # (n, 4) inverse block times the axes (1, -u), (1, u) of the cone: along u, n
    across: Array  # (n,) inverse block across u
    block: Array  # (n, 6) inverse blocks: 11, 12, 22, 13, 23, 33
    lift: Array  # (n, 3) change of the forces with t
    loose: Array  # (n,) share of a level row's price that its contact does not take
    pivot: Array  # (1,) what is left of t
    schur: Array  # (6 + n_tau, 6 + n_tau) lower Cholesky factor, reciprocals on its diagonal
    height: Array  # (6 + n_tau,) work
    pull: Array  # (n, 3) work
    more: Array  # (n, 3) work
    sums: Array  # (n_tau + n + 1,) work
    levels: Array  # (n_tau + n + 1,) work
    leading: Indices  # (n_tau + n + 1,) row of the largest weight of each source, -1 for none


@njit(**ALLOCATING)
def new_system(n: int, n_tau: int) -> System:
    """Empty buffers for up to n contacts and n_tau joints."""
    rows, sources, width = 2 * n_tau + 3 * n, n_tau + n + 1, 6 + n_tau
    return System(
        np.zeros((n, 14)),
        np.zeros(rows),
        np.zeros(sources),
        np.zeros(sources),
        np.zeros((n, 4)),
        np.zeros(n),
        np.zeros((n, 6)),
        np.zeros((n, 3)),
        np.zeros(n),
        np.zeros(1),
        np.zeros((width, width)),
        np.zeros(width),
        np.zeros((n, 3)),
        np.zeros((n, 3)),
        np.zeros(sources),
        np.zeros(sources),
        np.zeros(sources, np.int64),
    )


@njit(**OPTIONS)
def factorise(
    form: Form, system: System, quadratic: float, s: Array, z: Array, sc: Array, zc: Array
) -> bool:
    """Scaling points, blocks and Cholesky factor at slacks s and prices z; False if not inside.

    Args:
        form: the problem.
        system: receives the result.
        quadratic: P.
        s: (rows,) slacks of the orthant.
        z: (rows,) their prices.
        sc: (n, 3) points in the cones.
        zc: (n, 3) their prices.
    """
    n, joints, rows = form.counts[0], form.counts[1], form.counts[2]
    for k in range(joints + n + 1):
        system.total[k] = system.share[k] = 0.0
        system.leading[k] = -1
    for j in range(rows):
        weight = z[j] / s[j]
        system.weight[j] = weight
        source = form.source[j]
        lead = system.leading[source]
        if lead < 0 or weight > system.weight[lead]:
            system.leading[source] = j
        system.total[source] += weight
        if form.level[j] != 0.0:
            system.share[source] += weight
    system.pivot[0] = system.share[joints + n]
    for i in range(n):
        if form.slides[i] and not scaling_point(sc[i], zc[i], system.point[i]):
            return False
        _invert_block(form, system, quadratic, i)
    return _factor_schur(form, system)


@njit(**INLINE)
def _invert_block(form: Form, system: System, quadratic: float, i: int) -> None:
    """The inverse of contact i's block, and what t lifts."""
    joints = form.counts[1]
    weight, share = system.total[joints + i], system.share[joints + i]
    block = system.block[i]
    block[:] = 0.0
    stiff = quadratic + weight
    below = 1.0  # block's determinant without the rows of t, over the determinant
    if form.slides[i]:
        point, axes = system.point[i], system.axes[i]
        u1, u2, root = point[7], point[8], point[9]
        mu = form.friction[i]
        gain = 1.0 / (point[0] * point[0])
        # W^-2 in the plane of the axis and u: `steep` along (1, -u), `flat` along (1, u)
        steep, flat = gain * root * root, gain / (root * root)
        across = 1.0 / (gain + quadratic)
        system.across[i] = across
        radial = 0.5 * (steep + flat) + quadratic
        if form.presses[i]:
            half = 0.5 * (steep + flat)
            edge = mu * mu * (gain * gain + half * quadratic)
            determinant = edge + (half + quadratic) * stiff
            below = (edge + (half + quadratic) * (stiff - share)) / determinant
            along = (mu * mu * half + stiff) / determinant
            mixed = 0.5 * mu * (steep - flat) / determinant
            block[3], block[4] = mixed * u1, mixed * u2
            block[5] = radial / determinant
            # the steep axis cancels in its own product, the flat one in its
            unit = np.sqrt(0.5) / determinant
            axes[0] = -unit * (flat * mu * mu + stiff)
            axes[1] = unit * mu * (flat + quadratic)
            axes[2] = unit * (steep * mu * mu + stiff)
            axes[3] = unit * mu * (steep + quadratic)
        else:
            along = 1.0 / radial
            axes[0], axes[1] = -np.sqrt(0.5) * along, 0.0
            axes[2], axes[3] = np.sqrt(0.5) * along, 0.0
        block[0] = along * u1 * u1 + across * u2 * u2
        block[1] = (along - across) * u1 * u2
        block[2] = along * u2 * u2 + across * u1 * u1
    elif form.presses[i]:
        block[5] = 1.0 / stiff
        below = (stiff - share) / stiff
    system.loose[i] = below
    system.pivot[0] += share * below
    system.lift[i, 0] = share * block[3]
    system.lift[i, 1] = share * block[4]
    system.lift[i, 2] = share * block[5]


@njit(**INLINE)
def _factor_schur(form: Form, system: System) -> bool:
    n, joints = form.counts[0], form.counts[1]
    width = 6 + joints
    schur, height = system.schur, system.height
    for a in range(width):
        for b in range(a + 1):
            schur[a, b] = 0.0
        height[a] = 0.0
    for j in range(joints):
        schur[6 + j, 6 + j] = 0.0 if form.pinned[j] else 1.0 / system.total[j]
    for i in range(n):
        block, lift = system.block[i], system.lift[i]
        for a in range(form.touched[i]):
            r0, r1, r2 = form.rows[i, a, 0], form.rows[i, a, 1], form.rows[i, a, 2]
            p0 = block[0] * r0 + block[1] * r1 + block[3] * r2
            p1 = block[1] * r0 + block[2] * r1 + block[4] * r2
            p2 = block[3] * r0 + block[4] * r1 + block[5] * r2
            row = form.row[i, a]
            height[row] += lift[0] * r0 + lift[1] * r1 + lift[2] * r2
            for b in range(a + 1):
                schur[row, form.row[i, b]] += (
                    p0 * form.rows[i, b, 0] + p1 * form.rows[i, b, 1] + p2 * form.rows[i, b, 2]
                )
    if system.pivot[0] > 0.0:
        for a in range(width):
            for b in range(a + 1):
                schur[a, b] += height[a] * height[b] / system.pivot[0]
    for a in range(width):
        whole = schur[a, a]
        for b in range(a):
            value = schur[a, b]
            for c in range(b):
                value -= schur[a, c] * schur[b, c]
            value *= schur[b, b]
            schur[a, b] = value
            schur[a, a] -= value * value
        if not schur[a, a] > _DEPENDENT * whole:
            # a dependent row: what it cannot balance soon proves that nothing can
            schur[a, a] = _SOFT * whole if whole > 0.0 else 1.0
        schur[a, a] = 1.0 / np.sqrt(schur[a, a])
    return bool(np.isfinite(schur[width - 1, width - 1]))


@njit(**OPTIONS)
def solve(
    form: Form,
    system: System,
    stationarity: Array,
    level: float,
    equal: Array,
    y: Array,
    yc: Array,
    dx: Array,
    dy: Array,
) -> float:
    """Fill dx (n, 3) and dy (6 + joints,); returns dt.

    Args:
        form: the problem.
        system: after `factorise`.
        stationarity: (n, 3) r.
        level: r_t.
        equal: (6 + joints,) h; of joints, only where they are pinned.
        y: (rows,) of the orthant.
        yc: (n, 3) of the cones, along the axes of `cone.on_axes`.
        dx: receives the change of the forces.
        dy: receives the change of the rows' multipliers.
    """
    n, joints, rows = form.counts[0], form.counts[1], form.counts[2]
    width = 6 + joints
    sums, levels, pull, schur = system.sums, system.levels, system.pull, system.schur
    for k in range(joints + n + 1):
        sums[k] = levels[k] = 0.0
    for j in range(rows):
        if form.level[j] != 0.0:
            levels[form.source[j]] += y[j]
        else:
            sums[form.source[j]] += form.sign[j] * y[j]
    # of prices of the level, t feels what their contacts leave; the rest would cancel
    level -= levels[joints + n]
    for i in range(n):
        level -= levels[joints + i] * system.loose[i]
    for k in range(width):
        dy[k] = 0.0
    for i in range(n):
        pull[i, 0], pull[i, 1] = stationarity[i, 0], stationarity[i, 1]
        pull[i, 2] = stationarity[i, 2] + sums[joints + i]
    _apply_blocks(form, system, dx)
    for i in range(n):
        if form.slides[i]:
            u1, u2, axes = system.point[i, 7], system.point[i, 8], system.axes[i]
            along = yc[i, 0] * axes[0] + yc[i, 1] * axes[2]
            across = yc[i, 2] * system.across[i]
            dx[i, 0] -= along * u1 - across * u2
            dx[i, 1] -= along * u2 + across * u1
            dx[i, 2] -= yc[i, 0] * axes[1] + yc[i, 1] * axes[3]
    dt = _lift(form, system, level, levels, dx)
    _times_rows(form, dx, dy)
    for k in range(6):
        dy[k] -= equal[k]
    for j in range(joints):
        dy[6 + j] -= equal[6 + j] if form.pinned[j] else sums[j] / system.total[j]
    for a in range(width):
        value = dy[a]
        for b in range(a):
            value -= schur[a, b] * dy[b]
        dy[a] = value * schur[a, a]
    for a in range(width - 1, -1, -1):
        value = dy[a]
        for b in range(a + 1, width):
            value -= schur[b, a] * dy[b]
        dy[a] = value * schur[a, a]
    more = system.more
    for i in range(n):
        pull[i, 0] = pull[i, 1] = pull[i, 2] = 0.0
        for a in range(form.touched[i]):
            price = dy[form.row[i, a]]
            for c in range(3):
                pull[i, c] -= form.rows[i, a, c] * price
    _apply_blocks(form, system, more)
    for k in range(joints + n):
        levels[k] = 0.0
    dt += _lift(form, system, 0.0, levels, more)
    for i in range(n):
        for c in range(3):
            dx[i, c] += more[i, c]
    return dt


@njit(**INLINE)
def _apply_blocks(form: Form, system: System, dx: Array) -> None:
    """dx from `system.pull`, with t fixed."""
    n = form.counts[0]
    for i in range(n):
        block, pull = system.block[i], system.pull[i]
        dx[i, 0] = block[0] * pull[0] + block[1] * pull[1] + block[3] * pull[2]
        dx[i, 1] = block[1] * pull[0] + block[2] * pull[1] + block[4] * pull[2]
        dx[i, 2] = block[3] * pull[0] + block[4] * pull[1] + block[5] * pull[2]


@njit(**INLINE)
def _lift(form: Form, system: System, level: float, levels: Array, dx: Array) -> float:
    """Free t, whose right side is `level`, and add the prices of the level; returns dt."""
    if not system.pivot[0] > 0.0:
        return 0.0
    n, joints = form.counts[0], form.counts[1]
    for i in range(n):
        if form.presses[i]:
            level += system.share[joints + i] * dx[i, 2]
    dt: float = level / system.pivot[0]
    for i in range(n):
        for c in range(3):
            dx[i, c] += system.lift[i, c] * dt
        if form.presses[i]:
            block, price = system.block[i], levels[joints + i]
            dx[i, 0] += block[3] * price
            dx[i, 1] += block[4] * price
            dx[i, 2] += block[5] * price
    return dt


@njit(**INLINE)
def _times_rows(form: Form, x: Array, product: Array) -> None:
    """product += A x, for all rows."""
    for i in range(form.counts[0]):
        x0, x1, x2 = x[i, 0], x[i, 1], x[i, 2]
        for a in range(form.touched[i]):
            product[form.row[i, a]] += (
                form.rows[i, a, 0] * x0 + form.rows[i, a, 1] * x1 + form.rows[i, a, 2] * x2
            )
