"""The largest quality that forces can have, by branch and bound over contacts' shares, compiled.

Forces with normal components a have a quality of at least t if in every direction d_k of the
wrench space some contact reaches t: a_i h_i(d_k) >= t. In shares s = a / t: some share is at least
its threshold, s_i >= 1 / h_i(d_k). Of the set of possible a, cuts z_j'a <= m_j with z_j >= 0 are
known, so shares allow no more than t = min_j m_j / (z_j's). A node is a box of shares; it is split
by which contact covers a direction that its lower corner leaves uncovered: one child for each
contact, in which those before it do not cover, so that no two children overlap.
"""

from typing import Any

import numpy as np
from numba import njit

from ..cache import digest
from ..lanes import KERNEL

COVERED, PROVEN, PAUSED = 0, 1, 2
"""Why a search came back: the best node covers all directions; no node is above the floor; the
nodes that it might visit are used up."""


@njit(**KERNEL)
def _push(values: Any, nodes: Any, size: int, value: float, node: int) -> int:
    at = size
    values[at], nodes[at] = value, node
    while at > 0:
        above = (at - 1) // 2
        if values[above] >= values[at]:
            break
        values[above], values[at] = values[at], values[above]
        nodes[above], nodes[at] = nodes[at], nodes[above]
        at = above
    return size + 1


@njit(**KERNEL)
def _pop(values: Any, nodes: Any, size: int) -> int:
    """Remove the root; the caller has read it."""
    size -= 1
    values[0], nodes[0] = values[size], nodes[size]
    at = 0
    while True:
        child = 2 * at + 1
        if child >= size:
            return size
        if child + 1 < size and values[child + 1] > values[child]:
            child += 1
        if values[at] >= values[child]:
            return size
        values[child], values[at] = values[at], values[child]
        nodes[child], nodes[at] = nodes[at], nodes[child]
        at = child


@njit(**KERNEL)
def _tightest(shares: Any, prices: Any, ends: Any) -> tuple[float, int]:
    """The quality that the cuts allow at these shares, and which cut allows no more."""
    least, cut = np.inf, -1
    for j in range(len(ends)):
        cost = 0.0
        for i in range(len(shares)):
            cost += prices[j, i] * shares[i]
        if cost > 0.0 and ends[j] < least * cost:
            least, cut = ends[j] / cost, j
    return least, cut


@njit(**KERNEL)
def _cap(lower: Any, upper: Any, prices: Any, ends: Any, floor: float) -> bool:
    """Lower the box's upper corner to where the cuts still allow `floor`; whether a box remains."""
    if floor <= 0.0:
        return True
    for j in range(len(ends)):
        cost = 0.0
        for i in range(len(lower)):
            cost += prices[j, i] * lower[i]
        room = ends[j] / floor - cost
        for i in range(len(lower)):
            if prices[j, i] > 0.0:
                upper[i] = min(upper[i], lower[i] + room / prices[j, i])
    fits = True
    for i in range(len(lower)):
        fits &= upper[i] >= lower[i]
    return fits


@njit(**KERNEL)
def _branch(thresholds: Any, lower: Any, upper: Any, prices: Any, ends: Any, floor: float) -> int:
    """The direction to branch at; -1 if all are covered, -2 if one cannot be.

    Where just one contact can cover a direction, the box's lower corner is raised to it. Of the
    rest that direction is taken whose children cost most, measured by the tightest cut.
    """
    n = len(lower)
    while True:
        if not _cap(lower, upper, prices, ends, floor):
            return -2
        level, cut = _tightest(lower, prices, ends)
        raised = False
        chosen, least = -1, np.inf
        for k in range(len(thresholds)):
            able, last = 0, -1
            for i in range(n):
                wanted = thresholds[k, i]
                if wanted <= lower[i]:
                    able = -1
                    break
                if wanted < upper[i]:
                    able += 1
                    last = i
            if able < 0:
                continue
            if able == 0:
                return -2
            if able == 1:
                lower[last] = thresholds[k, last]
                raised = True
                continue
            ease = 0.0
            for i in range(n):
                if thresholds[k, i] < upper[i]:
                    rise = thresholds[k, i] - lower[i]
                    if cut >= 0:
                        rise *= prices[cut, i] * level / ends[cut]
                    ease += 1.0 / (1e-3 + rise)
            if ease < least:
                chosen, least = k, ease
        if not raised:
            return chosen


def _entry(sources: str) -> Any:
    @njit(cache=True, **KERNEL)
    def search_shares(
        thresholds: Any,
        prices: Any,
        ends: Any,
        lower: Any,
        upper: Any,
        values: Any,
        nodes: Any,
        size: int,
        made: int,
        floor: float,
        visits: int,
    ) -> Any:
        sources  # noqa: B018 - see `cache.digest`
        n = thresholds.shape[1]
        trial = np.empty(n)
        while size > 0:
            if values[0] <= floor:
                return PROVEN, -1, values[0], size, made, visits
            if visits == 0 or made + n > len(lower):
                return PAUSED, -1, values[0], size, made, visits
            visits -= 1
            value, node = values[0], nodes[0]
            size = _pop(values, nodes, size)
            low, high = lower[node], upper[node]
            at = _branch(thresholds, low, high, prices, ends, floor)
            if at == -2:
                continue
            value = min(value, _tightest(low, prices, ends)[0])
            if value <= floor:
                continue
            if size > 0 and value < values[0]:
                size = _push(values, nodes, size, value, node)
                continue
            if at == -1:
                return COVERED, node, value, size, made, visits
            worth = np.full(n, -1.0)
            for i in range(n):
                if thresholds[at, i] < high[i]:
                    trial[:] = low
                    trial[i] = thresholds[at, i]
                    worth[i] = min(value, _tightest(trial, prices, ends)[0])
            ceiling = high.copy()
            order = np.argsort(-worth)
            for i in order:
                if worth[i] < 0.0:
                    break
                if worth[i] > floor:
                    lower[made] = low
                    lower[made, i] = thresholds[at, i]
                    upper[made] = ceiling
                    size = _push(values, nodes, size, worth[i], made)
                    made += 1
                ceiling[i] = min(ceiling[i], thresholds[at, i])
        return PROVEN, -1, floor, size, made, visits

    return search_shares


search_shares = _entry(digest())
"""Go on with a search, best node first: (why it came back, node, value of the best, heap size,
nodes made, visits left). A node that covers all directions is taken off the heap; push it back with
a new value.

Arguments: thresholds (k, n) 1 / h, a large finite number where a contact does not reach; prices
(j, n) and ends (j,) of the cuts; boxes (N, n) lower and upper and a heap of values and nodes, (N,)
each, all written; the heap's size; nodes made so far; the floor, below which nothing is of
interest; how many nodes to visit."""
