"""q_lrw from the support function of the friction cones: fast, mostly a little too large.

The least reach of the hull of all contacts' wrenches, over unit directions d of the wrench space,
is q_lrw. Any direction gives an upper bound; the search descends from a fixed set of directions,
spread evenly after whitening, because weak directions lie close together. The hull itself
(`quality.lowest_resisted_wrench`) takes milliseconds, and its pyramids of few edges are far too
small.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.special import ndtri
from scipy.stats import qmc

Array = NDArray[np.float64]

_STARTS = 32
_ROUNDS = 8
_FINALISTS = 4
_FINAL_ROUNDS = 24
_STEP = 0.25
_STEP_DECAY = 0.9
_SOFTNESS = 0.15
_LEAST_SOFTNESS = 0.002


def _spread_directions(count: int) -> Array:
    """(count, 6) unit vectors, evenly from all sides: Sobol points made normal, then unit."""
    points = qmc.Sobol(6, scramble=True, rng=0).random(count)
    normal = ndtri(np.clip(points, 1e-9, 1.0 - 1e-9))
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))


_SPREAD = _spread_directions(_STARTS)


def quality_estimate(
    grasp_map: Array, friction: Array, normal_forces: Array, length: float
) -> float:
    """N: an upper bound of q_lrw for the true (round) friction cones.

    Where it is 0, q_lrw is 0. Mostly it is a few per cent too large, at times far more:
    docs/environment.md has the figures against refined hulls.

    Args:
        grasp_map: (6, 3n) G of n >= 0 contacts, object frame; N, m.
        friction: (n,) coefficients.
        normal_forces: (n,) N; contacts that do not push are left out.
        length: m, divisor of torques.
    """
    return float(_search(np.ascontiguousarray(grasp_map), friction, normal_forces, length, _SPREAD))


# reordered sums: the value needs no last digit, and vectorised loops take half the time
_FAST = {"reassoc", "contract", "arcp", "nsz"}


@njit(cache=True, fastmath=_FAST)
def _whitened(
    grasp_map: Array, friction: Array, normal_forces: Array, length: float, pressing: int
) -> tuple[Array, Array, Array]:
    """Discs in coordinates y = L' d in which their wrenches have no preferred side.

    Returns centres (k, 6), spans (k, 2, 6), and B (6, 6) with |d|^2 = y' B y.
    """
    wrenches = np.empty((3 * pressing, 6))
    row = 0
    for i in range(len(friction)):
        if normal_forces[i] > 0.0:
            for k in range(6):
                scale = normal_forces[i] if k < 3 else normal_forces[i] / length
                wrenches[row, k] = scale * grasp_map[k, 3 * i + 2]
                wrenches[row + 1, k] = friction[i] * scale * grasp_map[k, 3 * i]
                wrenches[row + 2, k] = friction[i] * scale * grasp_map[k, 3 * i + 1]
            row += 3
    moment = wrenches.T @ wrenches
    moment += 1e-9 * np.trace(moment) * np.eye(6)
    inverse = np.linalg.inv(np.linalg.cholesky(moment))
    white = (wrenches @ inverse.T).reshape(pressing, 3, 6)
    metric = inverse @ inverse.T
    return white[:, 0].copy(), white[:, 1:].copy(), metric


@njit(cache=True)
def _search(
    grasp_map: Array, friction: Array, normal_forces: Array, length: float, directions: Array
) -> float:
    pressing = 0
    for i in range(len(friction)):
        pressing += normal_forces[i] > 0.0
    if pressing < 3:  # two points do not resist a torque about the line through them
        return 0.0
    centres, spans, metric = _whitened(grasp_map, friction, normal_forces, length, pressing)
    reach, pull = np.empty(pressing), np.empty((pressing, 2))
    places = directions.copy()
    values = np.empty(len(places))
    for k in range(len(places)):
        values[k] = _descend(
            places[k], centres, spans, metric, reach, pull, _ROUNDS, _STEP, _SOFTNESS
        )
        if values[k] <= 0.0:
            return 0.0
    order = np.argsort(values)
    best = values[order[0]]
    decayed = _STEP_DECAY**_ROUNDS
    for k in order[:_FINALISTS]:
        value = _descend(
            places[k], centres, spans, metric, reach, pull,
            _FINAL_ROUNDS, _STEP * decayed, _SOFTNESS * decayed,
        )  # fmt: skip
        best = min(best, value)
    return max(best, 0.0)


@njit(cache=True, fastmath=_FAST)
def _descend(
    place: Array, centres: Array, spans: Array, metric: Array, reach: Array, pull: Array,
    rounds: int, step: float, softness: float,
) -> float:  # fmt: skip
    """Least reach per unit length on a path that `place` (6,), of unit length, is moved along.

    Each step goes down the gradient of the logarithm of the reach, whose maximum over the contacts
    is softened, less and less.
    """
    slope, bent = np.empty(6), np.empty(6)
    best = np.inf
    for _ in range(rounds):
        value = -np.inf
        for i in range(len(centres)):
            along, first, second = 0.0, 0.0, 0.0
            for k in range(6):
                along += centres[i, k] * place[k]
                first += spans[i, 0, k] * place[k]
                second += spans[i, 1, k] * place[k]
            size = np.sqrt(first * first + second * second)
            reach[i] = along + size
            pull[i, 0] = first / size if size > 0.0 else 0.0
            pull[i, 1] = second / size if size > 0.0 else 0.0
            value = max(value, reach[i])
        square = 0.0
        for k in range(6):
            bent[k] = 0.0
            for m in range(6):
                bent[k] += metric[k, m] * place[m]
            square += bent[k] * place[k]
        best = min(best, value / np.sqrt(square))
        if best <= 0.0:
            return best
        scale = max(softness, _LEAST_SOFTNESS) * value
        total = 0.0
        slope[:] = 0.0
        for i in range(len(centres)):
            weight = np.exp((reach[i] - value) / scale)
            if weight > 1e-9:
                total += weight
                for k in range(6):
                    support = pull[i, 0] * spans[i, 0, k] + pull[i, 1] * spans[i, 1, k]
                    slope[k] += weight * (centres[i, k] + support)
        along, steepness = 0.0, 0.0
        for k in range(6):
            slope[k] = slope[k] / (total * value) - bent[k] / square
            along += slope[k] * place[k]
        for k in range(6):
            slope[k] -= along * place[k]
            steepness += slope[k] * slope[k]
        if steepness < 1e-24:
            return best
        stride = step / np.sqrt(steepness)
        size = 0.0
        for k in range(6):
            place[k] -= stride * slope[k]
            size += place[k] * place[k]
        size = np.sqrt(size)
        for k in range(6):
            place[k] /= size
        step *= _STEP_DECAY
        softness *= _STEP_DECAY
    return best
