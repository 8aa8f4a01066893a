"""Semismooth Newton ascent on the concave dual of a grasp force problem, compiled.

With q = A' (y, lambda), A the rows of the grasp map and of the Jacobian's columns, the dual value
1/2 |f^|^2 + q' f^ + y' w + limits, f^ = Pi_C(-q), is concave with the gradient A f^ + (w, -limit)
and the generalised Hessian -A D A'. Its size is six and the number of torque limits in play,
whatever the number of contacts. A torque that is given, an equation, is always in play, and its
price has either sign. A line search on the value makes the ascent global. Close to the
optimum the linearised forces f^ - D A' step obey equilibrium and the torque limits in play exactly,
and leave contacts that do not push at zero; if they keep all limits and the dual value at the next
point proves them good enough, they are the answer.
"""

from typing import Any

from numba import njit

from ..lanes import KERNEL, holds, larger, load, root, smaller, store, where
from .candidate import primal_candidate
from .layout import Layout
from .projection import project
from .proofs import proves_infeasible, recession_direction
from .system import combine, factorise, solve

UNFINISHED, SOLVED, INFEASIBLE, STUCK = 0, 1, 2, 3
"""Codes of an answer. STUCK: no step gained anything."""

_FLOOR, _SHARE = 1e-11, 1e-4
"""Added to the Hessian: a floor, and a share of the residual up to one."""

_SHRINK, _TRIALS, _ARMIJO = 0.4, 30, 1e-4
"""Line search: factor, number of lengths, least share of the promised gain."""

_ROUNDING = 1e-14
"""Of a dual value, relative: the line search cannot see smaller gains."""

_NEAR = 1e-3
"""Residual below which linearised forces are worth a look."""

_FAR = 1e-3
"""Residual above which a proof of infeasibility is."""

_PROOF_FROM, _PROOF_EVERY = 2, 3
"""First step before which a proof is looked for; and between attempts to find one."""

_GOAL, _FARTHER = 10.0, 10.0
"""Dual value above which the multipliers are bent to a proof, and factor to the next such value."""

_GAP = 1e-8
"""Relative gap of an answer; linearised forces that keep all limits have a far smaller one."""


@njit(**KERNEL)
def start(ws: Any, at: Layout, zero: Any) -> None:
    """The start y = 2 (G G')^-1 w, no torque price; nothing answered."""
    for r in range(6):
        store(ws, at.y + r, 2.0 * load(ws, at.load + r, zero))
    for j in range(at.m):
        store(ws, at.price + j, zero)
    store(ws, at.code, zero)
    store(ws, at.steps, zero)
    store(ws, at.goal, zero + _GOAL)
    for r in range(6 + at.m):
        # what an earlier problem left there may be no number, and zero times that is none either
        store(ws, at.step + r, zero)
    for c in range(3 * at.n):
        store(ws, at.answer + c, zero)


