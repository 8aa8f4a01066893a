"""Fast force closure gives the answers of the hull, and its memory never changes one."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gfo_env.contacts import Contacts, can_balance, closes, contact_frames, is_force_closure
from tests.support.seeds import seeded
from tests.support.world import real_grasps

GRASPS = 12


def fresh(contacts: Contacts, limit: int = 8) -> Contacts:
    """The same contacts, of which nothing is remembered."""
    n = min(limit, len(contacts))
    return Contacts(
        contacts.positions[:n].copy(),
        contacts.frames[:n],
        contacts.links[:n],
        contacts.normal_forces[:n],
        contacts.jacobian[: 3 * n],
    )


def by_hull(contacts: Contacts, friction: float) -> bool:
    frictions = np.full(len(contacts), friction)
    return is_force_closure(contacts.positions, contacts.normals, frictions)


def edge(contacts: Contacts) -> float:
    """The least friction with which the hull closes, to 1e-4; 3 if none below does."""
    low, high = 0.0, 3.0
    while high - low > 1e-4:
        middle = (low + high) / 2
        low, high = (low, middle) if by_hull(contacts, middle) else (middle, high)
    return high


def made_up(seed: int, count: int) -> Contacts:
    """Contacts all around a lumpy ball or, for every third seed, on one side of it."""
    rng = seeded(seed)
    outward = rng.normal(size=(count, 3))
    if seed % 3 == 0:
        outward[:, 2] = np.abs(outward[:, 2]) + 0.5
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    normals = -outward + 0.2 * rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    positions = outward * rng.uniform(0.02, 0.06, (count, 1))
    jacobian = np.zeros((3 * count, 0))
    links = np.zeros(count, dtype=np.int64)
    return Contacts(positions, contact_frames(normals), links, np.ones(count), jacobian)


@pytest.mark.parametrize("number", range(GRASPS))
def test_the_answer_of_the_hull_on_real_grasps(number: int) -> None:
    contacts = real_grasps(GRASPS)[number].grasp.contacts
    rng = seeded(number)
    limit = int(rng.integers(3, 9))
    asked = fresh(contacts, limit)
    if not can_balance(asked.grasp_map):
        asked = fresh(contacts)
    near = edge(asked)
    for friction in [*rng.uniform(0.05, 1.5, 8).tolist(), near + 0.01, max(near - 0.01, 1e-3)]:
        expected = by_hull(asked, friction)
        assert closes(fresh(asked), friction) is expected
        assert closes(asked, friction) is expected


@given(seed=st.integers(0, 2**20), count=st.integers(3, 8), friction=st.floats(0.05, 1.5))
@settings(max_examples=60)
def test_the_answer_of_the_hull_on_made_up_contacts(seed: int, count: int, friction: float) -> None:
    contacts = made_up(seed, count)
    if can_balance(contacts.grasp_map):
        assert closes(contacts, friction) is by_hull(contacts, friction)


@given(seed=st.integers(0, 2**20), data=st.data())
@settings(max_examples=40)
def test_memory_changes_no_answer(seed: int, data: st.DataObject) -> None:
    """Whatever was asked before, in whatever order, and again."""
    contacts = made_up(seed, 4 + seed % 4)
    asked = data.draw(st.lists(st.floats(0.05, 1.5), min_size=2, max_size=12))
    expected = {friction: closes(fresh(contacts), friction) for friction in asked}
    for friction in [*asked, *data.draw(st.permutations(asked))]:
        assert closes(contacts, friction) is expected[friction]
    # more friction never opens what less friction closes
    answers = [expected[friction] for friction in sorted(asked)]
    assert answers == sorted(answers)


def test_contacts_are_told_apart_and_forgotten() -> None:
    import gc

    from gfo_env.contacts.closure import _known

    closed, opened = made_up(1, 8), made_up(0, 8)
    assert closes(closed, 1.5)
    assert not closes(opened, 0.1)
    assert closes(closed, 1.5)
    before = len(_known)
    del closed, opened
    gc.collect()
    assert len(_known) <= before - 2


def test_no_friction_never_closes_and_much_of_it_does() -> None:
    contacts = real_grasps(GRASPS)[0].grasp.contacts
    assert not closes(fresh(contacts), 1e-9)
    assert closes(fresh(contacts), 5.0) is by_hull(contacts, 5.0)
