"""One iteration of the interior point: predictor and corrector.

Equalities and stationarity are linear, and each step takes them exactly; rounding is left to the
complementarity, which forgives it.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from solvers.arrays import Array

from .cone import divide, longest_step, on_axes, scale_down, scale_up
from .form import INLINE, OPTIONS, Form
from .kkt import System, solve
from .state import Goal, Measures, Path, rows_of, stationarity

_BACK = 0.99
"""Share of the way to the edge of the cones that a step goes."""


class Constant(NamedTuple):
    """What tau multiplies: its step of t, and the factor of its own step."""

    t: float
    denominator: float


@njit(**OPTIONS)
def advance(
    form: Form, system: System, path: Path, goal: Goal, here: Measures, embedded: bool
) -> None:
    """One iteration: predictor, corrector, step."""
    n, joints, rows = form.counts[0], form.counts[1], form.counts[2]
    kappa, tau = path.extra[2], path.extra[1]
    dtau = dkappa = 0.0
    constant = Constant(0.0, 0.0)
    if embedded:
        constant = _constant(form, system, path, goal)
    _right_sides(form, system, path, 1.0, 0.0, False)
    if embedded:
        dt, dtau, dkappa = _step(form, system, path, goal, 1.0, kappa * tau, here, constant)
    else:
        dt = _plain_step(form, system, path, goal, 1.0, here, goal.quadratic == 0.0)
    left = 1.0 - _length(form, path, dtau, dkappa)
    centring = left * left * left
    target = centring * here.product
    rest = 1.0 - centring
    _right_sides(form, system, path, rest, target, True)
    if embedded:
        gap = kappa * tau + dkappa * dtau - target
        dt, dtau, dkappa = _step(form, system, path, goal, rest, gap, here, constant)
    else:
        dt = _plain_step(form, system, path, goal, rest, here, goal.quadratic == 0.0)
    length = _BACK * _length(form, path, dtau, dkappa)
    path.extra[0] += length * dt
    path.extra[1] += length * dtau
    path.extra[2] += length * dkappa
    for i in range(n):
        for c in range(3):
            path.x[i, c] += length * path.dx[i, c]
            path.sc[i, c] += length * path.dsc[i, c]
            path.zc[i, c] += length * path.dzc[i, c]
    for k in range(6 + joints):
        path.y[k] += length * path.dy[k]
    for j in range(rows):
        path.s[j] += length * path.ds[j]
        path.z[j] += length * path.dz[j]


@njit(**OPTIONS)
def _constant(form: Form, system: System, path: Path, goal: Goal) -> Constant:
    """Solve for the right side (-c, b), which tau multiplies."""
    n = form.counts[0]
    for j in range(form.counts[2]):
        path.hz[j] = system.weight[j] * form.bound[j]
    for i in range(n):
        path.hx[i, 0] = path.hx[i, 1] = 0.0
        path.hx[i, 2] = -goal.linear
        if form.slides[i]:
            a, b, c = scale_down(system.point[i], form.offset[i], 0.0, 0.0)
            path.hc[i, 0], path.hc[i, 1], path.hc[i, 2] = on_axes(system.point[i], a, b, c)
    dt = solve(form, system, path.hx, -goal.level, form.equal, path.hz, path.hc, path.px, path.py)
    value = _value_along(form, system, path, path.px, dt, path.py) + goal.level * dt
    tau = path.extra[1]
    for i in range(n):
        value += goal.linear * path.px[i, 2]
        for c in range(3):
            ratio = path.x[i, c] / tau
            value += goal.quadratic * ratio * (2.0 * path.px[i, c] - ratio)
    return Constant(dt, value - path.extra[2] / tau)


@njit(**OPTIONS)
def _value_along(form: Form, system: System, path: Path, x: Array, t: float, y: Array) -> float:
    """b' of the prices that belong to a solution of the linear system: W^-2 (rows x) - (hz, hc)."""
    value = 0.0
    rows_of(form, x, path.v, path.ax)
    for j in range(form.counts[2]):
        along = form.sign[j] * path.v[form.source[j]] + form.level[j] * t
        value += form.bound[j] * (system.weight[j] * along - path.hz[j])
    for i in range(form.counts[0]):
        if form.slides[i]:
            head = -form.friction[i] * x[i, 2]
            a, b, c = scale_down(system.point[i], head, -x[i, 0], -x[i, 1])
            a, b, c = scale_down(system.point[i], a, b, c)
            value += form.offset[i] * (a - np.sqrt(0.5) * (path.hc[i, 0] + path.hc[i, 1]))
    for k in range(6 + form.counts[1]):
        if k < 6 or form.pinned[k - 6]:
            value += form.equal[k] * y[k]
    return value


