"""Proofs of infeasibility: the test of multipliers, and how they are bent to pass it."""

from typing import Any

from numba import njit

from ..constants import FORCE_HORIZON
from ..lanes import KERNEL, holds, load, root, store, where
from .layout import Layout
from .projection import project
from .system import factorise, solve

_MARGIN = 1e-8
"""Of a proof: more than the judge asks for."""

_BENDS, _RIDGE = 6, 1e-6
"""Gauss-Newton steps that bend multipliers, and what is added to their Hessian."""


@njit(**KERNEL)
def proves_infeasible(
    ws: Any, at: Layout, prices: int, y: int, torque_price: int, zero: Any
) -> Any:
    """Mask: the multipliers in the slots, and the prices q that they make, prove infeasibility.

    `solvers.duality.farkas_value` with the true limits.
    """
    value = zero
    total = zero
    for i in range(at.n):
        q0 = load(ws, prices + 3 * i, zero)
        q1 = load(ws, prices + 3 * i + 1, zero)
        q2 = load(ws, prices + 3 * i + 2, zero)
        slope = q2 - load(ws, at.friction + i, zero) * root(q0 * q0 + q1 * q1)
        cap = load(ws, at.high + i, zero)
        cap = where(cap < 1e300, cap, zero + FORCE_HORIZON)
        term = slope * where(slope < 0.0, cap, load(ws, at.low + i, zero))
        value += term
        total += where(term < 0.0, -term, term)
    for r in range(6):
        term = load(ws, y + r, zero) * load(ws, at.load + r, zero)
        value += term
        total += where(term < 0.0, -term, term)
    for j in range(at.m):
        price = load(ws, torque_price + j, zero)
        over = where(price > 0.0, -price * load(ws, at.torque_high + j, zero), zero)
        term = where(price < 0.0, -price * load(ws, at.torque_low + j, zero), over)
        value += term
        total += where(term < 0.0, -term, term)
    return value > _MARGIN * total


@njit(**KERNEL)
def recession_direction(ws: Any, at: Layout, active: Any, wanted: Any, zero: Any) -> Any:
    """Bend multipliers to the nearest whose prices lie in the dual cones; the wanted that prove.

    `solvers.duality.recession_direction`, compiled: Gauss-Newton steps on 1/2 |Pi_C0(-q)|^2, C0 the
    cones without preload and cap. Writes y to `error` and the torque prices to `trial_price`;
    overwrites forces, curvature and Hessian.
    """
    w = 3 * at.n
    for r in range(6):
        store(ws, at.error + r, load(ws, at.y + r, zero))
    k = 6
    for j in range(at.m):
        price = load(ws, at.price + j, zero)
        store(ws, at.trial_price + j, price)
        priced = (price > 0.0) | (price < 0.0) | (load(ws, at.equation + j, zero) > 0.5)
        if holds(priced):
            active[k] = 6 + j
            store(ws, at.play + k - 6, where(priced, zero + 1.0, zero))
            k += 1
    for c in range(w):
        store(ws, at.trial_prices + c, load(ws, at.prices + c, zero))
    proven = zero > 1.0
    for number in range(_BENDS):
        project(ws, at, at.trial_prices, at.wide_cone, zero)
        for r in range(k):
            total = zero
            row = at.rows + active[r] * w
            for c in range(w):
                total += load(ws, row + c, zero) * load(ws, at.forces + c, zero)
            if r >= 6:
                total = where(load(ws, at.play + r - 6, zero) > 0.5, total, zero)
            store(ws, at.step + r, total)
        factorise(ws, at, active, k, zero + _RIDGE, zero)
        solve(ws, at, at.step, k, zero)
        for r in range(6):
            store(ws, at.error + r, load(ws, at.error + r, zero) + load(ws, at.step + r, zero))
        for r in range(6, k):
            j = active[r] - 6
            before = load(ws, at.trial_price + j, zero)
            after = before + load(ws, at.step + r, zero)
            stays = (before * after > 0.0) | (load(ws, at.equation + j, zero) > 0.5)
            store(ws, at.trial_price + j, where(stays, after, zero))
            play = load(ws, at.play + r - 6, zero)
            store(ws, at.play + r - 6, where(stays, play, zero))
        for c in range(w):
            q = zero
            for r in range(6):
                q += load(ws, at.rows + r * w + c, zero) * load(ws, at.error + r, zero)
            for r in range(6, k):
                price = load(ws, at.trial_price + active[r] - 6, zero)
                q += load(ws, at.rows + active[r] * w + c, zero) * price
            store(ws, at.trial_prices + c, q)
        if number % 2:
            proven = wanted & proves_infeasible(
                ws, at, at.trial_prices, at.error, at.trial_price, zero
            )
            if not holds(wanted & ~proven):
                break
    return proven
