"""From a problem's arrays to the workspace of a kernel: scaling, whitening, tightening."""

from typing import Any

from numba import njit

from ..arrays import ProblemArrays
from ..lanes import KERNEL, larger, load, root, size, smaller, store, where
from .layout import Layout

INWARDS = 1e-11
"""Share by which limits are moved inwards: rounding then never carries an answer across the true
ones, and the objective's price for it, about as large, is far below every tolerance."""

_SMALLEST_COLUMN = 1e-3
"""Joints that no contact moves keep a finite scale: this share of the largest column of J_h."""

_SMALLEST_PIVOT = 1e-14

_GIVEN = 1e-9
"""Torque limits closer together than this are one value, and an equation: relative to one, in units
of the force scale, and to the limits."""

_WIDER = 1e-6
"""By how much proofs widen the friction: prices that all but obey the wider cones obey the true."""

_HUGE = 1e300
"""Larger numbers are infinite."""


@njit(**KERNEL)
def gather(ws: Any, at: Layout, lane: int, width: int, problem: ProblemArrays) -> None:
    """Write one problem, less its padding, to one lane; empty contacts fill the lane up."""
    (
        grasp_map, hand_jacobian, friction, torque_min, torque_max, wrench, external_torque,
        normal_min, normal_max, contact_mask,
    ) = problem  # fmt: skip
    k = 0
    n = at.n
    for contact in range(friction.shape[0]):
        if not contact_mask[contact]:
            continue
        for axis in range(3):
            column = 3 * contact + axis
            for r in range(6):
                ws[(at.rows + r * 3 * n + 3 * k + axis) * width + lane] = grasp_map[r, column]
            for j in range(at.m):
                slot = at.rows + (6 + j) * 3 * n + 3 * k + axis
                ws[slot * width + lane] = hand_jacobian[column, j]
        ws[(at.friction + k) * width + lane] = friction[contact]
        ws[(at.low + k) * width + lane] = normal_min[contact]
        ws[(at.high + k) * width + lane] = normal_max[contact]
        k += 1
    for i in range(k, n):
        for r in range(6 + at.m):
            for axis in range(3):
                ws[(at.rows + r * 3 * n + 3 * i + axis) * width + lane] = 0.0
        ws[(at.friction + i) * width + lane] = 0.0
        ws[(at.low + i) * width + lane] = 0.0
        ws[(at.high + i) * width + lane] = 0.0
    for r in range(6):
        ws[(at.load + r) * width + lane] = wrench[r]
    for j in range(at.m):
        # the demand for force needs the external torque once more: it waits in `limit`
        ws[(at.limit + j) * width + lane] = external_torque[j]
        ws[(at.torque_low + j) * width + lane] = torque_min[j]
        ws[(at.torque_high + j) * width + lane] = torque_max[j]


@njit(**KERNEL)
def prepare(ws: Any, at: Layout, zero: Any) -> None:
    """Scale what `gather` wrote, in place: the canonical form, a Cholesky factor for its QR.

    Torque rows over the moment arm, G' = Q L' with rows Q' instead of G, forces over the force
    scale, columns of J_h over their length; then the limits moved inwards.
    """
    n, m, w = at.n, at.m, 3 * at.n
    top, bottom = zero, zero
    for c in range(3 * w):
        a, b = load(ws, at.rows + c, zero), load(ws, at.rows + 3 * w + c, zero)
        top += a * a
        bottom += b * b
    arm = root(bottom / where(top > 0.0, top, zero + 1.0))
    arm = where((arm > 0.0) & (top > 0.0), arm, zero + 1.0)
    store(ws, at.row_scale, arm)
    per_arm = 1.0 / arm
    for c in range(3 * w):
        store(ws, at.rows + 3 * w + c, load(ws, at.rows + 3 * w + c, zero) * per_arm)
    for r in range(3, 6):
        store(ws, at.load + r, load(ws, at.load + r, zero) * per_arm)
    _whiten(ws, at, zero)

    square = zero
    for r in range(6):
        square += load(ws, at.load + r, zero) * load(ws, at.load + r, zero)
    for i in range(n):
        square += load(ws, at.low + i, zero) * load(ws, at.low + i, zero)
    demand, largest = zero, zero
    for j in range(m):
        length = zero
        for c in range(w):
            a = load(ws, at.rows + (6 + j) * w + c, zero)
            length += a * a
        length = root(length)
        store(ws, at.column + j, length)
        largest = larger(largest, length)
        own = load(ws, at.limit + j, zero)
        high, low = load(ws, at.torque_high + j, zero), load(ws, at.torque_low + j, zero)
        excess = larger(own - high, low - own)
        needs = (excess > 0.0) & (length > 0.0)
        demand = larger(demand, where(needs, excess / where(needs, length, zero + 1.0), zero))
    square += demand * demand
    scale = where(square > 0.0, root(square), zero + 1.0)
    store(ws, at.scale, scale)
    per_scale = 1.0 / scale
    for r in range(6):
        store(ws, at.load + r, load(ws, at.load + r, zero) * per_scale)
    for i in range(n):
        _tighten_contact(ws, at, i, per_scale, zero)
    for j in range(m):
        length = larger(load(ws, at.column + j, zero), _SMALLEST_COLUMN * largest)
        length = where(length > 0.0, length, zero + 1.0)
        store(ws, at.column + j, length)
        inverse = 1.0 / length
        for c in range(w):
            slot = at.rows + (6 + j) * w + c
            store(ws, slot, load(ws, slot, zero) * inverse)
        _tighten_joint(ws, at, j, inverse * per_scale, zero)


