"""Where tests draw their random inputs: always the same, or with GRASPFORCE_TEST_SEED=N others.

`make test-seeds` runs the tests on many of them: what holds for one draw alone stood on luck.
"""

import os
from collections.abc import Sequence

import numpy as np
from hypothesis import strategies as st

SEEDS = st.integers(0, 2**32 - 1)
"""Of examples of hypothesis."""

NUMBER = int(os.environ.get("GRASPFORCE_TEST_SEED") or 0)
"""Of the set of inputs; 0 for those of every day."""

_APART = 1_000_000


def reseeded(seed: int) -> int:
    """The seed itself, moved far from all others of the tests where other inputs are asked for."""
    return seed + _APART * NUMBER


def seeded(seed: int | Sequence[int]) -> np.random.Generator:
    """numpy's generator of this seed, or that of the other inputs that are asked for."""
    return np.random.default_rng(np.add(seed, _APART * NUMBER))
