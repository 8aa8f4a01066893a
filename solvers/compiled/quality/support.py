"""The least reach of contacts in the space of wrenches, compiled: eight directions side by side.

A contact that presses can apply a disc of wrenches. One of centre c and spans s, t reaches
c'd + |(s'd, t'd)| in direction d, and all of them as far as the one that reaches farthest.
"""

import math
from typing import Any

import numpy as np
from numba import njit

from ..cache import digest
from ..lanes import KERNEL, WIDTH, holds, lanes, larger, load, root, smaller, store, where

_ROUNDS = 8
_FINAL_ROUNDS = 24
_STEP = 0.25
_STEP_DECAY = 0.9
_LATER = math.prod([_STEP_DECAY] * _ROUNDS)
"""Share of step and softness that is left after the first rounds, decayed once in each."""

_SOFTNESS = 0.15
_LEAST_SOFTNESS = 0.002
_REGULAR = 1e-9

_PLACE, _BENT, _SLOPE, _DISCS = 0, 6, 12, 18
"""Slots of the workspace: direction, metric times direction, slope, and three for each disc."""


@njit(**KERNEL)
def _whiten(discs: Any, metric: Any) -> Any:
    """Turn discs into coordinates y = L' d in which they have no preferred side, in place.

    Args:
        discs: (k, 3, 6) centre and spans of each.
        metric: (6, 6), written: B with |d|^2 = y' B y.

    Returns:
        (6, 6) the inverse of L: d = L^-T y.
    """
    count = discs.shape[0]
    factor, inverse = np.zeros((6, 6)), np.zeros((6, 6))
    trace = 0.0
    for r in range(6):
        for c in range(r + 1):
            for i in range(count):
                for k in range(3):
                    factor[r, c] += discs[i, k, r] * discs[i, k, c]
        trace += factor[r, r]
    for c in range(6):
        factor[c, c] += _REGULAR * trace
        for k in range(c):
            factor[c, c] -= factor[c, k] * factor[c, k]
        factor[c, c] = np.sqrt(factor[c, c])
        for r in range(c + 1, 6):
            for k in range(c):
                factor[r, c] -= factor[r, k] * factor[c, k]
            factor[r, c] /= factor[c, c]
    for c in range(6):
        inverse[c, c] = 1.0 / factor[c, c]
        for r in range(c + 1, 6):
            for k in range(c, r):
                inverse[r, c] -= factor[r, k] * inverse[k, c]
            inverse[r, c] /= factor[r, r]
    for r in range(6):
        for c in range(6):
            metric[r, c] = 0.0
            for k in range(min(r, c) + 1):
                metric[r, c] += inverse[r, k] * inverse[c, k]
    for i in range(count):
        for k in range(3):
            for r in range(5, -1, -1):
                total = 0.0
                for c in range(r + 1):
                    total += inverse[r, c] * discs[i, k, c]
                discs[i, k, r] = total
    return inverse


@njit(**KERNEL)
def _decay(x: Any) -> Any:
    """exp(x) for x <= 0, to 1e-11; 0 below -20."""
    y = x * (1.0 / 32.0)
    total = y * (1.0 / 40320.0) + 1.0 / 5040.0
    for term in (720.0, 120.0, 24.0, 6.0, 2.0, 1.0, 1.0):
        total = total * y + 1.0 / term
    for _ in range(5):
        total = total * total
    return where(x < -20.0, 0.0, total)


