"""What the judge measures, compiled: residuals, dual bound and proof of a batch of answers.

Written apart from the solvers, after the definitions in `solvers.problem.residuals`,
`solvers.duality.bounds` and `solvers.problem.scaling`, with which the tests compare it. Rounding is
allowed for nowhere but where a constraint is decided: a sum of products is known to `ROUNDING`
times the sum of their sizes.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from ..arrays import ProblemArrays, one_of
from ..cache import digest
from ..constants import MIN_MAX_NORMAL, MIN_NORM, SUM_NORMAL

ROUNDING = 8 * 2.220446049250313e-16
"""Relative error allowed to the evaluation of a constraint, times the sizes of its terms."""

COLUMNS = (
    "equilibrium_residual", "friction_violation", "normal_violation", "torque_violation",
    "objective", "dual_bound", "farkas_value", "size", "imbalance", "excess", "gap",
)  # fmt: skip
"""What `measure` writes for a problem, in order. Imbalance and excess are what is left of
equilibrium and of the inequalities after rounding: N, as forces; and a number that is positive
where one is missed. Objective and gap are NaN unless the forces are feasible."""

OPTIMAL, FEASIBLE, INFEASIBLE, FAILED = 0, 1, 2, 3
"""Codes of a status, in the order of `judge.Status`."""


class Tolerances(NamedTuple):
    """What the judge allows, see `solvers.judge`."""

    equilibrium: float
    load_share: float
    gap: float
    farkas: float
    negligible: float
    largest: float
    horizon: float


_FREE: dict[str, Any] = {"error_model": "numpy"}


@njit(**_FREE)
def factor(problem: ProblemArrays, triangle: Any) -> float:
    """Write the Cholesky factor of G G', torque rows over the moment arm, which is returned."""
    grasp_map = problem.grasp_map
    n = problem.contact_mask.shape[0]
    force = 0.0
    torque = 0.0
    for c in range(3 * n):
        for r in range(3):
            force += grasp_map[r, c] * grasp_map[r, c]
            torque += grasp_map[r + 3, c] * grasp_map[r + 3, c]
    arm = np.sqrt(torque / force) if force > 0.0 and torque > 0.0 else 1.0
    for r in range(6):
        for t in range(r + 1):
            total = 0.0
            for c in range(3 * n):
                total += grasp_map[r, c] * grasp_map[t, c]
            if r >= 3:
                total /= arm
            if t >= 3:
                total /= arm
            triangle[r, t] = total
    for r in range(6):
        for t in range(r):
            for u in range(t):
                triangle[r, t] -= triangle[r, u] * triangle[t, u]
            triangle[r, t] /= triangle[t, t]
        whole = triangle[r, r]
        for u in range(r):
            triangle[r, r] -= triangle[r, u] * triangle[r, u]
        triangle[r, r] = np.sqrt(max(triangle[r, r], 1e-18 * whole))
    return arm


@njit(**_FREE)
def _least_force(triangle: Any, arm: float, wrench: Any, scratch: Any) -> float:
    """|G^+ wrench|: the size of the smallest forces that make the wrench; N."""
    square = 0.0
    for r in range(6):
        value = wrench[r] if r < 3 else wrench[r] / arm
        for t in range(r):
            value -= triangle[r, t] * scratch[t]
        scratch[r] = value / triangle[r, r]
        square += scratch[r] * scratch[r]
    return float(np.sqrt(square))


@njit(**_FREE)
def force_scale(
    problem: ProblemArrays, triangle: Any, arm: float, scratch: Any
) -> tuple[float, float]:
    """`scaling.force_scale`, and the length of the longest column of J_h."""
    hand_jacobian, mask = problem.hand_jacobian, problem.contact_mask
    torque_min, torque_max = problem.torque_min, problem.torque_max
    wrench, external_torque = problem.external_wrench, problem.external_torque
    normal_min = problem.normal_min
    least = _least_force(triangle, arm, wrench, scratch)
    square = least * least
    for i in range(mask.shape[0]):
        if mask[i]:
            square += normal_min[i] * normal_min[i]
    demand = 0.0
    lever = 0.0
    for j in range(torque_min.shape[0]):
        length = 0.0
        for c in range(hand_jacobian.shape[0]):
            length += hand_jacobian[c, j] * hand_jacobian[c, j]
        length = np.sqrt(length)
        lever = max(lever, length)
        excess = max(external_torque[j] - torque_max[j], torque_min[j] - external_torque[j])
        if excess > 0.0 and length > 0.0:
            demand = max(demand, excess / length)
    square += demand * demand
    return (float(np.sqrt(square)) if square > 0.0 else 1.0), lever


