"""The Newton system A D A' of the rows in play, its Cholesky factor, and what it is solved for."""

from typing import Any

from numba import njit

from ..lanes import KERNEL, larger, load, root, store, where
from .layout import Layout


@njit(**KERNEL)
def _weigh(ws: Any, at: Layout, row: int, out: int, zero: Any) -> None:
    """Write a row (3n) times the Jacobian to `out`."""
    for i in range(at.n):
        a0 = load(ws, row + 3 * i, zero)
        a1 = load(ws, row + 3 * i + 1, zero)
        a2 = load(ws, row + 3 * i + 2, zero)
        d = at.curvature + 6 * i
        d11, d12, d22 = load(ws, d, zero), load(ws, d + 1, zero), load(ws, d + 2, zero)
        d13, d23, d33 = load(ws, d + 3, zero), load(ws, d + 4, zero), load(ws, d + 5, zero)
        store(ws, out + 3 * i, a0 * d11 + a1 * d12 + a2 * d13)
        store(ws, out + 3 * i + 1, a0 * d12 + a1 * d22 + a2 * d23)
        store(ws, out + 3 * i + 2, a0 * d13 + a1 * d23 + a2 * d33)


@njit(**KERNEL)
def factorise(ws: Any, at: Layout, active: Any, k: int, ridge: Any, zero: Any) -> None:
    """Cholesky factor of A D A' + ridge over the active rows; its diagonal is kept inverse."""
    w = 3 * at.n
    h = 6 + at.m
    for r in range(k):
        _weigh(ws, at, at.rows + active[r] * w, at.weighted + r * w, zero)
    for r in range(k):
        for t in range(r + 1):
            total = zero
            row = at.rows + active[t] * w
            for c in range(w):
                total += load(ws, at.weighted + r * w + c, zero) * load(ws, row + c, zero)
            store(ws, at.hessian + r * h + t, total)
    for r in range(k):
        slot = at.hessian + r * h + r
        store(ws, slot, load(ws, slot, zero) + ridge)
    for r in range(6, k):
        # a joint that is in play in other lanes only
        plays = load(ws, at.play + r - 6, zero) > 0.5
        for t in range(r):
            slot = at.hessian + r * h + t
            store(ws, slot, where(plays, load(ws, slot, zero), zero))
        for t in range(r + 1, k):
            slot = at.hessian + t * h + r
            store(ws, slot, where(plays, load(ws, slot, zero), zero))
        slot = at.hessian + r * h + r
        store(ws, slot, where(plays, load(ws, slot, zero), zero + 1.0))
    for r in range(k):
        for t in range(r):
            total = load(ws, at.hessian + r * h + t, zero)
            for u in range(t):
                total -= load(ws, at.hessian + r * h + u, zero) * load(
                    ws, at.hessian + t * h + u, zero
                )
            store(ws, at.hessian + r * h + t, total * load(ws, at.hessian + t * h + t, zero))
        pivot = load(ws, at.hessian + r * h + r, zero)
        for t in range(r):
            a = load(ws, at.hessian + r * h + t, zero)
            pivot -= a * a
        store(ws, at.hessian + r * h + r, 1.0 / root(larger(pivot, 0.1 * ridge)))


@njit(**KERNEL)
def solve(ws: Any, at: Layout, slot: int, k: int, zero: Any) -> None:
    """Solve with the factor, in place."""
    h = 6 + at.m
    for r in range(k):
        total = load(ws, slot + r, zero)
        for t in range(r):
            total -= load(ws, at.hessian + r * h + t, zero) * load(ws, slot + t, zero)
        store(ws, slot + r, total * load(ws, at.hessian + r * h + r, zero))
    for r in range(k - 1, -1, -1):
        total = load(ws, slot + r, zero)
        for t in range(r + 1, k):
            total -= load(ws, at.hessian + t * h + r, zero) * load(ws, slot + t, zero)
        store(ws, slot + r, total * load(ws, at.hessian + r * h + r, zero))


@njit(**KERNEL)
def combine(ws: Any, at: Layout, active: Any, weights: int, out: int, k: int, zero: Any) -> None:
    """Write the active rows' combination (3n)."""
    w = 3 * at.n
    for c in range(w):
        total = zero
        for r in range(k):
            total += load(ws, weights + r, zero) * load(ws, at.rows + active[r] * w + c, zero)
        store(ws, out + c, total)
