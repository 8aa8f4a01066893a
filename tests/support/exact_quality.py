"""What an answer states about the quality of its forces, checked in exact arithmetic.

q_lrw is the radius of the largest ball in the hull of the wrenches that the contacts can apply at
their normal forces, so it is no larger than the hull's reach along any direction: the most of
u . c_i + |u . S_i| over the contacts, c_i the wrench of the normal force alone, S_i those of the
friction along the two tangents. The directions are guessed in float64 from the facets of inscribed
pyramids; what they prove is exact. See `tests.support.rational`.
"""

from collections.abc import Iterator, Sequence
from fractions import Fraction
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from tests.support.rational import Exact, dot, rational, root

_BUDGET = Fraction(1, 10**12)
_ROUNDING = Fraction(1, 10**9)
"""Of the quality: what the perturbation of the wrenches that the judge allows itself may change."""

_EDGES = 8
_DIRECTIONS = 5
_ROUNDS = 12


def quality_faults(
    problem: Any,
    exact: Exact,
    forces: Sequence[Fraction],
    stated: tuple[float, float],
    objective: float,
) -> Iterator[str]:
    """What of budget, quality and objective does not hold.

    Args:
        problem: a single one, `max_quality`.
        exact: the same, exactly.
        forces: of the answer, padding left out.
        stated: N, the ends of the interval that q_lrw is said to lie in.
        objective: as stated.
    """
    effort = sum(forces[2::3], Fraction(0))
    if effort > exact.number(problem, "effort_budget") * (1 + _BUDGET):
        yield f"effort {float(effort)!r} N beyond the budget"
    lower, upper = map(Fraction, stated)
    if not 0 <= lower <= upper:
        yield f"q_lrw is said to lie between {stated[0]!r} and {stated[1]!r}"
    value = exact.number(problem, "effort_weight") * effort - lower
    if abs(Fraction(objective) - value) > Fraction(1, 10**12) * (effort + lower):
        yield f"objective {objective!r} stated, {float(value)!r} by the ends of its interval"
    if lower == 0:  # holds where the wrenches do not surround the origin, too
        return
    discs = _discs(problem, exact, forces)
    for direction in _directions(discs):
        reach = max(
            dot(direction, centre)
            + root(sum((dot(direction, s) ** 2 for s in span), Fraction(0)))[1]
            for centre, *span in discs
        )
        length = root(dot(direction, direction))[0]
        if lower * length > reach + _ROUNDING * abs(reach):
            over = float(lower * length - reach)
            yield f"q_lrw is {over:.1e} N below what is stated along {list(map(float, direction))}"


def _discs(problem: Any, exact: Exact, forces: Sequence[Fraction]) -> list[list[list[Fraction]]]:
    """Of each contact the wrenches of its normal force and of its friction along both tangents."""
    length = exact.number(problem, "characteristic_length")
    units = [Fraction(1)] * 3 + [length] * 3
    discs = []
    for i, contact in enumerate(exact.contacts):
        columns = [
            [row[3 * i + axis] / unit for row, unit in zip(exact.grasp_map, units, strict=True)]
            for axis in range(3)
        ]
        sizes = contact.friction * forces[3 * i + 2], forces[3 * i + 2]
        discs.append(
            [
                [sizes[1] * entry for entry in columns[2]],
                *([sizes[0] * entry for entry in column] for column in columns[:2]),
            ]
        )
    return discs


def _directions(discs: list[list[list[Fraction]]]) -> list[list[Fraction]]:
    """Directions along which the hull reaches least far, guessed.

    Every round adds the wrenches of the discs that reach farthest along the facets nearest to the
    origin.
    """
    centres, *spans = np.array(discs, dtype=float).transpose(1, 0, 2)
    first, second = spans
    angles = 2 * np.pi * np.arange(_EDGES) / _EDGES
    rim = [centres + np.cos(a) * first + np.sin(a) * second for a in angles]
    wrenches = np.vstack([np.zeros((1, 6)), *rim])
    tried = [np.vstack([np.eye(6), -np.eye(6)])]
    for _ in range(_ROUNDS):
        try:
            equations = ConvexHull(wrenches, qhull_options="QJ").equations
        except QhullError:  # the wrenches span no six dimensions
            break
        nearest = equations[np.argsort(-equations[:, 6])[:_DIRECTIONS], :6]
        tried.append(nearest)
        for direction in nearest:
            along = np.stack([first @ direction, second @ direction])
            size = np.linalg.norm(along, axis=0)
            farthest = int(np.argmax(centres @ direction + size))
            turn = along[:, farthest] / (size[farthest] or 1.0)
            wrench = centres[farthest] + turn[0] * first[farthest] + turn[1] * second[farthest]
            wrenches = np.vstack([wrenches, wrench])
    directions = np.vstack(tried)
    reach = (directions @ centres.T) + np.hypot(directions @ first.T, directions @ second.T)
    return rational(directions[np.argsort(reach.max(axis=1))[:_DIRECTIONS]].tolist())