@njit(**KERNEL)
def _descend(
    ws: Any, discs: Any, metric: Any, rounds: int, step: float, softness: float, zero: Any
) -> Any:
    """Least reach per unit length on paths that the places in `ws`, of unit length, move along.

    Each step goes down the gradient of the logarithm of the reach, whose maximum over the discs is
    softened, less and less. It ends early where the reach is not positive.
    """
    count = discs.shape[0]
    best = zero + np.inf
    for _ in range(rounds):
        value = zero - np.inf
        for i in range(count):
            along, first, second = zero, zero, zero
            for k in range(6):
                at = load(ws, _PLACE + k, zero)
                along += discs[i, 0, k] * at
                first += discs[i, 1, k] * at
                second += discs[i, 2, k] * at
            size = root(first * first + second * second)
            inverse = 1.0 / where(size > 0.0, size, zero + 1.0)
            store(ws, _DISCS + 3 * i, along + size)
            store(ws, _DISCS + 3 * i + 1, first * inverse)
            store(ws, _DISCS + 3 * i + 2, second * inverse)
            value = larger(value, along + size)
        square = zero
        for k in range(6):
            bent = zero
            for m in range(6):
                bent += metric[k, m] * load(ws, _PLACE + m, zero)
            store(ws, _BENT + k, bent)
            store(ws, _SLOPE + k, zero)
            square += bent * load(ws, _PLACE + k, zero)
        best = smaller(best, value / root(square))
        if holds(best <= 0.0):
            return best
        sharpness = 1.0 / (max(softness, _LEAST_SOFTNESS) * value)
        total = zero
        for i in range(count):
            weight = _decay((load(ws, _DISCS + 3 * i, zero) - value) * sharpness)
            total += weight
            first = weight * load(ws, _DISCS + 3 * i + 1, zero)
            second = weight * load(ws, _DISCS + 3 * i + 2, zero)
            for k in range(6):
                pull = weight * discs[i, 0, k] + first * discs[i, 1, k] + second * discs[i, 2, k]
                store(ws, _SLOPE + k, load(ws, _SLOPE + k, zero) + pull)
        share, curve = 1.0 / (total * value), 1.0 / square
        along = zero
        for k in range(6):
            slope = load(ws, _SLOPE + k, zero) * share - load(ws, _BENT + k, zero) * curve
            store(ws, _SLOPE + k, slope)
            along += slope * load(ws, _PLACE + k, zero)
        steepness = zero
        for k in range(6):
            slope = load(ws, _SLOPE + k, zero) - along * load(ws, _PLACE + k, zero)
            store(ws, _SLOPE + k, slope)
            steepness += slope * slope
        resting = steepness < 1e-24
        stride = where(resting, zero, step / root(where(resting, zero + 1.0, steepness)))
        square = zero
        for k in range(6):
            at = load(ws, _PLACE + k, zero) - stride * load(ws, _SLOPE + k, zero)
            store(ws, _PLACE + k, at)
            square += at * at
        unit = 1.0 / root(square)
        for k in range(6):
            store(ws, _PLACE + k, load(ws, _PLACE + k, zero) * unit)
        step *= _STEP_DECAY
        softness *= _STEP_DECAY
    return best


@njit(**KERNEL)
def _discs(grasp_map: Any, friction: Any, normal_forces: Any, length: float) -> Any:
    """(k, 3, 6) centre and spans of the disc of each contact that presses, torques over length."""
    pressing = 0
    for i in range(len(friction)):
        pressing += normal_forces[i] > 0.0
    discs = np.empty((pressing, 3, 6))
    to = 0
    for i in range(len(friction)):
        if normal_forces[i] > 0.0:
            for k in range(6):
                scale = normal_forces[i] if k < 3 else normal_forces[i] / length
                discs[to, 0, k] = scale * grasp_map[k, 3 * i + 2]
                discs[to, 1, k] = friction[i] * scale * grasp_map[k, 3 * i]
                discs[to, 2, k] = friction[i] * scale * grasp_map[k, 3 * i + 1]
            to += 1
    return discs


@njit(**KERNEL)
def _unwhiten(ws: Any, inverse: Any, directions: Any) -> None:
    """Write the places of `ws` as unit directions (8, 6) of the wrench space: d = L^-T y."""
    for lane in range(WIDTH):
        square = 0.0
        for k in range(6):
            total = 0.0
            for m in range(k, 6):
                total += inverse[m, k] * ws[WIDTH * (_PLACE + m) + lane]
            directions[lane, k] = total
            square += total * total
        for k in range(6):
            directions[lane, k] /= np.sqrt(square)