@njit(**OPTIONS)
def _right_sides(
    form: Form, system: System, path: Path, rest: float, target: float, corrected: bool
) -> None:
    """Fill hx, he, hz, hc of a step that keeps 1 - rest of the residuals; cz, cc without these."""
    for j in range(form.counts[2]):
        push = path.ds[j] * path.dz[j] - target if corrected else 0.0
        path.cz[j] = path.z[j] + push / path.s[j]
        path.hz[j] = path.cz[j] - rest * system.weight[j] * path.rs[j]
    for k in range(6 + form.counts[1]):
        path.he[k] = -rest * path.re[k]
    for i in range(form.counts[0]):
        for c in range(3):
            path.hx[i, c] = -rest * path.rx[i, c]
        if not form.slides[i]:
            continue
        point = system.point[i]
        for c in range(3):
            path.cc[i, c] = point[4 + c]
        if corrected:
            p0, p1, p2 = scale_down(point, path.dsc[i, 0], path.dsc[i, 1], path.dsc[i, 2])
            q0, q1, q2 = scale_up(point, path.dzc[i, 0], path.dzc[i, 1], path.dzc[i, 2])
            p0, p1, p2 = divide(
                point,
                p0 * q0 + p1 * q1 + p2 * q2 - target,
                p0 * q1 + q0 * p1,
                p0 * q2 + q0 * p2,
            )
            path.cc[i, 0] += p0
            path.cc[i, 1] += p1
            path.cc[i, 2] += p2
        a, b, d = scale_down(point, path.rc[i, 0], path.rc[i, 1], path.rc[i, 2])
        a, b, d = path.cc[i, 0] - rest * a, path.cc[i, 1] - rest * b, path.cc[i, 2] - rest * d
        path.hc[i, 0], path.hc[i, 1], path.hc[i, 2] = on_axes(point, a, b, d)


@njit(**OPTIONS)
def _step(
    form: Form,
    system: System,
    path: Path,
    goal: Goal,
    rest: float,
    gap: float,
    here: Measures,
    constant: Constant,
) -> tuple[float, float, float]:
    """Fill the steps for the right sides that are set; returns those of t, tau and kappa.

    `gap` is the right side of kappa tau.
    """
    tau, kappa = path.extra[1], path.extra[2]
    dt = solve(
        form, system, path.hx, -rest * here.level, path.he, path.hz, path.hc, path.dx, path.dy
    )
    value = _value_along(form, system, path, path.dx, dt, path.dy) + goal.level * dt
    for i in range(form.counts[0]):
        value += goal.linear * path.dx[i, 2]
        for c in range(3):
            value += 2.0 * goal.quadratic * path.x[i, c] / tau * path.dx[i, c]
    dtau = (-rest * here.last + gap / tau - value) / constant.denominator
    dt += dtau * constant.t
    for i in range(form.counts[0]):
        for c in range(3):
            path.dx[i, c] += dtau * path.px[i, c]
    for k in range(6 + form.counts[1]):
        path.dy[k] += dtau * path.py[k]
    _complete(form, system, path, goal, rest, here.level, dt, dtau)
    return dt, dtau, -(gap + kappa * dtau) / tau


@njit(**OPTIONS)
def _plain_step(
    form: Form,
    system: System,
    path: Path,
    goal: Goal,
    rest: float,
    here: Measures,
    refined: bool,
) -> float:
    """The same with tau fixed; if refined, what complementarity misses is solved for again."""
    dt = solve(
        form, system, path.hx, -rest * here.level, path.he, path.hz, path.hc, path.dx, path.dy
    )
    _complete(form, system, path, goal, rest, here.level, dt, 0.0)
    if not refined:
        return dt
    n, joints, rows = form.counts[0], form.counts[1], form.counts[2]
    for j in range(rows):
        whole = path.cz[j] + path.dz[j] + system.weight[j] * path.ds[j]
        path.hz[j] = whole
    for k in range(6 + joints):
        path.he[k] = -rest * path.re[k] - path.ax[k]
    for i in range(n):
        for c in range(3):
            path.hx[i, c] = 0.0
        if form.slides[i]:
            point = system.point[i]
            a, b, c2 = scale_down(point, path.dsc[i, 0], path.dsc[i, 1], path.dsc[i, 2])
            p, q, r = scale_up(point, path.dzc[i, 0], path.dzc[i, 1], path.dzc[i, 2])
            a, b, c2 = a + p + path.cc[i, 0], b + q + path.cc[i, 1], c2 + r + path.cc[i, 2]
            path.hc[i, 0], path.hc[i, 1], path.hc[i, 2] = on_axes(point, a, b, c2)
    more = solve(form, system, path.hx, 0.0, path.he, path.hz, path.hc, path.px, path.py)
    for i in range(n):
        for c in range(3):
            path.dx[i, c] += path.px[i, c]
    for k in range(6 + joints):
        path.dy[k] += path.py[k]
    _complete(form, system, path, goal, rest, here.level, dt + more, 0.0)
    return dt + more


