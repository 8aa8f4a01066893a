"""The compiled search over shares (`covering`), with arrays that grow as it needs them."""

from dataclasses import dataclass

import numpy as np

from solvers.arguments import plain_array
from solvers.arrays import Array
from solvers.compiled.quality.covering import PAUSED, search_shares

from .friction_discs import FrictionDiscs

UNREACHED = 1e30
"""Threshold of a contact that does not reach along a direction at all."""

_VISITS = 2000

_START = 1024
_MOST_BYTES = 384 * 2**20
"""What the boxes of a tree may take; a visit makes as many boxes as there are contacts, and a box
grows with them, too. While the arrays grow, those before take up to half as much again."""


@dataclass(frozen=True)
class SearchOutcome:
    """Where a search stands.

    Args:
        why: it came back, see `solvers.compiled.quality.covering`.
        node: that covers all directions, taken off the heap; -1 for none.
        value: N, no node left is worth more.
    """

    why: int
    node: int
    value: float


class ShareTree:
    """The boxes of a branch and bound over shares, and their heap.

    Args:
        contacts: n.
    """

    def __init__(self, contacts: int) -> None:
        start = max(_START, 1 + contacts)
        self.lower = np.zeros((start, contacts))
        self._upper = np.full((start, contacts), UNREACHED)
        self._values, self._nodes = np.full(start, np.inf), np.zeros(start, dtype=np.int64)
        self._size, self._made = 1, 1
        self._most = max(start, _MOST_BYTES // (16 * (contacts + 1)))
        self.visited = 0

    @property
    def full(self) -> bool:
        """Whether memory ends the search: the value of the last outcome is what is known."""
        return self._made + self.lower.shape[1] > self._most

    def advance(self, thresholds: Array, prices: Array, ends: Array, floor: float) -> SearchOutcome:
        """Visit up to a few thousand nodes; none once the tree is `full`.

        Args:
            thresholds: (k, n) of `share_thresholds`.
            prices: (j, n) >= 0 and
            ends: (j,) of the cuts.
            floor: N, quality below which nothing is of interest.

        Raises:
            ProblemError: for arrays of other shapes.
        """
        contacts = self.lower.shape[1]
        thresholds = plain_array("thresholds", thresholds, (len(thresholds), contacts))
        prices = plain_array("prices", prices, (len(ends), contacts))
        ends = plain_array("ends", ends, (len(ends),))
        why, node, value, self._size, self._made, left = search_shares(
            thresholds,
            prices,
            ends,
            self.lower,
            self._upper,
            self._values,
            self._nodes,
            self._size,
            self._made,
            float(floor),
            _VISITS,
        )
        self.visited += _VISITS - left
        if why == PAUSED and 2 * self._made > len(self.lower):
            for name in ("lower", "_upper", "_values", "_nodes"):
                array = getattr(self, name)
                grown = np.empty((min(2 * len(array), self._most), *array.shape[1:]), array.dtype)
                grown[: len(array)] = array
                setattr(self, name, grown)
        return SearchOutcome(why, node, value)

    def push(self, node: int, value: float) -> None:
        """Put a node back that `advance` took off the heap."""
        at = self._size
        self._values[at], self._nodes[at] = value, node
        while at > 0 and self._values[(at - 1) // 2] < self._values[at]:
            above = (at - 1) // 2
            for heap in (self._values, self._nodes):
                heap[[above, at]] = heap[[at, above]]
            at = above
        self._size += 1


def share_thresholds(unit: FrictionDiscs, directions: Array) -> Array:
    """(k, n) shares of the quality that contacts must press with to reach it along directions.

    Args:
        unit: discs of unit normal forces.
        directions: (k, 6) of any length: reach and quality are per unit of it.
    """
    support = unit.support(directions) / np.linalg.norm(directions, axis=1, keepdims=True)
    return np.where(
        support > 1.0 / UNREACHED, 1.0 / np.maximum(support, 1.0 / UNREACHED), UNREACHED
    )
