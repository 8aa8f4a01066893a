"""Packing a problem into an observation and back."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gfo_env.contacts import can_balance
from gfo_env.mdp.observation import pack, shapes, unpack
from solvers import GraspForceProblem, ProblemError
from tests.support.seeds import seeded


def fields_of(contacts: int, joints: int, seed: int) -> dict[str, np.ndarray]:
    rng = seeded(seed)
    fields = {
        name: rng.normal(size=shape).astype(np.float32).astype(np.float64)
        for name, shape in shapes(contacts, joints).items()
    }
    fields["contact_mask"][:] = 1.0
    return fields


@given(
    contacts=st.integers(0, 8),
    joints=st.integers(0, 9),
    seed=st.integers(0, 99),
    extra=st.integers(0, 3),
)
def test_unpack_inverts_pack(contacts: int, joints: int, seed: int, extra: int) -> None:
    width = max(1, contacts) + extra
    fields = fields_of(contacts, joints, seed)
    packed = pack(fields, shapes(width, joints))
    assert {array.ndim for array in packed.values()} == {1}
    assert {array.dtype for array in packed.values()} == {np.dtype(np.float32)}
    back = unpack(packed)
    for name, shape in shapes(width, joints).items():
        assert back[name].shape == shape
        inside = tuple(slice(size) for size in fields[name].shape)
        np.testing.assert_array_equal(back[name][inside], fields[name])
        # what was added is zero
        assert np.count_nonzero(back[name]) == np.count_nonzero(fields[name])


@given(seeds=st.lists(st.integers(0, 99), min_size=1, max_size=4))
def test_a_batch_unpacks_like_its_members(seeds: list[int]) -> None:
    packed = [pack(fields_of(3 + seed % 4, 8, seed), shapes(8, 8)) for seed in seeds]
    batch = unpack({name: np.stack([one[name] for one in packed]) for name in packed[0]})
    for index, one in enumerate(packed):
        for name, values in unpack(one).items():
            np.testing.assert_array_equal(batch[name][index], values)


def test_packed_arrays_are_new() -> None:
    fields = fields_of(8, 8, 0)
    first, second = (pack(fields, shapes(8, 8)) for _ in range(2))
    for name in fields:
        assert not np.shares_memory(first[name], second[name])
        assert not np.shares_memory(first[name], fields[name])


@given(seed=st.integers(0, 99), contacts=st.integers(2, 8), arm=st.floats(1e-4, 1e4))
def test_balance_needs_rank_six_in_any_unit_of_length(seed: int, contacts: int, arm: float) -> None:
    grasp_map = seeded(seed).normal(size=(6, 3 * contacts))
    grasp_map[3:] *= arm
    assert can_balance(grasp_map)
    assert can_balance(np.pad(grasp_map, ((0, 0), (0, 6))))
    flat = grasp_map.copy()
    flat[5] = flat[3] - 2.0 * flat[4]
    assert np.array_equal(can_balance(np.stack([grasp_map, flat])), [True, False])


@pytest.mark.parametrize("contacts", [0, 1, 3])
def test_no_contacts_balance_nothing(contacts: int) -> None:
    assert not can_balance(np.zeros((6, 3 * contacts)))


@given(seed=st.integers(0, 99), depth=st.floats(1e-12, 1e-1))
def test_what_can_be_balanced_is_a_valid_problem(seed: int, depth: float) -> None:
    rng = seeded(seed)
    grasp_map = rng.normal(size=(6, 9))
    grasp_map[5] = grasp_map[4] + depth * grasp_map[5]
    arguments = {
        "grasp_map": grasp_map,
        "hand_jacobian": np.zeros((9, 2)),
        "friction": np.ones(3),
        "torque_min": -np.ones(2),
        "torque_max": np.ones(2),
        "external_wrench": np.ones(6),
    }
    if can_balance(grasp_map):
        assert GraspForceProblem(**arguments).n_contacts == 3
    elif depth < 1e-11:
        with pytest.raises(ProblemError, match="rank"):
            GraspForceProblem(**arguments)
