"""Contacts: frames, grasp map, merging of patches, positions on the mesh."""

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from gfo_env.contacts import RawContacts, contact_frames, grasp_map, merge
from gfo_env.contacts.contacts import PATCH_SIZE
from tests.support.seeds import seeded
from tests.support.shapes import off_surface
from tests.support.world import real_grasps

unit_normals = st.lists(st.floats(-1, 1), min_size=3, max_size=3).filter(
    lambda v: np.linalg.norm(v) > 1e-3
)


@given(unit_normals)
def test_frames_are_right_handed_with_the_normal_last(vector) -> None:
    normal = np.array([vector]) / np.linalg.norm(vector)
    (frame,) = contact_frames(normal)
    np.testing.assert_allclose(frame.T @ frame, np.eye(3), atol=1e-12)
    assert np.linalg.det(frame) == pytest.approx(1.0)
    np.testing.assert_array_equal(frame[:, 2], normal[0])


@given(st.integers(0, 2**32 - 1))
def test_grasp_map_sums_forces_and_moments(seed) -> None:
    rng = seeded(seed)
    positions = rng.normal(size=(4, 3))
    normals = rng.normal(size=(4, 3))
    frames = contact_frames(normals / np.linalg.norm(normals, axis=1, keepdims=True))
    forces = rng.normal(size=(4, 3))
    world = np.einsum("nij,nj->ni", frames, forces)
    expected = np.concatenate([world.sum(axis=0), np.cross(positions, world).sum(axis=0)])
    np.testing.assert_allclose(grasp_map(positions, frames) @ forces.ravel(), expected, atol=1e-12)


def raw(positions, normals, pressures, links) -> RawContacts:
    normals = np.array(normals, dtype=float)
    forces = normals * np.array(pressures, dtype=float)[:, None]
    return RawContacts(np.array(positions, dtype=float), normals, forces, np.array(links))


def test_merge_joins_one_patch_and_keeps_its_force_and_centre_of_pressure() -> None:
    up = [0.0, 0.0, 1.0]
    merged = merge(raw([[0, 0, 0], [0.004, 0, 0]], [up, up], [1.0, 3.0], [2, 2]), 8)
    assert merged.links.tolist() == [2]
    np.testing.assert_allclose(merged.positions, [[0.003, 0, 0]])
    np.testing.assert_allclose(merged.forces, [[0, 0, 4.0]])


@pytest.mark.parametrize(
    ("offset", "normal", "link"),
    [(2 * PATCH_SIZE, [0, 0, 1], 2), (0.001, [1, 0, 0], 2), (0.001, [0, 0, 1], 3)],
)
def test_merge_keeps_apart_what_differs(offset, normal, link) -> None:
    merged = merge(raw([[0, 0, 0], [offset, 0, 0]], [[0, 0, 1], normal], [2, 1], [2, link]), 8)
    assert len(merged.links) == 2


def test_merge_drops_the_weakest_and_those_that_barely_touch() -> None:
    count = 12
    positions = [[0.05 * i, 0, 0] for i in range(count)]
    pressures = [0.001, *range(1, count)]
    merged = merge(raw(positions, [[0, 0, 1]] * count, pressures, [1] * count), 8)
    np.testing.assert_allclose(merged.forces[:, 2], np.arange(11, 3, -1.0))
    nothing = merge(raw([[0, 0, 0]], [[0, 0, 1]], [0.001], [0]), 8)
    assert nothing.positions.shape == (0, 3)


def test_real_contacts_lie_on_the_mesh_and_press_inwards() -> None:
    for held in real_grasps(8):
        contacts, solid = held.grasp.contacts, held.grasp_object.solid
        # trimesh's own distances err by 1.7e-7 m for a point of a triangle that is thin
        assert off_surface(solid, contacts.positions).max() < 1e-9
        assert contacts.normal_forces.min() > 0
        assert len(set(contacts.links.tolist())) >= 3
        assert np.linalg.matrix_rank(contacts.grasp_map) == 6
        # a small way along the inward normal lies inside the object or along its surface
        inside = trimesh.proximity.signed_distance(
            solid, contacts.positions + 1e-4 * contacts.normals
        )
        assert np.mean(inside > -1e-4) > 0.8
