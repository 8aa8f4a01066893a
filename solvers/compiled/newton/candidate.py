"""Forces at the end of a Newton step: linearised, balanced, and checked against the true limits."""

from typing import Any

from numba import njit

from ..lanes import KERNEL, holds, load, root, store, where
from .layout import Layout
from .system import combine, solve

_BALANCE, _ALLOWED = 1e-14, 1e-13
"""Equilibrium error, relative to the size of the forces: what is aimed at, and what will do."""

_EQUATION = 0.5e-12
"""Error of a torque that is given, relative to the size of the forces: half of what is allowed."""

_PASSES = 3
"""Corrections of that error."""


@njit(**KERNEL)
def primal_candidate(ws: Any, at: Layout, active: Any, k: int, zero: Any) -> Any:
    """Write the candidate f^ - D A' step, balanced; return a mask of what fits, and 1/2 |f|^2."""
    w = 3 * at.n
    for c in range(w):
        store(ws, at.candidate + c, load(ws, at.forces + c, zero))
    _retract(ws, at, at.push, zero)
    error, square = _imbalance(ws, at, active, k, zero)
    for _ in range(_PASSES):
        # the ridge and rounding leave some of the error
        if not holds(error > _BALANCE * _BALANCE * square):
            break
        solve(ws, at, at.error, k, zero)
        combine(ws, at, active, at.error, at.trial_prices, k, zero)
        _retract(ws, at, at.trial_prices, zero)
        error, square = _imbalance(ws, at, active, k, zero)
    good = _fits(ws, at, at.candidate, _EQUATION * root(square), zero)
    return good & (error <= _ALLOWED * _ALLOWED * square), 0.5 * square


@njit(**KERNEL)
def _retract(ws: Any, at: Layout, push: int, zero: Any) -> None:
    """Subtract D push from the candidate."""
    for i in range(at.n):
        p0 = load(ws, push + 3 * i, zero)
        p1 = load(ws, push + 3 * i + 1, zero)
        p2 = load(ws, push + 3 * i + 2, zero)
        d = at.curvature + 6 * i
        d11, d12, d22 = load(ws, d, zero), load(ws, d + 1, zero), load(ws, d + 2, zero)
        d13, d23, d33 = load(ws, d + 3, zero), load(ws, d + 4, zero), load(ws, d + 5, zero)
        c = at.candidate + 3 * i
        store(ws, c, load(ws, c, zero) - (d11 * p0 + d12 * p1 + d13 * p2))
        store(ws, c + 1, load(ws, c + 1, zero) - (d12 * p0 + d22 * p1 + d23 * p2))
        store(ws, c + 2, load(ws, c + 2, zero) - (d13 * p0 + d23 * p1 + d33 * p2))


@njit(**KERNEL)
def _imbalance(ws: Any, at: Layout, active: Any, k: int, zero: Any) -> Any:
    """Write the candidate's error in the active rows; squares of its equilibrium part, and of f."""
    w = 3 * at.n
    square, balance = zero, zero
    for c in range(w):
        f = load(ws, at.candidate + c, zero)
        square += f * f
    for r in range(k):
        row = at.rows + active[r] * w
        total = load(ws, at.load + r, zero) if r < 6 else -load(ws, at.limit + r - 6, zero)
        for c in range(w):
            total += load(ws, row + c, zero) * load(ws, at.candidate + c, zero)
        if r < 6:
            balance += total * total
        else:
            total = where(load(ws, at.play + r - 6, zero) > 0.5, total, zero)
        store(ws, at.error + r, total)
    return balance, square


@njit(**KERNEL)
def _fits(ws: Any, at: Layout, forces: int, equation: Any, zero: Any) -> Any:
    """Mask: the forces keep the true friction, preload, cap and torque limits exactly.

    Torque limits no farther apart than `equation` are one, and may be missed by as much.
    """
    good = zero <= 0.0
    for i in range(at.n):
        f0 = load(ws, forces + 3 * i, zero)
        f1 = load(ws, forces + 3 * i + 1, zero)
        f2 = load(ws, forces + 3 * i + 2, zero)
        mu = load(ws, at.friction + i, zero)
        good &= root(f0 * f0 + f1 * f1) <= mu * f2
        good &= (f2 >= load(ws, at.low + i, zero)) & (f2 <= load(ws, at.high + i, zero))
    for j in range(at.m):
        torque = zero
        row = at.rows + (6 + j) * 3 * at.n
        for c in range(3 * at.n):
            torque += load(ws, row + c, zero) * load(ws, forces + c, zero)
        low, high = load(ws, at.torque_low + j, zero), load(ws, at.torque_high + j, zero)
        allowed = where(high - low <= equation, equation, zero)
        good &= (torque >= low - allowed) & (torque <= high + allowed)
    return good