@njit(**OPTIONS)
def _complete(
    form: Form,
    system: System,
    path: Path,
    goal: Goal,
    rest: float,
    left: float,
    dt: float,
    dtau: float,
) -> None:
    """Slacks and prices from dx, dy, dt and dtau: rows and stationarity exact.

    `left` is the residual of t's stationarity.
    """
    n, joints, rows = form.counts[0], form.counts[1], form.counts[2]
    rows_of(form, path.dx, path.v, path.ax)
    for j in range(rows):
        along = form.sign[j] * path.v[form.source[j]] + form.level[j] * dt
        path.ds[j] = form.bound[j] * dtau - along - rest * path.rs[j]
        path.dz[j] = -path.cz[j] - system.weight[j] * path.ds[j]
    # the price with the largest weight takes what stationarity leaves to it
    for j in range(joints):
        lead = system.leading[j]
        if lead >= 0:
            other = 0.0
            for k in range(max(lead - 1, 0), min(lead + 2, rows)):
                if k != lead and form.source[k] == j:
                    other += form.sign[k] * path.dz[k]
            path.dz[lead] = form.sign[lead] * (path.dy[6 + j] - other)
    lead, others = -1, 0.0
    for j in range(rows):
        if form.level[j] != 0.0:
            others += path.dz[j]
            if lead < 0 or system.weight[j] > system.weight[lead]:
                lead = j
    if lead >= 0:
        path.dz[lead] += goal.level * dtau + rest * left - others
    stationarity(form, goal, path.dx, path.dy, path.dz, path.dzc, dtau, path.hx, False)
    for i in range(n):
        for c in range(3):
            path.hx[i, c] += rest * path.rx[i, c]
        if form.slides[i]:
            head = form.friction[i] * path.dx[i, 2] + form.offset[i] * dtau
            path.dsc[i, 0] = head - rest * path.rc[i, 0]
            path.dsc[i, 1] = path.dx[i, 0] - rest * path.rc[i, 1]
            path.dsc[i, 2] = path.dx[i, 1] - rest * path.rc[i, 2]
            path.dzc[i, 1], path.dzc[i, 2] = path.hx[i, 0], path.hx[i, 1]
            if form.presses[i]:
                path.dzc[i, 0] = path.hx[i, 2] / form.friction[i]
            else:
                point = system.point[i]
                a, b, c2 = scale_down(point, path.dsc[i, 0], path.dsc[i, 1], path.dsc[i, 2])
                a, b, c2 = a + path.cc[i, 0], b + path.cc[i, 1], c2 + path.cc[i, 2]
                path.dzc[i, 0] = -scale_down(point, a, b, c2)[0]
        elif form.presses[i]:
            lead = system.leading[joints + i]
            path.dz[lead] -= form.sign[lead] * path.hx[i, 2]


@njit(**INLINE)
def _length(form: Form, path: Path, dtau: float, dkappa: float) -> float:
    """How far the step may go, at most 1."""
    length = 1.0
    if dtau < 0.0:
        length = min(length, -path.extra[1] / dtau)
    if dkappa < 0.0:
        length = min(length, -path.extra[2] / dkappa)
    for j in range(form.counts[2]):
        if path.ds[j] < 0.0:
            length = min(length, -path.s[j] / path.ds[j])
        if path.dz[j] < 0.0:
            length = min(length, -path.z[j] / path.dz[j])
    for i in range(form.counts[0]):
        if form.slides[i]:
            length = longest_step(path.sc[i], path.dsc[i], length)
            length = longest_step(path.zc[i], path.dzc[i], length)
    return length
