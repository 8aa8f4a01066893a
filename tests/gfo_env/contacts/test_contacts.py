"""Contacts: frames, grasp map, merging of patches, positions on the mesh."""

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from gfo_env.contacts import (
    Contacts,
    RawContacts,
    Surface,
    can_balance,
    closes,
    contact_frames,
    grasp_map,
    is_force_closure,
    merge,
    quality_estimate,
    read_contacts,
)
from gfo_env.contacts.contacts import PATCH_SIZE
from gfo_env.exceptions import GeometryError, QualityError
from gfo_env.simulation import Simulation
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


# -- what is no contact ----------------------------------------------------------------------------

ANGLES = np.deg2rad(72.0 * np.arange(5))
NORMALS = -np.stack([np.cos(ANGLES), np.sin(ANGLES), np.zeros(5)], axis=1)
POSITIONS = -0.04 * NORMALS
FRAMES = contact_frames(NORMALS)
MAP = grasp_map(POSITIONS, FRAMES)


def contacts_of(**changes: object) -> Contacts:
    arguments = {
        "positions": POSITIONS,
        "frames": FRAMES,
        "links": np.arange(5) - 1,
        "normal_forces": np.ones(5),
        "jacobian": np.zeros((15, 8)),
    }
    return Contacts(**arguments | changes)  # type: ignore[arg-type]


def raw_of(**changes: object) -> RawContacts:
    arguments = {
        "positions": POSITIONS,
        "normals": NORMALS,
        "forces": NORMALS,
        "links": np.arange(5) - 1,
    }
    return RawContacts(**arguments | changes)  # type: ignore[arg-type]


def read(links: list[int]) -> Contacts:
    held = real_grasps(1)[0]
    simulation = Simulation()
    simulation.load(held.grasp_object, held.grasp.pose, held.grasp.joint_angles, friction=1.0)
    surface, pose = Surface(held.grasp_object.solid), held.grasp.pose
    try:
        return read_contacts(raw_of(links=links), simulation.posture(), surface, pose)
    finally:
        simulation.close()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: grasp_map(POSITIONS.T, FRAMES), r"positions .*\(n, 3\), not \(3, 5\): transp"),
        (lambda: grasp_map(POSITIONS, FRAMES[:3]), r"frames .*\(5, 3, 3\), not \(3, 3, 3\)"),
        (lambda: grasp_map(POSITIONS[:3], FRAMES), r"frames .*\(3, 3, 3\), not \(5, 3, 3\)"),
        (lambda: grasp_map(POSITIONS.ravel(), FRAMES), r"positions .*\(n, 3\), not \(15,\)"),
        (lambda: grasp_map(POSITIONS, NORMALS), r"frames .*\(5, 3, 3\), not \(5, 3\)"),
        (lambda: grasp_map([POSITIONS] * 2, [FRAMES] * 2), r"not \(2, 5, 3\): one of a batch"),
        (lambda: grasp_map(np.nan * POSITIONS, FRAMES), "positions must be finite"),
        (lambda: grasp_map(None, FRAMES), "positions must be an array of numbers"),
        (lambda: contact_frames(NORMALS.T), r"normals .*\(n, 3\), not \(3, 5\): transpose it"),
        (lambda: contact_frames(NORMALS[0]), r"normals .*\(n, 3\), not \(3,\)"),
        (lambda: contact_frames(2.0 * NORMALS), "normals must have unit length"),
        (lambda: contact_frames(NORMALS[:3].T), "normals must have unit length"),
        (lambda: can_balance(MAP[:5]), r"grasp_map .*\(\.\.\., 6, 3n\), not \(5, 15\)"),
        (lambda: can_balance(MAP[:, :14]), r"grasp_map .*\(\.\.\., 6, 3n\), not \(6, 14\)"),
        (lambda: can_balance(np.inf * np.ones((6, 9))), "grasp_map must be finite"),
        (lambda: contacts_of(frames=FRAMES[:4]), r"frames .*\(5, 3, 3\), not \(4, 3, 3\)"),
        (lambda: contacts_of(jacobian=np.zeros((14, 8))), r"jacobian .*\(15, t\), not \(14, 8\)"),
        (lambda: contacts_of(links=np.arange(4)), r"links .*\(5\), not \(4,\)"),
        (lambda: contacts_of(links=np.arange(5) + 0.5), "links must be whole numbers"),
        (lambda: raw_of(forces=np.ones((4, 3))), r"forces .*\(5, 3\), not \(4, 3\)"),
        (lambda: raw_of(normals=np.full((5, 3), np.nan)), "normals must be finite"),
        (lambda: merge(raw_of(), -1), "limit must be a whole number >= 0, not -1"),
        (lambda: merge(raw_of(), 2.5), "limit must be a whole number >= 0"),  # type: ignore[arg-type]
        (lambda: read([0, 0, 0, 0, 8]), "links must lie between -1 and 7, .* not be 8"),
        (lambda: read([0, 0, 0, 0, -2]), "links must lie between -1 and 7, .* not be -2"),
        (lambda: closes(contacts_of(), -0.5), "friction must be a number >= 0, not -0.5"),
        (lambda: closes(contacts_of(), np.nan), "friction must be a number >= 0"),
        (lambda: Surface(trimesh.Trimesh()), "without triangles"),
        (lambda: Surface(trimesh.creation.box()).nearest(np.zeros(3)), r"points .*\(k, 3\)"),
        (lambda: Surface(trimesh.creation.box()).nearest([[np.inf, 0, 0]]), "must be finite"),
    ],
)
def test_wrong_arrays_are_named_and_never_read(call, message) -> None:
    with pytest.raises(GeometryError, match=message):
        call()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"grasp_map": MAP[:, :12]}, r"friction must have shape \(4\), not \(5,\)"),
        ({"grasp_map": MAP.T}, r"grasp_map must have shape \(6, 3n\), not \(15, 6\): transpose"),
        ({"friction": 0.5}, r"friction must have shape \(5\), not \(\)"),
        ({"friction": np.full(5, -0.1)}, "friction must be >= 0"),
        ({"normal_forces": np.ones(6)}, r"normal_forces must have shape \(5\), not \(6,\)"),
        ({"length": 0.0}, "length must be a positive number of metres, not 0.0"),
        ({"length": "1"}, "length must be a positive number of metres, not '1'"),
    ],
)
def test_an_estimate_of_wrong_arrays_is_refused(change, message) -> None:
    arguments = {
        "grasp_map": MAP,
        "friction": np.full(5, 0.5),
        "normal_forces": np.ones(5),
        "length": 0.04,
    }
    assert quality_estimate(**arguments) >= 0.0
    with pytest.raises(QualityError, match=message):
        quality_estimate(**arguments | change)


