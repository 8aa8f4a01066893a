"""Facets: local coordinates, sides and grasp maps against their definitions; every refusal."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from gfo_env.contacts import grasp_map
from solvers import ProblemError
from solvers.arrays import Array
from solvers.synthesis import ContactFacets
from tests.support.facets import LENGTH, outside, points_on, random_facets
from tests.support.seeds import SEEDS, seeded

COUNTS = st.integers(1, 6)
SQUARE = np.array([[1.0, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]])
UNITS = np.repeat([1.0, 1.0 / LENGTH], 3)


def facets_of(*rings: Any, **changes: Any) -> ContactFacets:
    """Facets in planes z = constant."""
    count = len(rings)
    settings = {
        "corners": rings,
        "normals": np.tile([0.0, 0.0, 1.0], (count, 1)),
        "friction": np.ones(count),
        "length": 1.0,
    }
    return ContactFacets(**(settings | changes))


def farthest_beyond(facets: ContactFacets, index: int, local: Array) -> Array:
    """(k,) how far local coordinates (k, 2) lie beyond the sides of a facet; negative inside."""
    sides, bounds = facets.sides[index]
    return (local @ sides.T - bounds).max(axis=1)


# Coordinates


@given(seed=SEEDS, count=COUNTS)
def test_local_coordinates_and_positions_are_each_others_inverse(seed: int, count: int) -> None:
    facets, rng = random_facets(seed, count), seeded(seed)
    local = rng.uniform(-2.0, 2.0, (count, 2))
    positions = facets.positions(local)
    assert_allclose(facets.local(positions), local, atol=1e-12)
    off_plane = np.einsum("ni,ni->n", positions - facets.centre, facets.normals)
    assert_allclose(off_plane, 0.0, atol=1e-15)
    # what is off the plane is projected on it
    lifted = positions + rng.normal(size=(count, 1)) * facets.normals
    assert_allclose(facets.positions(facets.local(lifted)), positions, atol=1e-12)


@given(seed=SEEDS, count=COUNTS)
def test_corners_have_local_coordinates_up_to_one(seed: int, count: int) -> None:
    facets = random_facets(seed, count)
    for index, ring in enumerate(facets.corners):
        repeated = [facets.local(np.tile(corner, (count, 1)))[index] for corner in ring]
        size = np.linalg.norm(repeated, axis=1)
        assert size.max() == pytest.approx(1.0)
        assert_allclose(np.mean(repeated, axis=0), 0.0, atol=1e-12)


@given(seed=SEEDS, count=COUNTS)
def test_frames_are_right_handed_with_the_normal_last(seed: int, count: int) -> None:
    facets = random_facets(seed, count)
    frames = facets.frames
    assert_allclose(
        np.swapaxes(frames, 1, 2) @ frames, np.tile(np.eye(3), (count, 1, 1)), atol=1e-9
    )
    assert_allclose(np.linalg.det(frames), 1.0)
    assert_allclose(frames[:, :, 2], facets.normals, rtol=0, atol=0)
    first = np.array([ring[0] for ring in facets.corners]) - facets.centre
    assert_allclose(
        np.einsum("ni,ni->n", frames[:, :, 0], first), np.linalg.norm(first, axis=1), rtol=1e-9
    )


# Sides


@given(seed=SEEDS, count=COUNTS)
def test_sides_bound_the_polygon_and_no_more(seed: int, count: int) -> None:
    facets, rng = random_facets(seed, count), seeded(seed)
    for index, ring in enumerate(facets.corners):
        sides, bounds = facets.sides[index]
        assert_allclose(np.linalg.norm(sides, axis=1), 1.0)
        corners = (ring - facets.centre[index]) @ facets.frames[index][:, :2] / facets.size[index]
        # two corners lie on every side, all others within it
        gaps = np.sort(bounds[:, None] - sides @ corners.T, axis=1)
        assert_allclose(gaps[:, :2], 0.0, atol=1e-12)
        assert (gaps[:, 2] > 1e-6).all()
        inside = rng.dirichlet(np.ones(len(ring)), 20) @ corners
        assert farthest_beyond(facets, index, inside).max() <= 1e-12
        middles = 0.5 * (corners + np.roll(corners, -1, axis=0))
        assert_allclose(farthest_beyond(facets, index, middles), 0.0, atol=1e-12)
        assert farthest_beyond(facets, index, 1.001 * middles).min() > 0


@given(seed=SEEDS)
def test_sides_agree_with_the_corners_about_any_point(seed: int) -> None:
    facets, rng = random_facets(seed, 3), seeded(seed)
    for local in rng.uniform(-1.0, 1.0, (20, 3, 2)):
        beyond = max(float(farthest_beyond(facets, i, local[i : i + 1])[0]) for i in range(3))
        assert (beyond > 0) == (outside(facets, facets.positions(local)) > 1e-12)


@given(seed=SEEDS, count=COUNTS)
def test_the_order_of_the_corners_is_no_matter(seed: int, count: int) -> None:
    one, rng = random_facets(seed, count), seeded(seed)
    # the same first corner, and so the same frame
    turned = tuple(np.roll(ring[::-1], 1, axis=0) for ring in one.corners)
    other = ContactFacets(turned, one.normals, one.friction, one.length)
    assert_allclose(other.frames, one.frames)
    for index in range(count):
        local = rng.uniform(-1.2, 1.2, (50, 2))
        assert_allclose(
            farthest_beyond(one, index, local), farthest_beyond(other, index, local), atol=1e-12
        )


# Grasp maps


@given(seed=SEEDS, count=COUNTS)
def test_grasp_map_is_that_of_contacts_with_these_frames(seed: int, count: int) -> None:
    facets = random_facets(seed, count)
    positions = points_on(facets, seeded(seed))
    assert_allclose(
        facets.grasp_map(positions), grasp_map(positions, facets.frames), rtol=0, atol=0
    )


@given(seed=SEEDS, count=COUNTS)
def test_grasp_map_is_affine_in_local_coordinates(seed: int, count: int) -> None:
    facets, rng = random_facets(seed, count), seeded(seed)
    local = rng.uniform(-1.0, 1.0, (count, 2))
    affine = facets.base + np.einsum("na,naij->nij", local, facets.slope)
    expected = UNITS[:, None] * facets.grasp_map(facets.positions(local))
    assert_allclose(affine.transpose(1, 0, 2).reshape(6, -1), expected, atol=1e-12)
    assert_allclose(facets.slope[:, :, :3], 0.0, rtol=0, atol=0)


@given(seed=SEEDS, count=COUNTS)
def test_corner_maps_are_grasp_maps_at_the_corners(seed: int, count: int) -> None:
    facets = random_facets(seed, count)
    for index, ring in enumerate(facets.corners):
        maps = facets.corner_maps(index)
        assert maps.shape == (len(ring), 6, 3)
        for corner, found in zip(ring, maps, strict=True):
            expected = facets.grasp_map(np.tile(corner, (count, 1)))[:, 3 * index : 3 * index + 3]
            assert_allclose(found, UNITS[:, None] * expected, atol=1e-9)


# Refusals


ANGLES = 2 * np.pi * np.arange(5) / 5
PENTAGON = np.stack([np.cos(ANGLES), np.sin(ANGLES), np.zeros(5)], axis=1)
FOLDED = SQUARE + np.array([[0, 0, 0.1], [0, 0, 0], [0, 0, 0.1], [0, 0, 0]])
NOT_CONVEX = "facet 1 is not convex, or has no area"


@pytest.mark.parametrize(
    ("ring", "message"),
    [
        pytest.param(FOLDED, "facet 1 is not flat", id="folded"),
        pytest.param(SQUARE[[0, 1, 3, 2]], NOT_CONVEX, id="bow tie"),
        pytest.param(PENTAGON[[0, 2, 4, 1, 3]], "corners are not in order", id="pentagram"),
        pytest.param([[0, 0, 0], [2, 2, 0], [0, 1, 0], [-2, 2, 0]], NOT_CONVEX, id="hollow"),
        pytest.param(
            [[0, 0, 0], [1, -1, 0], [0, 2, 0], [-1, -1, 0]], NOT_CONVEX, id="centre is a corner"
        ),
        pytest.param([[0, 0, 0], [1, 0, 0], [3, 0, 0]], NOT_CONVEX, id="line"),
        pytest.param(np.ones((4, 3)), NOT_CONVEX, id="point"),
        pytest.param(SQUARE[[0, 0, 1, 2, 3]], "two corners in one place", id="double corner"),
        pytest.param(SQUARE[:2], "facet 1 needs three corners or more", id="two corners"),
        pytest.param(SQUARE[:, :2], "facet 1 needs three corners or more", id="in the plane"),
        pytest.param(np.where(SQUARE > 0, np.nan, SQUARE), "corners of facet 1 must be finite"),
        pytest.param(np.where(SQUARE > 0, np.inf, SQUARE), "corners of facet 1 must be finite"),
    ],
)
def test_malformed_polygons_are_refused_by_number(ring: Any, message: str) -> None:
    for rings in ((SQUARE, ring), (SQUARE, ring, SQUARE)):
        with pytest.raises(ProblemError, match=message):
            facets_of(*rings)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"normals": [[0.0, 0, 2]]}, "normals must have unit length"),
        ({"normals": [[0.0, 0, 0]]}, "normals must have unit length"),
        ({"normals": [[0.0, 0.6, 0.8]]}, "its normal is not normal to it"),
        ({"normals": [[0.0, 0, np.nan]]}, "normals must be finite"),
        ({"normals": [0.0, 0, 1]}, r"normals must have shape \(1, 3\)"),
        ({"friction": [0.0]}, "friction must be positive"),
        ({"friction": [-0.5]}, "friction must be positive"),
        ({"friction": [np.nan]}, "friction must be finite"),
        ({"friction": [0.5, 0.5]}, r"friction must have shape \(1,\)"),
        ({"length": 0.0}, "length must be a positive number of metres, not 0.0"),
        ({"length": -1.0}, "length must be a positive"),
        ({"length": np.inf}, "length must be a positive"),
        ({"length": np.nan}, "length must be a positive"),
    ],
)
def test_malformed_numbers_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ProblemError, match=message):
        facets_of(SQUARE, **changes)


def test_no_facets_are_refused() -> None:
    with pytest.raises(ProblemError, match="there are no facets"):
        facets_of(normals=np.zeros((0, 3)))


@given(seed=SEEDS, size=st.sampled_from([1e-3, 1.0, 1e3]))
def test_round_off_is_no_fold_whatever_the_size(seed: int, size: float) -> None:
    noise = seeded(seed).uniform(-1.0, 1.0, 4)[:, None] * [0.0, 0.0, 1.0]
    assert len(facets_of(size * (SQUARE + 1e-6 * noise))) == 1
    with pytest.raises(ProblemError, match="not flat"):
        facets_of(size * (SQUARE + 1e-3 * (FOLDED - SQUARE)))


def test_arrays_become_float64_whatever_they_were() -> None:
    facets = facets_of(SQUARE.astype(int).tolist(), friction=[1])
    assert (facets.corners[0].dtype, facets.friction.dtype) == (np.float64, np.float64)
    assert len(facets) == 1
