"""Branch and bound over shares against every assignment of directions to contacts."""

from itertools import product

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from solvers.arrays import Array
from solvers.compiled.quality.covering import COVERED, PROVEN
from solvers.quality.share_tree import UNREACHED, ShareTree
from tests.support.seeds import seeded


def best_by_enumeration(thresholds: Array, prices: Array, ends: Array) -> float:
    """The largest quality of any shares that cover all directions."""
    directions, contacts = thresholds.shape
    best = 0.0
    for owners in product(range(contacts), repeat=directions):
        shares = np.zeros(contacts)
        np.maximum.at(shares, list(owners), thresholds[np.arange(directions), list(owners)])
        if shares.max() < UNREACHED:
            best = max(best, float((ends / np.maximum(prices @ shares, 1e-300)).min()))
    return best


def best_by_search(thresholds: Array, prices: Array, ends: Array, floor: float) -> float | None:
    """The same by the search; None where it proves that nothing is above the floor."""
    tree = ShareTree(thresholds.shape[1])
    while True:
        outcome = tree.advance(thresholds, prices, ends, floor)
        if outcome.why == PROVEN:
            return None
        if outcome.why == COVERED:
            shares = tree.lower[outcome.node]
            assert (shares >= thresholds).any(axis=1).all()
            assert outcome.value <= (ends / (prices @ shares)).min() * (1 + 1e-12)
            return outcome.value


@given(st.integers(0, 2**32 - 1), st.integers(2, 4), st.integers(1, 6), st.floats(0.0, 0.7))
@settings(max_examples=200)
def test_the_search_finds_what_enumeration_finds(
    seed: int, contacts: int, directions: int, unreached: float
) -> None:
    rng = seeded(seed)
    thresholds = rng.uniform(0.2, 5.0, (directions, contacts))
    thresholds[rng.random(thresholds.shape) < unreached] = UNREACHED
    prices = np.vstack([np.ones(contacts), rng.uniform(0.0, 1.0, (3, contacts))])
    ends = rng.uniform(1.0, 3.0, 4)
    best = best_by_enumeration(thresholds, prices, ends)
    if best == 0.0:
        assert best_by_search(thresholds, prices, ends, 1e-9) is None
        return
    found = best_by_search(thresholds, prices, ends, 0.9 * best)
    assert found is not None
    np.testing.assert_allclose(found, best, rtol=1e-12)
    assert best_by_search(thresholds, prices, ends, best * (1 + 1e-9)) is None


def test_many_nodes_need_more_room_than_there_is_at_first() -> None:
    # no share covers two of these directions, so that no cut tells the assignments apart
    rng = seeded(0)
    room = []
    for _ in range(3):
        directions = rng.standard_normal((4000, 6))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        axes = rng.standard_normal((6, 8))
        support = np.abs(directions @ axes)
        thresholds = 1.0 / np.maximum(support, 1.0 / UNREACHED)
        prices, ends = np.ones((1, 8)), np.ones(1)
        tree, outcome = ShareTree(8), None
        while outcome is None or outcome.why not in (COVERED, PROVEN):
            outcome = tree.advance(thresholds, prices, ends, 0.0)
        assert outcome.why == COVERED
        assert best_by_search(thresholds, prices, ends, outcome.value * (1 + 1e-9)) is None
        room.append(len(tree.lower))
    assert max(room) > 1024