def test_contacts_keep_their_own_arrays() -> None:
    positions, frames = POSITIONS.copy(), np.asfortranarray(FRAMES)
    made = contacts_of(positions=positions, frames=frames, links=[0.0, 1.0, 2.0, 3.0, 4.0])
    positions[:], frames[:] = np.nan, np.nan
    np.testing.assert_array_equal(made.grasp_map, MAP)
    assert made.links.dtype == np.int64


def test_any_layout_of_memory_gives_the_same_map() -> None:
    for positions, frames in (
        (np.asfortranarray(POSITIONS), np.asfortranarray(FRAMES)),
        (POSITIONS.tolist(), FRAMES.tolist()),
        (np.repeat(POSITIONS, 2, axis=0)[::2], FRAMES),
        (np.broadcast_to(POSITIONS, (1, 5, 3))[0], FRAMES),
    ):
        np.testing.assert_array_equal(grasp_map(positions, frames), MAP)
    assert grasp_map(np.zeros((0, 3)), np.zeros((0, 3, 3))).shape == (6, 0)


@given(exponent=st.integers(-300, 300))
def test_balance_is_no_question_of_units(exponent: int) -> None:
    held = real_grasps(1)[0].grasp.contacts.grasp_map
    assert can_balance(held * 2.0**exponent)
    lying = held.copy()
    lying[2] = 0.0
    assert not can_balance(lying * 2.0**exponent)
    assert can_balance(np.stack([held, lying])).tolist() == [True, False]


def test_closure_without_friction_is_that_of_the_hull() -> None:
    corners = np.array([[1.0, 1, 1], [-1, 1, -1], [1, -1, -1], [-1, -1, 1]]) / 20.0
    sides = np.repeat(np.concatenate([np.eye(3), -np.eye(3)]), 4, axis=0)
    spots = np.concatenate(
        [
            0.05 * side + 0.5 * np.roll(corners, 1, 1) * (side == 0)
            for side in np.concatenate([np.eye(3), -np.eye(3)])
        ]
    )
    count = len(spots)
    jacobian, links = np.zeros((3 * count, 0)), np.zeros(count, dtype=np.int64)
    held = Contacts(spots, contact_frames(-sides), links, np.ones(count), jacobian)
    assert is_force_closure(held.positions, held.normals, np.zeros(count))
    assert closes(held, 0.0)
    assert not closes(contacts_of(), 0.0)


def test_contacts_that_cannot_balance_do_not_close() -> None:
    two = np.array([[0.02, 0.0, 0.0], [-0.02, 0.0, 0.0]])
    pinched = Contacts(two, contact_frames(-two / 0.02), np.zeros(2), np.ones(2), np.zeros((6, 0)))
    assert not closes(pinched, 5.0)
