"""Second-order cones of three dimensions: Jordan products, scaling points and step lengths.

Points are (head, two components of the tail). The scaling point of a pair (s, z) inside the cone is
kept as eta and a unit hyperbolic vector w; W = eta [w0, w1'; w1, I + w1 w1' / (1 + w0)] takes z and
W^-1 takes s to the same lambda (Nesterov and Todd; formulas as in Vandenberghe, "The CVXOPT linear
and quadratic cone program solvers", 2010).
"""

import numpy as np
from numba import njit

from solvers.arrays import Array

from .form import OPTIONS

_HALF_ROOT = float(np.sqrt(0.5))


@njit(**OPTIONS)
def depth(point: Array) -> float:
    """head^2 - |tail|^2, without cancellation; positive inside for a positive head."""
    size = np.sqrt(point[1] * point[1] + point[2] * point[2])
    value: float = (point[0] - size) * (point[0] + size)
    return value


@njit(**OPTIONS)
def scaling_point(s: Array, z: Array, point: Array) -> bool:
    """Fill `point`, and the reciprocals that its users need.

    eta, w0, w1 (two), lambda (three), u = w1 / |w1| (two), w0 + |w1|, 1 / eta, 1 / (1 + w0),
    1 / (lambda0^2 - |lambda1|^2), 1 / lambda0.

    Returns:
        False unless both are inside.
    """
    ds, dz = depth(s), depth(z)
    if not (ds > 0.0 and dz > 0.0 and s[0] > 0.0 and z[0] > 0.0):
        return False
    rs, rz = np.sqrt(ds), np.sqrt(dz)
    inner = (s[0] * z[0] + s[1] * z[1] + s[2] * z[2]) / (rs * rz)
    gamma = np.sqrt(0.5 * (1.0 + inner))
    eta = np.sqrt(rs / rz)
    w1 = 0.5 * (s[1] / rs - z[1] / rz) / gamma
    w2 = 0.5 * (s[2] / rs - z[2] / rz) / gamma
    w0 = np.sqrt(1.0 + w1 * w1 + w2 * w2)
    point[0], point[1], point[2], point[3] = eta, w0, w1, w2
    size = np.sqrt(w1 * w1 + w2 * w2)
    point[7], point[8] = (w1 / size, w2 / size) if size > 0.0 else (1.0, 0.0)
    point[9] = w0 + size
    half = 1.0 / (1.0 + w0)
    point[10], point[11] = 1.0 / eta, half
    along = w1 * z[1] + w2 * z[2]
    share = z[0] + along * half
    point[4] = eta * (w0 * z[0] + along)
    point[5] = eta * (z[1] + w1 * share)
    point[6] = eta * (z[2] + w2 * share)
    point[12], point[13] = 1.0 / depth(point[4:7]), 1.0 / point[4]
    return True


@njit(**OPTIONS)
def scale_up(point: Array, a: float, b: float, c: float) -> tuple[float, float, float]:
    """W (a, b, c)."""
    eta, w0, w1, w2 = point[0], point[1], point[2], point[3]
    along = w1 * b + w2 * c
    share = a + along * point[11]
    return eta * (w0 * a + along), eta * (b + w1 * share), eta * (c + w2 * share)


@njit(**OPTIONS)
def scale_down(point: Array, a: float, b: float, c: float) -> tuple[float, float, float]:
    """W^-1 (a, b, c)."""
    small, w0, w1, w2 = point[10], point[1], point[2], point[3]
    along = w1 * b + w2 * c
    share = along * point[11] - a
    return (w0 * a - along) * small, (b + w1 * share) * small, (c + w2 * share) * small


@njit(**OPTIONS)
def on_axes(point: Array, a: float, b: float, c: float) -> tuple[float, float, float]:
    """W^-1 (a, b, c) by its components along (1, -u), (1, u), both over sqrt(2), and across u.

    Near the edge of the cone they differ by orders of magnitude: only apart do all keep their
    digits.
    """
    small, u1, u2, root = point[10], point[7], point[8], point[9]
    along = u1 * b + u2 * c
    return (
        _HALF_ROOT * (a - along) * root * small,
        _HALF_ROOT * (a + along) / root * small,
        (u1 * c - u2 * b) * small,
    )


@njit(**OPTIONS)
def divide(point: Array, a: float, b: float, c: float) -> tuple[float, float, float]:
    """The solution u of lambda o u = (a, b, c)."""
    l0, l1, l2 = point[4], point[5], point[6]
    head = (l0 * a - l1 * b - l2 * c) * point[12]
    return head, (b - head * l1) * point[13], (c - head * l2) * point[13]


@njit(**OPTIONS)
def longest_step(point: Array, step: Array, most: float) -> float:
    """The largest length up to `most` for which point + length * step is in the cone."""
    a = step[0] * step[0] - step[1] * step[1] - step[2] * step[2]
    b = point[0] * step[0] - point[1] * step[1] - point[2] * step[2]
    c = depth(point)
    longest = most
    if point[0] + longest * step[0] < 0.0:
        longest = -point[0] / step[0]
    root = b * b - a * c
    if a > 0.0 and (b >= 0.0 or root < 0.0):
        return longest
    if a == 0.0 and b >= 0.0:
        return longest
    root = np.sqrt(max(root, 0.0))
    # the smallest positive root of a r^2 + 2 b r + c, written without cancellation
    denominator = root - b
    if denominator > 0.0:
        longest = min(longest, c / denominator)
    return longest
