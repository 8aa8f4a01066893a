"""The projection on friction cones cut at preload and cap, with its Jacobian, compiled."""

from typing import Any

from numba import njit

from ..lanes import KERNEL, larger, load, root, smaller, store, where
from .layout import Layout

_TINY = 1e-100


@njit(**KERNEL)
def project(ws: Any, at: Layout, prices: int, cone: int, zero: Any) -> Any:
    """Write forces f^ = Pi_C(-q) and the Jacobian; return the sum of 1/2 |f^|^2 + q' f^.

    The same closed form as `solvers.duality.project_cones` and `projection_jacobian`.

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