@njit(**KERNEL)
def _whiten(ws: Any, at: Layout, zero: Any) -> None:
    """Rows of G, and w, times the inverse factor of G G'; the diagonal is kept inverse."""
    w = 3 * at.n
    for r in range(6):
        for t in range(r + 1):
            total = zero
            for c in range(w):
                total += load(ws, at.rows + r * w + c, zero) * load(ws, at.rows + t * w + c, zero)
            store(ws, at.factor + 6 * r + t, total)
    for r in range(6):
        for t in range(r):
            total = load(ws, at.factor + 6 * r + t, zero)
            for u in range(t):
                total -= load(ws, at.factor + 6 * r + u, zero) * load(
                    ws, at.factor + 6 * t + u, zero
                )
            total = total * load(ws, at.factor + 7 * t, zero)
            store(ws, at.factor + 6 * r + t, total)
        whole = load(ws, at.factor + 7 * r, zero)
        pivot = whole
        for t in range(r):
            a = load(ws, at.factor + 6 * r + t, zero)
            pivot -= a * a
        pivot = larger(pivot, _SMALLEST_PIVOT * whole)
        inverse = 1.0 / root(where(pivot > 0.0, pivot, zero + 1.0))
        store(ws, at.factor + 7 * r, inverse)
    for r in range(6):
        inverse = load(ws, at.factor + 7 * r, zero)
        for t in range(r):
            a = load(ws, at.factor + 6 * r + t, zero)
            for c in range(w):
                slot = at.rows + r * w + c
                store(ws, slot, load(ws, slot, zero) - a * load(ws, at.rows + t * w + c, zero))
            store(
                ws,
                at.load + r,
                load(ws, at.load + r, zero) - a * load(ws, at.load + t, zero),
            )
        for c in range(w):
            slot = at.rows + r * w + c
            store(ws, slot, load(ws, slot, zero) * inverse)
        store(ws, at.load + r, load(ws, at.load + r, zero) * inverse)


@njit(**KERNEL)
def _tighten_contact(ws: Any, at: Layout, i: int, per_scale: Any, zero: Any) -> None:
    n = at.n
    mu = load(ws, at.friction + i, zero)
    inner = mu * (1.0 - INWARDS)
    store(ws, at.inner_cone + i, inner)
    store(ws, at.inner_cone + n + i, 1.0 / (1.0 + inner * inner))
    wide = mu * (1.0 + _WIDER) + _WIDER
    store(ws, at.wide_cone + i, wide)
    store(ws, at.wide_cone + n + i, 1.0 / (1.0 + wide * wide))
    low = load(ws, at.low + i, zero) * per_scale
    high = load(ws, at.high + i, zero) * per_scale
    store(ws, at.low + i, low)
    store(ws, at.high + i, high)
    inner_low, inner_high = low * (1.0 + INWARDS), high * (1.0 - INWARDS)
    room = inner_low <= inner_high
    # a normal force that is all but given has no inside
    middle = 0.5 * (low + where(high < _HUGE, high, low))
    store(ws, at.inner_cone + 2 * n + i, where(room, inner_low, middle))
    store(ws, at.inner_cone + 3 * n + i, where(room, inner_high, middle))
    store(ws, at.wide_cone + 2 * n + i, zero)
    store(ws, at.wide_cone + 3 * n + i, zero + _HUGE)


@njit(**KERNEL)
def _tighten_joint(ws: Any, at: Layout, j: int, per_unit: Any, zero: Any) -> None:
    own = load(ws, at.limit + j, zero)
    low = (load(ws, at.torque_low + j, zero) - own) * per_unit
    high = (load(ws, at.torque_high + j, zero) - own) * per_unit
    store(ws, at.torque_low + j, low)
    store(ws, at.torque_high + j, high)
    width = high - low
    reach = 1.0 + smaller(smaller(size(low), size(high)), zero + 1e9)
    shift = smaller(INWARDS * reach, where(width < _HUGE, 0.25 * width, zero + _HUGE))
    given = width <= _GIVEN * reach
    middle = low + 0.5 * where(given, width, zero)
    store(ws, at.inner_torque_low + j, where(given, middle, low + shift))
    store(ws, at.inner_torque_high + j, where(given, middle, high - shift))
    store(ws, at.equation + j, where(given, zero + 1.0, zero))