@njit(**KERNEL)
def newton_ascent(ws: Any, at: Layout, active: Any, steps: int, zero: Any) -> None:
    """Newton steps until every lane is answered, at most `steps`.

    Args:
        ws: workspace after `setup.prepare` and `start`.
        at: its layout.
        active: (6 + m) integers, rows in play of any lane: scratch.
        steps: largest number of Newton steps.
        zero: 0 of the number type.
    """
    w = 3 * at.n
    for c in range(w):
        q = zero
        for r in range(6):
            q += load(ws, at.rows + r * w + c, zero) * load(ws, at.y + r, zero)
        for j in range(at.m):
            q += load(ws, at.rows + (6 + j) * w + c, zero) * load(ws, at.price + j, zero)
        store(ws, at.prices + c, q)
    for r in range(6):
        active[r] = r
    done = zero > 1.0
    value = project(ws, at, at.prices, at.inner_cone, zero)
    value += _constant(ws, at, at.price, zero, zero)
    for iteration in range(steps):
        k = _differentiate(ws, at, active, done, zero)
        square = zero
        for r in range(k):
            g = load(ws, at.gradient + r, zero)
            square += g * g
        residual = root(square)
        if iteration >= _PROOF_FROM and holds((residual > _FAR) & ~done):
            proven = proves_infeasible(ws, at, at.prices, at.y, at.price, zero) & ~done
            if holds(proven):
                _keep(ws, at, proven, float(INFEASIBLE), at.y, at.price, zero)
                done = done | proven
            goal = load(ws, at.goal, zero)
            promising = (value > goal) & ~done
            if iteration % _PROOF_EVERY == _PROOF_FROM and holds(promising):
                store(ws, at.goal, where(promising, _FARTHER * value, goal))
                proven = recession_direction(ws, at, active, promising, zero)
                _keep(ws, at, proven, float(INFEASIBLE), at.error, at.trial_price, zero)
                done = done | proven
                project(ws, at, at.prices, at.inner_cone, zero)
                k = _differentiate(ws, at, active, done, zero)
            if not holds(~done):
                return
        store(ws, at.steps, load(ws, at.steps, zero) + where(done, zero, zero + 1.0))
        _direct(ws, at, active, k, _FLOOR + _SHARE * smaller(residual, zero + 1.0), done, zero)
        combine(ws, at, active, at.step, at.push, k, zero)
        slope = zero
        for r in range(k):
            slope += load(ws, at.gradient + r, zero) * load(ws, at.step + r, zero)
        good = zero > 1.0
        objective = zero
        near = (residual < _NEAR) & ~done
        if holds(near):
            good, objective = primal_candidate(ws, at, active, k, zero)
            good = good & near

        reach = zero + 1.0
        accepted = done
        trial_value = value
        for trial in range(_TRIALS):
            trial_value = _try(ws, at, active, k, reach, zero)
            if trial == 0 and holds(good):
                finished = good & (objective - trial_value <= _GAP * objective)
                _keep_candidate(ws, at, finished, zero)
                done = done | finished
                accepted = accepted | finished
                if not holds(~done):
                    return
            least = value + _ARMIJO * reach * slope - _ROUNDING * where(value > 0.0, value, -value)
            accepted = accepted | (trial_value >= least)
            if not holds(~accepted):
                break
            if trial + 1 < _TRIALS:
                reach = where(accepted, reach, _SHRINK * reach)
        lost = ~accepted
        if holds(lost):
            store(ws, at.code, where(lost, zero + float(STUCK), load(ws, at.code, zero)))
            done = done | lost
            if not holds(~done):
                return
        value = trial_value
        for c in range(w):
            store(ws, at.prices + c, load(ws, at.trial_prices + c, zero))
        for r in range(6):
            moved = load(ws, at.y + r, zero) + reach * load(ws, at.step + r, zero)
            store(ws, at.y + r, moved)
        for j in range(at.m):
            store(ws, at.price + j, load(ws, at.trial_price + j, zero))


@njit(**KERNEL)
def _constant(ws: Any, at: Layout, price_slot: int, reach: Any, zero: Any) -> Any:
    """y' w and the terms of the torque limits, at y + reach step and the prices in the slot."""
    total = zero
    for r in range(6):
        y = load(ws, at.y + r, zero) + reach * load(ws, at.step + r, zero)
        total += y * load(ws, at.load + r, zero)
    for j in range(at.m):
        price = load(ws, price_slot + j, zero)
        over = where(price > 0.0, -price * load(ws, at.inner_torque_high + j, zero), zero)
        total += where(price < 0.0, -price * load(ws, at.inner_torque_low + j, zero), over)
    return total


@njit(**KERNEL)
def _differentiate(ws: Any, at: Layout, active: Any, done: Any, zero: Any) -> int:
    """Write the gradient in the rows in play of any lane, and which those are; return how many."""
    w = 3 * at.n
    for r in range(6):
        total = load(ws, at.load + r, zero)
        for c in range(w):
            total += load(ws, at.rows + r * w + c, zero) * load(ws, at.forces + c, zero)
        store(ws, at.gradient + r, total)
    k = 6
    for j in range(at.m):
        torque = zero
        for c in range(w):
            torque += load(ws, at.rows + (6 + j) * w + c, zero) * load(ws, at.forces + c, zero)
        price = load(ws, at.price + j, zero)
        low = load(ws, at.inner_torque_low + j, zero)
        high = load(ws, at.inner_torque_high + j, zero)
        limit = smaller(larger(torque, low), high)
        limit = where(price > 0.0, high, where(price < 0.0, low, limit))
        play = (price > 0.0) | (price < 0.0) | (torque > high) | (torque < low)
        play |= load(ws, at.equation + j, zero) > 0.5
        if holds(play & ~done):
            store(ws, at.limit + k - 6, limit)
            store(ws, at.play + k - 6, where(play, zero + 1.0, zero))
            store(ws, at.gradient + k, where(play, torque - limit, zero))
            active[k] = 6 + j
            k += 1
    return k


