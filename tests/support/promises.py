"""What the status of an answer promises, and what of it an answer breaks, in exact arithmetic.

See `tests.support.rational`, and `solvers.judge` for the promises. The tolerances are written down
here once more, apart from the project's.
"""

from collections.abc import Iterator
from fractions import Fraction
from typing import Any

import numpy as np

from tests.support.exact_quality import quality_faults
from tests.support.rational import Exact, Prices, dot, rational, root, sizes

ROUNDING = 8 * Fraction(2) ** -52
"""Of the sizes of a sum's terms: what may be missed where a constraint is decided in float64."""

EVALUATION = 64 * Fraction(2) ** -52
"""Of the sizes of its terms: by how much a number that an answer states may be rounded."""

EQUILIBRIUM = Fraction(1, 10**12)
"""Of the forces' size: how far they may be from forces that meet an equation."""

LOAD_SHARE = Fraction(1, 10**6)
"""Of the forces that the data asks for: how far they may be at most, however large they are."""

GAP = Fraction(1, 10**6)
"""Of the objective: the largest gap of what is called optimal."""

NEGLIGIBLE = Fraction(1, 10**8)
"""Of the forces' size: an objective below it counts as zero, and has no gap relative to itself."""

FARKAS = Fraction(1, 10**9)
"""Of the sizes of its terms: the least value that is called a proof."""

NOTHING = Fraction(1, 10**290)
"""N, N·m: below it numbers of float64 lose their digits."""

MISTAKEN = 1 + Fraction(1, 10**6)
"""Factor on a tolerance: that it is kept is decided in float64, too."""


def broken_promises(problem: Any, answer: Any, index: Any = ()) -> list[str]:
    """What one answer states and does not keep; empty where it is right.

    Args:
        problem: a problem, single or batched, arrays of numpy.
        answer: its solution.
        index: of the batch dimensions.
    """
    one = problem if index == () else problem[index]
    status = str(answer.status[index])
    exact = Exact(one)
    nu, torque = (
        np.asarray(part[index], dtype=np.float64)
        for part in (answer.equilibrium_dual, answer.torque_dual)
    )
    # multipliers that are no numbers say as much as none, which are zero
    priced = bool(np.isfinite(nu).all() and np.isfinite(torque).all())
    prices = Prices(
        exact, *((nu, torque) if priced else (np.zeros_like(nu), np.zeros_like(torque)))
    )
    for_quality = exact.objective == "max_quality"
    if status in ("optimal", "feasible"):
        if not np.isfinite(np.asarray(answer.forces[index])).all():
            return [f"{status}, and the forces are not finite"]
        forces = exact.forces(answer.forces[index])
        broken = [*_missed(exact, forces)]
        if prices.farkas() > FARKAS * prices.size():
            broken.append("the multipliers prove infeasibility")
        if for_quality:
            verdict = answer.verdict
            ends = float(verdict.quality_lower[index]), float(verdict.quality_upper[index])
            broken += quality_faults(one, exact, forces, ends, float(answer.objective[index]))
            broken += [] if answer.gap[index] >= -1e-12 else ["the bound is above the objective"]
        else:
            broken += _overstated(exact, answer, index, prices)
        return [f"{status}: {what}" for what in broken]
    if status == "infeasible":
        beyond = for_quality and prices.bound() > exact.number(one, "effort_budget")
        return [] if beyond else [f"infeasible: {what}" for what in _unproven(prices)]
    return [] if str(answer.message[index]) else ["failed, and no message says why"]


def _missed(exact: Exact, forces: list[Fraction]) -> Iterator[str]:
    """The constraints that forces miss."""
    square = max(dot(forces, forces), exact.scale_squared)
    load = LOAD_SHARE**2 * exact.scale_squared
    allowed = MISTAKEN**2 * min(EQUILIBRIUM**2 * square, load)
    for i, contact in enumerate(exact.contacts):
        first, second, normal = forces[3 * i : 3 * i + 3]
        reach = contact.friction * (normal + ROUNDING * abs(normal)) + NOTHING
        if reach < 0 or (first**2 + second**2) * (1 - ROUNDING) ** 2 > reach**2:
            yield f"friction of contact {i}: {_excess(first, second, contact.friction * normal)}"
        over = max(contact.low - normal, normal - contact.high)
        if over > ROUNDING * abs(normal) + NOTHING:
            yield f"normal force of contact {i}: {float(over):.2e} N beyond its limits"
    lever = max(exact.levers_squared, default=Fraction(0))
    for j, (row, own, low, high) in enumerate(
        zip(exact.jacobian, exact.own, exact.torque_min, exact.torque_max, strict=True)
    ):
        total = dot(row, forces) + own
        over = max(total - high, low - total) - ROUNDING * (sizes(row, forces) + abs(own))
        # limits that coincide to within what an equation is allowed are one
        close = low > -np.inf and high < np.inf and (high - low) ** 2 <= allowed * lever
        equation = close and over**2 <= allowed * lever
        if over > NOTHING and not equation:
            yield f"torque of joint {j}: {float(over):.2e} N·m beyond its limits"
    missing, beyond = [], []
    for row, load_ in zip(exact.grasp_map, exact.wrench, strict=True):
        total = dot(row, forces) + load_
        known = ROUNDING * (sizes(row, forces) + abs(load_))
        missing.append(total)
        beyond.append((1 if total > 0 else -1) * max(abs(total) - known, Fraction(0)))
    change = exact.least_force_squared(missing)
    if exact.least_force_squared(beyond) > allowed or change > MISTAKEN**2 * load:
        share = float(root(change / square)[0])
        yield f"equilibrium: forces would have to change by {share:.2e} of their size"


def _excess(first: Fraction, second: Fraction, reach: Fraction) -> str:
    across = root(first**2 + second**2)[0]
    return f"{float(across - reach):.2e} N, {float((across - reach) / max(across, 1)):.1e} of it"


def _overstated(exact: Exact, answer: Any, index: Any, prices: Prices) -> Iterator[str]:
    """Numbers of an answer with forces that are not what forces and multipliers give."""
    forces = exact.forces(answer.forces[index])
    square = max(dot(forces, forces), exact.scale_squared)
    value, stated = exact.objective_of(forces), _number(answer.objective[index])
    size = dot(forces, forces) if exact.objective == "min_norm" else root(square)[1]
    if stated is None or abs(stated - value) > EVALUATION * size + NOTHING:
        yield f"objective {float(answer.objective[index])!r} stated, {float(value)!r} true"
        return
    bound = _number(answer.dual_bound[index])
    if bound is not None:
        proven = prices.bound()
        allowed = EVALUATION * (prices.size() + size)
        if bound > proven + allowed:
            over = float((bound - proven) / (abs(proven) + allowed))
            yield f"the bound is {over:.1e} of itself above what the multipliers prove"
    if str(answer.status[index]) == "optimal":
        least = NEGLIGIBLE * root(square)[1]
        least = least**2 / 2 if exact.objective == "min_norm" else least
        tolerance = MISTAKEN * GAP * max(abs(value), least)
        if bound is None or value - bound > tolerance + EVALUATION * size:
            yield f"a gap of {float((value - (bound or 0)) / (abs(value) or 1)):.1e}"


def _unproven(prices: Prices) -> Iterator[str]:
    value, size = prices.farkas(), prices.size()
    if value * MISTAKEN <= FARKAS * size:
        yield f"the Farkas value is {float(value / size) if size else 0.0:.2e} of its terms"


def _number(value: Any) -> Fraction | None:
    return rational(float(value)) if np.isfinite(value) else None
