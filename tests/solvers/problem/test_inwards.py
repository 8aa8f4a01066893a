"""Limits moved inwards lie inside, by what was asked, and leave pinned values where they are."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from solvers.problem import ARRAY_FIELDS, moved_inwards
from tests.support.problems import uneven_batch
from tests.support.seeds import seeded


@given(st.integers(0, 2**32 - 1), st.sampled_from([1e-10, 1e-3, 0.5]))
def test_limits_move_inwards_by_what_is_asked_or_a_quarter_of_the_room(
    seed: int, share: float
) -> None:
    rng = seeded(seed)
    outer = uneven_batch(rng, 3, 4).pad(5)
    pinned = np.where(rng.random(outer.normal_min.shape) < 0.2, outer.normal_min, outer.normal_max)
    outer = outer.replace(normal_max=np.where(outer.contact_mask, pinned, np.inf))
    preload, torque = share * rng.uniform(0.0, 5.0, 5), share * rng.uniform(0.0, 5.0, (2, 3, 8))
    inner = moved_inwards(outer, share, preload, tuple(torque))
    np.testing.assert_array_equal(inner.friction, outer.friction * (1.0 - share))
    room = outer.normal_max - outer.normal_min
    given_force, padding = room == 0.0, ~outer.contact_mask
    for name in ("normal_min", "normal_max"):
        moved, true = getattr(inner, name), getattr(outer, name)
        np.testing.assert_array_equal(moved[given_force | padding], true[given_force | padding])
    up = inner.normal_min - outer.normal_min
    finite = np.isfinite(outer.normal_max)
    down = np.where(finite, outer.normal_max, 0.0) - np.where(finite, inner.normal_max, 0.0)
    most = np.where(np.isfinite(room), 0.25 * room, np.inf)
    expected = np.where(padding, 0.0, np.minimum(preload, most))
    np.testing.assert_allclose(up, expected, rtol=1e-9, atol=1e-14)
    expected = np.minimum(share * np.where(finite, outer.normal_max, 0.0), most)
    np.testing.assert_allclose(down, expected, rtol=1e-9, atol=1e-14)
    width = 0.25 * (outer.torque_max - outer.torque_min)
    for name, shift, sign in (("torque_min", torque[0], 1.0), ("torque_max", torque[1], -1.0)):
        expected = getattr(outer, name) + sign * np.minimum(shift, width)
        np.testing.assert_array_equal(getattr(inner, name), expected)


def test_arrays_and_tensors_are_moved_alike() -> None:
    outer = uneven_batch(seeded(1), 20, 4)
    shifts = 0.1 * np.abs(np.nan_to_num(outer.torque_min, posinf=1.0, neginf=1.0))
    ours = moved_inwards(outer, 0.1, 0.1 * outer.normal_min, (shifts, shifts))
    twin = outer.to_torch()
    tensor = twin.torque_min.new_tensor(shifts)
    theirs = moved_inwards(twin, 0.1, 0.1 * twin.normal_min, (tensor, tensor))
    for name in ARRAY_FIELDS:
        np.testing.assert_array_equal(getattr(theirs, name).numpy(), getattr(ours, name))