@njit(**KERNEL)
def _search(discs: Any, starts: Any, directions: Any) -> float:
    metric = np.empty((6, 6))
    inverse = _whiten(discs, metric)
    zero = lanes(0.0)
    ws = np.empty(WIDTH * (_DISCS + 3 * len(discs)))
    values, places = np.empty(len(starts)), np.empty((len(starts), 6))
    for first in range(0, len(starts), WIDTH):
        for lane in range(WIDTH):
            for k in range(6):
                ws[WIDTH * (_PLACE + k) + lane] = starts[first + lane, k]
        best = _descend(ws, discs, metric, _ROUNDS, _STEP, _SOFTNESS, zero)
        if holds(best <= 0.0):
            _unwhiten(ws, inverse, directions)
            return 0.0
        store(ws, _DISCS, best)
        for lane in range(WIDTH):
            values[first + lane] = ws[WIDTH * _DISCS + lane]
            for k in range(6):
                places[first + lane, k] = ws[WIDTH * (_PLACE + k) + lane]
    order = np.argsort(values)
    for lane in range(WIDTH):
        for k in range(6):
            ws[WIDTH * (_PLACE + k) + lane] = places[order[lane], k]
    best = _descend(ws, discs, metric, _FINAL_ROUNDS, _STEP * _LATER, _SOFTNESS * _LATER, zero)
    _unwhiten(ws, inverse, directions)
    store(ws, _DISCS, best)
    least = values[order[0]]
    for lane in range(WIDTH):
        least = min(least, ws[WIDTH * _DISCS + lane])
    return max(least, 0.0)


@njit(**KERNEL)
def _least_support(
    grasp_map: Any, friction: Any, normal_forces: Any, length: float, starts: Any, directions: Any
) -> float:
    discs = _discs(grasp_map, friction, normal_forces, length)
    # two points do not resist a torque about the line through them
    if len(discs) < 3:
        return 0.0
    return _search(discs, starts, directions)


@njit(**KERNEL)
def _farthest_support(
    grasp_map: Any, friction: Any, normal_forces: Any, length: float, direction: Any
) -> float:
    best = -np.inf
    for i in range(len(friction)):
        if normal_forces[i] > 0.0:
            first, second, normal = 0.0, 0.0, 0.0
            for k in range(6):
                scale = direction[k] if k < 3 else direction[k] / length
                first += scale * grasp_map[k, 3 * i]
                second += scale * grasp_map[k, 3 * i + 1]
                normal += scale * grasp_map[k, 3 * i + 2]
            size = friction[i] * np.sqrt(first * first + second * second)
            best = max(best, normal_forces[i] * (normal + size))
    return best


def _entries(sources: str) -> tuple[Any, Any, Any]:
    @njit(cache=True, **KERNEL)
    def least_support(*arguments):  # type: ignore[no-untyped-def]
        sources  # noqa: B018 - see `cache.digest`
        return _least_support(*arguments)

    @njit(cache=True, **KERNEL)
    def least_supports(
        grasp_maps: Any,
        friction: Any,
        normal_forces: Any,
        lengths: Any,
        starts: Any,
        directions: Any,
        values: Any,
    ) -> None:
        sources  # noqa: B018
        for b in range(len(grasp_maps)):
            values[b] = _least_support(
                grasp_maps[b], friction[b], normal_forces[b], lengths[b], starts, directions[b]
            )

    @njit(cache=True, **KERNEL)
    def farthest_supports(
        grasp_maps: Any, friction: Any, normal_forces: Any, lengths: Any, directions: Any, out: Any
    ) -> None:
        sources  # noqa: B018
        for b in range(len(grasp_maps)):
            for k in range(directions.shape[1]):
                out[b, k] = _farthest_support(
                    grasp_maps[b], friction[b], normal_forces[b], lengths[b], directions[b, k]
                )

    return least_support, least_supports, farthest_supports


least_support, least_supports, farthest_supports = _entries(digest())
"""N: least reach over unit directions, by descent: an upper bound of it; 0 where one is negative.

Arguments: grasp map (6, 3n), friction (n,), normal forces (n,) N, divisor of torques m, unit
directions to start from, (8k, 6), and (8, 6), written: where the last paths ended, unless fewer
than three contacts press. `least_supports` has a leading dimension in each but the starts, and
writes into a last argument (B,). `farthest_supports` writes into (B, k) N how far the contact that
reaches farthest does along given directions (B, k, 6); -inf where none presses."""