@njit(**_FREE)
def measure_residuals(
    problem: ProblemArrays, objective: int, forces: Any, triangle: Any, arm: float, equation: float,
    scratch: Any, out: Any,
) -> None:  # fmt: skip
    """Residuals, violations and the objective of answered forces; `out[7]` is their size."""
    (grasp_map, jacobian, friction, torque_min, torque_max, wrench, own, low, high, mask) = problem
    n = mask.shape[0]
    error = np.empty(6)
    beyond = np.empty(6)
    for r in range(6):
        total, terms = wrench[r], abs(wrench[r])
        for c in range(3 * n):
            if mask[c // 3]:
                total += grasp_map[r, c] * forces[c]
                terms += abs(grasp_map[r, c] * forces[c])
        error[r] = total
        beyond[r] = np.sign(total) * max(abs(total) - ROUNDING * terms, 0.0)
    out[0] = _least_force(triangle, arm, error, scratch)
    out[8] = _least_force(triangle, arm, beyond, scratch)
    worst_friction, worst_normal, worst_torque, excess = 0.0, 0.0, 0.0, 0.0
    value, largest = 0.0, -np.inf
    for i in range(n):
        if not mask[i]:
            continue
        f0, f1, f2 = forces[3 * i], forces[3 * i + 1], forces[3 * i + 2]
        tangential = np.sqrt(f0 * f0 + f1 * f1)
        over = tangential - friction[i] * f2
        worst_friction = max(worst_friction, over)
        excess = max(excess, over - ROUNDING * (tangential + friction[i] * abs(f2)))
        over = max(low[i] - f2, f2 - high[i])
        worst_normal = max(worst_normal, over)
        excess = max(excess, over - ROUNDING * abs(f2))
        if objective == MIN_NORM:
            value += 0.5 * (f0 * f0 + f1 * f1 + f2 * f2)
        elif objective == SUM_NORMAL:
            value += f2
        largest = max(largest, f2)
    out[4] = largest if objective == MIN_MAX_NORMAL else value
    for j in range(torque_min.shape[0]):
        total, terms = own[j], abs(own[j])
        for c in range(3 * n):
            if mask[c // 3]:
                total += jacobian[c, j] * forces[c]
                terms += abs(jacobian[c, j] * forces[c])
        over = max(total - torque_max[j], torque_min[j] - total)
        worst_torque = max(worst_torque, over)
        # limits that coincide are an equation, and no sum of products meets one exactly
        allowed = equation if torque_max[j] - torque_min[j] <= equation else 0.0
        excess = max(excess, over - ROUNDING * terms - allowed)
    out[1], out[2], out[3], out[9] = worst_friction, worst_normal, worst_torque, excess


@njit(**_FREE)
def _measure_prices(
    problem: ProblemArrays, objective: int, nu: Any, price: Any, scale: float, horizon: float,
    slope: Any, out: Any,
) -> None:  # fmt: skip
    """The dual bound and the Farkas value of multipliers."""
    (grasp_map, jacobian, friction, torque_min, torque_max, wrench, own, low, high, mask) = problem
    n = mask.shape[0]
    constant, terms = 0.0, 0.0
    for r in range(6):
        constant += nu[r] * wrench[r]
        terms += abs(nu[r] * wrench[r])
    for j in range(torque_min.shape[0]):
        term = 0.0
        if price[j] > 0.0 and torque_max[j] < np.inf:
            term = price[j] * (own[j] - torque_max[j])
        elif price[j] < 0.0 and torque_min[j] > -np.inf:
            term = -price[j] * (torque_min[j] - own[j])
        constant += term
        terms += abs(term)
    value, proof = 0.0, 0.0
    for i in range(n):
        slope[i] = 0.0
        if not mask[i]:
            continue
        q = np.zeros(3)
        for axis in range(3):
            c = 3 * i + axis
            for r in range(6):
                q[axis] += grasp_map[r, c] * nu[r]
            for j in range(torque_min.shape[0]):
                usable = (price[j] > 0.0 and torque_max[j] < np.inf) or (
                    price[j] < 0.0 and torque_min[j] > -np.inf
                )
                if usable:
                    q[axis] += jacobian[c, j] * price[j]
        tangential = np.sqrt(q[0] * q[0] + q[1] * q[1])
        slope[i] = q[2] - friction[i] * tangential
        cap = high[i] if high[i] < np.inf else horizon * scale
        term = slope[i] * (cap if slope[i] < 0.0 else low[i])
        proof += term
        terms += abs(term)
        if objective == MIN_NORM:
            mu, normal = friction[i], -q[2]
            best = normal
            if tangential > mu * normal:
                best = (normal + mu * tangential) / (1.0 + mu * mu)
            best = min(max(best, low[i]), high[i])
            pull = min(tangential, mu * best)
            value += 0.5 * (pull * pull + best * best) - pull * tangential + q[2] * best
    proof += constant
    out[6] = proof / terms if terms > 0.0 else proof
    if objective == MIN_NORM:
        out[5] = value + constant
    else:
        out[5] = max(
            _linear_bound(objective, slope, constant, low, high, mask, np.inf),
            _linear_bound(objective, slope, constant, low, high, mask, 0.0),
        )


@njit(**_FREE)
def _linear_bound(
    objective: int, slope: Any, constant: float, low: Any, high: Any, mask: Any, cap: float
) -> float:
    """The dual bound of the linear objectives, from the slopes of the contacts.

    Contacts with at least this cap may not gain by growing: the multipliers are shrunk until so.
    """
    n = mask.shape[0]
    steepest = 0.0
    for i in range(n):
        if mask[i] and slope[i] < 0.0 and high[i] >= cap:
            if objective == MIN_MAX_NORMAL:
                steepest -= slope[i]
            else:
                steepest = max(steepest, -slope[i])
    shrink = 1.0
    if steepest > 1.0:
        shrink = (1.0 - (4 + n) * 2.220446049250313e-16) / steepest
    if objective == SUM_NORMAL:
        total = 0.0
        for i in range(n):
            if mask[i]:
                rate = 1.0 + shrink * slope[i]
                total += rate * (high[i] if rate < 0.0 else low[i])
        return total + shrink * constant
    first, resting = 0.0, 0.0
    for i in range(n):
        if mask[i]:
            first = max(first, low[i])
            if slope[i] >= 0.0:
                resting += shrink * slope[i] * low[i]
    least = np.inf
    for k in range(n + 1):
        level = first
        if k < n:
            if not mask[k] or not first < high[k] < np.inf:
                continue
            level = high[k]
        total = level
        for i in range(n):
            if mask[i] and slope[i] < 0.0:
                total += shrink * slope[i] * min(high[i], level)
        least = min(least, total)
    return least + resting + shrink * constant


@njit(**_FREE)
def _measure(
    problems: ProblemArrays, objective: int, forces: Any, nu: Any, price: Any, allowed: Tolerances,
    out: Any, code: Any,
) -> None:  # fmt: skip
    n, m = problems.friction.shape[1], problems.torque_min.shape[1]
    triangle = np.zeros((6, 6))
    scratch = np.zeros(6)
    slope = np.zeros(n)
    no_nu, no_price = np.zeros(6), np.zeros(m)
    for b in range(problems.friction.shape[0]):
        problem = one_of(problems, b)
        row = out[b]
        arm = factor(problem, triangle)
        scale, lever = force_scale(problem, triangle, arm, scratch)
        answered = True
        square = 0.0
        for c in range(3 * n):
            if not abs(forces[b, c]) <= allowed.largest:
                answered = False
            elif problem.contact_mask[c // 3]:
                square += forces[b, c] * forces[b, c]
        if answered:
            row[7] = max(scale, np.sqrt(square))
            measure_residuals(
                problem, objective, forces[b], triangle, arm,
                _allowance(allowed, row[7], scale) * lever, scratch, row,
            )  # fmt: skip
        else:
            row[:] = np.nan
            row[7] = scale
        priced = True
        for r in range(6):
            priced = priced and abs(nu[b, r]) <= allowed.largest
        for j in range(m):
            priced = priced and abs(price[b, j]) <= allowed.largest
        _measure_prices(
            problem, objective, nu[b] if priced else no_nu, price[b] if priced else no_price,
            scale, allowed.horizon, slope, row,
        )  # fmt: skip
        if not priced:
            row[6] = 0.0
        code[b] = _decide(objective, allowed, scale, row)


@njit(**_FREE)
def _allowance(allowed: Tolerances, size: float, scale: float) -> float:
    """What may be left of an equation, N: it grows with the forces, up to a share of the load."""
    return min(allowed.equilibrium * size, allowed.load_share * scale)


@njit(**_FREE)
def _decide(objective: int, allowed: Tolerances, scale: float, row: Any) -> int:
    """The status; writes the gap, and NaN for the objective of forces that are not feasible."""
    # a NaN, no answer, is in no comparison
    balanced = row[8] <= _allowance(allowed, row[7], scale)
    # rounding excuses no more than that share, either: it hides what enormous forces do not carry
    balanced &= row[0] + ROUNDING * row[7] <= allowed.load_share * scale
    proven = row[6] > allowed.farkas
    if proven or not (balanced and row[9] <= 0.0):
        row[4] = np.nan
        row[10] = np.nan
        return INFEASIBLE if proven else FAILED
    # forces that are all but zero, where no load asks for any, have no size to compare with
    least = allowed.negligible * row[7]
    if objective == MIN_NORM:
        least = 0.5 * least * least
    row[10] = (row[4] - row[5]) / max(abs(row[4]), least)
    return OPTIMAL if abs(row[10]) <= allowed.gap else FEASIBLE


def _entry(sources: str) -> Any:
    @njit(cache=True, nogil=True, **_FREE)
    def measure(arrays, objective, answer, allowed, written):  # type: ignore[no-untyped-def]
        sources  # noqa: B018 - see `cache.digest`
        _measure(ProblemArrays(*arrays), objective, *answer, allowed, *written)

    return measure


measure = _entry(digest())
"""Measure answers: the arrays of a flat batch of problems, the objective's number, the (B, 3n)
forces, (B, 6) nu and (B, n_tau) lambda, the tolerances; writes (B, len(COLUMNS)) and (B,) codes."""
