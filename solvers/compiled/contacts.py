"""The projection on friction cones cut at preload and cap, with its Jacobian, compiled."""

from typing import Any

from numba import njit

from .lanes import KERNEL, larger, load, root, smaller, store, where
from .layout import Layout

_TINY = 1e-100

_MARGIN, _HORIZON = 1e-8, 1e6
"""Of a proof: more than the judge asks for, and `certificates.FORCE_HORIZON` in scaled units."""


@njit(**KERNEL)
def project(ws: Any, at: Layout, prices: int, cone: int, zero: Any) -> Any:
    """Write forces f^ = Pi_C(-q) and the Jacobian; return the sum of 1/2 |f^|^2 + q' f^.

    The same closed form as `solvers.certificates.project_cones` and `projection_jacobian`.

    Args:
        ws: workspace.
        at: its layout.
        prices: slot of q.
        cone: slot of what C is: n coefficients of friction mu, n times 1 / (1 + mu^2), n preloads,
            n caps.
        zero: 0 of the number type.
    """
    value = zero
    for i in range(at.n):
        p0 = -load(ws, prices + 3 * i, zero)
        p1 = -load(ws, prices + 3 * i + 1, zero)
        p2 = -load(ws, prices + 3 * i + 2, zero)
        mu = load(ws, cone + i, zero)
        share = load(ws, cone + at.n + i, zero)
        low = load(ws, cone + 2 * at.n + i, zero)
        high = load(ws, cone + 3 * at.n + i, zero)
        tangential = root(p0 * p0 + p1 * p1)
        best = where(tangential <= mu * p2, p2, (p2 + mu * tangential) * share)
        normal = smaller(larger(best, low), high)
        room = mu * normal
        inside = tangential <= room
        inverse = 1.0 / where(tangential > _TINY, tangential, zero + 1.0)
        across = where(inside, zero + 1.0, room * inverse)
        free = normal == best
        gain = where(free & ~inside, share, zero)
        along = where(inside, zero + 1.0, gain * mu * mu)
        u0 = p0 * inverse
        u1 = p1 * inverse
        stretch = along - across
        coupling = gain * mu
        f0 = p0 * across
        f1 = p1 * across
        store(ws, at.forces + 3 * i, f0)
        store(ws, at.forces + 3 * i + 1, f1)
        store(ws, at.forces + 3 * i + 2, normal)
        store(ws, at.curvature + 6 * i, across + stretch * u0 * u0)
        store(ws, at.curvature + 6 * i + 1, stretch * u0 * u1)
        store(ws, at.curvature + 6 * i + 2, across + stretch * u1 * u1)
        store(ws, at.curvature + 6 * i + 3, coupling * u0)
        store(ws, at.curvature + 6 * i + 4, coupling * u1)
        store(ws, at.curvature + 6 * i + 5, where(inside & free, zero + 1.0, gain))
        value += f0 * (0.5 * f0 - p0) + f1 * (0.5 * f1 - p1) + normal * (0.5 * normal - p2)
    return value


@njit(**KERNEL)
def weigh(ws: Any, at: Layout, row: int, out: int, zero: Any) -> None:
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
def fits(ws: Any, at: Layout, forces: int, zero: Any) -> Any:
    """Mask: the forces keep the true friction, preload, cap and torque limits exactly."""
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
        good &= torque >= load(ws, at.torque_low + j, zero)
        good &= torque <= load(ws, at.torque_high + j, zero)
    return good


@njit(**KERNEL)
def proves_infeasible(
    ws: Any, at: Layout, prices: int, y: int, torque_price: int, zero: Any
) -> Any:
    """Mask: the multipliers in the slots, and the prices q that they make, prove infeasibility.

    `solvers.certificates.farkas_value` with the true limits.
    """
    value = zero
    total = zero
    for i in range(at.n):
        q0 = load(ws, prices + 3 * i, zero)
        q1 = load(ws, prices + 3 * i + 1, zero)
        q2 = load(ws, prices + 3 * i + 2, zero)
        slope = q2 - load(ws, at.friction + i, zero) * root(q0 * q0 + q1 * q1)
        cap = load(ws, at.high + i, zero)
        cap = where(cap < 1e300, cap, zero + _HORIZON)
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