@njit(**KERNEL)
def _direct(ws: Any, at: Layout, active: Any, k: int, ridge: Any, done: Any, zero: Any) -> None:
    """Write the Newton step of the joints that it does not carry across zero, and of all rows.

    A price that is zero may only grow on the side where its limit is exceeded; else it stays. One
    that would change its sign goes to zero if its own gradient says so, and stays if not. Each of
    these alone raises the dual value, and so does the Newton step of what is left.
    """
    for r in range(6, k):
        store(ws, at.error + r, zero)
    for _ in range(1 + at.m):
        factorise(ws, at, active, k, ridge, zero)
        for r in range(k):
            store(ws, at.step + r, load(ws, at.gradient + r, zero))
        solve(ws, at, at.step, k, zero)
        again = False
        for r in range(6, k):
            play = load(ws, at.play + r - 6, zero)
            price = load(ws, at.price + active[r] - 6, zero)
            step = load(ws, at.step + r, zero)
            gradient = load(ws, at.gradient + r, zero)
            crosses = (price * (price + step) < 0.0) | ((price == 0.0) & (step * gradient < 0.0))
            crosses &= (play > 0.5) & (load(ws, at.equation + active[r] - 6, zero) < 0.5) & ~done
            if holds(crosses):
                again = True
                shrinks = price * gradient < 0.0
                own = where(shrinks, -price, zero)
                store(ws, at.error + r, where(crosses, own, load(ws, at.error + r, zero)))
                store(ws, at.play + r - 6, where(crosses, zero, play))
                store(ws, at.gradient + r, where(crosses & ~shrinks, zero, gradient))
        if not again:
            break
    for r in range(6, k):
        plays = load(ws, at.play + r - 6, zero) > 0.5
        step = where(plays, load(ws, at.step + r, zero), load(ws, at.error + r, zero))
        store(ws, at.step + r, step)


@njit(**KERNEL)
def _try(ws: Any, at: Layout, active: Any, k: int, reach: Any, zero: Any) -> Any:
    """Forces, curvature, dual value at y + reach step; a price that changes sign becomes zero."""
    w = 3 * at.n
    for c in range(w):
        store(
            ws,
            at.trial_prices + c,
            load(ws, at.prices + c, zero) + reach * load(ws, at.push + c, zero),
        )
    for j in range(at.m):
        store(ws, at.trial_price + j, load(ws, at.price + j, zero))
    for r in range(6, k):
        j = active[r] - 6
        before = load(ws, at.price + j, zero)
        after = before + reach * load(ws, at.step + r, zero)
        crosses = (before * after < 0.0) & (load(ws, at.equation + j, zero) < 0.5)
        if holds(crosses):
            row = at.rows + active[r] * w
            for c in range(w):
                q = load(ws, at.trial_prices + c, zero)
                too_much = where(crosses, after * load(ws, row + c, zero), zero)
                store(ws, at.trial_prices + c, q - too_much)
        store(ws, at.trial_price + j, where(crosses, zero, after))
    return project(ws, at, at.trial_prices, at.inner_cone, zero) + _constant(
        ws, at, at.trial_price, reach, zero
    )


@njit(**KERNEL)
def _keep(ws: Any, at: Layout, mask: Any, code: float, y: int, price: int, zero: Any) -> None:
    """Keep the multipliers in the slots as the answer of the lanes of the mask."""
    for r in range(6):
        kept = load(ws, at.answer_y + r, zero)
        store(ws, at.answer_y + r, where(mask, load(ws, y + r, zero), kept))
    for j in range(at.m):
        kept = load(ws, at.answer_price + j, zero)
        store(ws, at.answer_price + j, where(mask, load(ws, price + j, zero), kept))
    store(ws, at.code, where(mask, zero + code, load(ws, at.code, zero)))


@njit(**KERNEL)
def _keep_candidate(ws: Any, at: Layout, mask: Any, zero: Any) -> None:
    """Keep the candidate, and the multipliers at the end of the whole step, as an answer."""
    for c in range(3 * at.n):
        kept = load(ws, at.answer + c, zero)
        store(ws, at.answer + c, where(mask, load(ws, at.candidate + c, zero), kept))
    for r in range(6):
        store(ws, at.error + r, load(ws, at.y + r, zero) + load(ws, at.step + r, zero))
    _keep(ws, at, mask, float(SOLVED), at.error, at.trial_price, zero)
