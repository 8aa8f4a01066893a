"""The reach along loads, its derivative by the positions, and the ascent along it."""

import cvxpy as cp
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from gfo_env.contacts import is_force_closure, lowest_resisted_wrench
from solvers import SolverError
from solvers.arrays import Array
from solvers.quality.friction_discs import FrictionDiscs, critical_directions
from solvers.synthesis import ContactFacets, ascend
from solvers.synthesis.ascent import reaches
from tests.support.facets import (
    LENGTH,
    X,
    Y,
    Z,
    box_facets,
    feet,
    outside,
    points_on,
    random_facets,
    random_loads,
)
from tests.support.problems import random_rotation
from tests.support.seeds import SEEDS, seeded

COUNTS = st.integers(3, 5)
UNITS = np.repeat([1.0, 1.0 / LENGTH], 3)


def closed_grasp(seed: int, count: int) -> tuple[ContactFacets, Array, np.random.Generator]:
    """Facets, and positions on them that can resist every wrench."""
    facets, rng = random_facets(seed, count), seeded(seed)
    positions = points_on(facets, rng)
    assume(is_force_closure(positions, facets.normals, facets.friction))
    return facets, positions, rng


def gauge(facets: ContactFacets, positions: Array, load: Array) -> float:
    """The largest t with t d in the hull of what unit normal forces can do; another program."""
    n = len(facets)
    forces, reach = cp.Variable((n, 3)), cp.Variable()
    carried = UNITS[:, None] * facets.grasp_map(positions) @ cp.vec(forces, order="C")
    limits = cp.multiply(facets.friction, forces[:, 2])
    constraints = [carried == reach * load, cp.norm(forces[:, :2], axis=1) <= limits]
    program = cp.Problem(cp.Maximize(reach), [*constraints, cp.sum(forces[:, 2]) <= 1])
    return float(program.solve(solver=cp.CLARABEL))


# Reaches


@settings(max_examples=30)
@given(seed=SEEDS, count=COUNTS)
def test_reach_is_the_gauge_of_the_wrenches_at_unit_normal_force(seed: int, count: int) -> None:
    facets, positions, rng = closed_grasp(seed, count)
    loads = random_loads(rng, 2)
    values, _ = reaches(facets, positions, loads)
    for load, value in zip(loads, values, strict=True):
        assert value == pytest.approx(gauge(facets, positions, load), abs=1e-6)


@settings(max_examples=30)
@given(seed=SEEDS, count=COUNTS)
def test_no_direction_is_carried_less_far_than_the_lowest_resisted_wrench(
    seed: int, count: int
) -> None:
    """q_lrw <= reach <= support along a direction; along the nearest facet's all are close."""
    facets, positions, rng = closed_grasp(seed, count)
    contacts = (positions, facets.normals, facets.friction)
    quality = lowest_resisted_wrench(*contacts, length=LENGTH, edges=16)
    discs = FrictionDiscs.of_contacts(*contacts, np.ones(count), LENGTH)
    critical = critical_directions(discs, 16, 4, 0.9)
    values, _ = reaches(facets, positions, np.vstack([critical, random_loads(rng, 4)]))
    assert values.min() >= quality.lower * (1 - 1e-6)
    supports = discs.support(critical).max(axis=1)
    assert (values[: len(critical)] <= supports * (1 + 1e-6)).all()
    # sixteen edges inscribed in a circle give away 2 per cent of its radius
    assert supports[0] <= quality.lower + 0.02 * np.linalg.norm(discs.spans, axis=(1, 2)).max()


@settings(max_examples=30)
@given(seed=SEEDS, count=COUNTS)
def test_derivative_agrees_with_central_differences(seed: int, count: int) -> None:
    """In all directions, along the normals too, which facets do not allow."""
    facets, positions, rng = closed_grasp(seed, count)
    loads = random_loads(rng, 2)
    values, slopes = reaches(facets, positions, loads)
    assume(values.min() > 0.02)
    assert slopes.shape == (2, count, 3)
    step = 1e-5 * LENGTH
    for _ in range(3):
        way = rng.normal(size=positions.shape)
        ahead, _ = reaches(facets, positions + step * way, loads)
        behind, _ = reaches(facets, positions - step * way, loads)
        # at a kink neither side is the derivative
        smooth = np.abs(ahead - 2 * values + behind) < 1e-3 * np.abs(ahead - behind) + 1e-9
        change = np.einsum("kni,ni->k", slopes, way)
        expected = (ahead - behind) / (2 * step)
        scale = np.linalg.norm(slopes, axis=(1, 2)) + 1.0
        assert (np.abs(change - expected)[smooth] <= 1e-3 * scale[smooth]).all()
        assert smooth.any() or values.min() < 0.1


@settings(max_examples=20)
@given(seed=SEEDS, count=COUNTS)
def test_reach_depends_on_no_frame_or_unit(seed: int, count: int) -> None:
    facets, positions, rng = closed_grasp(seed, count)
    loads, rotation = random_loads(rng, 2), random_rotation(rng)
    values, slopes = reaches(facets, positions, loads)
    assume(values.min() > 1e-3)
    turned = ContactFacets(
        tuple(ring @ rotation.T for ring in facets.corners),
        facets.normals @ rotation.T,
        facets.friction,
        LENGTH,
    )
    turned_values, turned_slopes = reaches(
        turned, positions @ rotation.T, loads @ np.kron(np.eye(2), rotation).T
    )
    assert_allclose(turned_values, values, rtol=1e-6)
    scale = np.abs(slopes).max()
    assert_allclose(turned_slopes, slopes @ rotation.T, atol=1e-3 * scale)
    larger = ContactFacets(
        tuple(10.0 * ring for ring in facets.corners), facets.normals, facets.friction, 10 * LENGTH
    )
    larger_values, larger_slopes = reaches(larger, 10.0 * positions, loads)
    assert_allclose(larger_values, values, rtol=1e-6)
    assert_allclose(10.0 * larger_slopes, slopes, atol=1e-3 * scale)
    # half as far along a load twice as long
    assert_allclose(reaches(facets, positions, 2.0 * loads)[0], 0.5 * values, rtol=1e-6)


def test_loads_are_independent_and_some_cannot_be_carried() -> None:
    """Three contacts above push down, whatever they do."""
    facets = box_facets(np.array([-Z, -Z, -Z]), 0.5)
    positions = facets.centre + np.array([0.01 * X, -0.01 * X, 0.01 * Y])
    loads = np.array([[0, 0, -1.0, 0, 0, 0], [0, 0, 1.0, 0, 0, 0], [0, 0, -2.0, 0, 0, 0]])
    values, slopes = reaches(facets, positions, loads)
    assert values[0] == pytest.approx(2.0 * values[2])
    assert values[0] > 0.5
    assert values[1] == 0.0
    assert (slopes[1] == 0.0).all()
    assert np.isfinite(slopes).all()


@pytest.mark.parametrize("count", [1, 2, 3])
def test_nothing_is_carried_from_one_line(count: int) -> None:
    facets = box_facets(np.array([X, -X, -X])[:count], 0.5)
    values, slopes = reaches(facets, feet(facets), np.eye(6))
    assert (values == 0).all()
    assert (slopes == 0).all()
    with pytest.raises(SolverError, match="cannot be carried where the ascent starts"):
        ascend(facets, np.eye(6), feet(facets))


# Ascent


@settings(max_examples=15)
@given(seed=SEEDS, count=COUNTS)
def test_ascent_never_lowers_the_smallest_reach(seed: int, count: int) -> None:
    facets, positions, rng = closed_grasp(seed, count)
    loads = random_loads(rng, 3)
    before = reaches(facets, positions, loads)[0].min()
    assume(before > 1e-3)
    result = ascend(facets, loads, positions)
    assert result.first_reach == pytest.approx(before, rel=1e-9)
    assert result.reach >= result.first_reach
    assert result.reach == pytest.approx(
        reaches(facets, result.positions, loads)[0].min(), rel=1e-6
    )
    assert outside(facets, result.positions) <= 1e-6 * LENGTH
    assert result.evaluations % 3 == 0
    assert result.evaluations >= 3


def test_ascent_gains_a_lot_from_a_poor_start() -> None:
    gains = []
    for seed in range(8):
        facets, rng = random_facets(seed, 4), seeded(seed)
        result = ascend(facets, random_loads(rng, 2), facets.centre)
        gains.append(result.reach / result.first_reach)
    assert min(gains) >= 1.0
    assert np.median(gains) > 1.2


@pytest.mark.parametrize("loaded", range(4))
def test_ascent_moves_one_contact_towards_the_foot_of_the_origin(loaded: int) -> None:
    """There it carries its load alone, and the reach is one; the ascent may stop at a kink."""
    facets = box_facets(np.array([X, -X, Y, -Y]), 0.5)
    load = np.append(facets.normals[loaded], np.zeros(3))[None]
    result = ascend(facets, load, facets.centre)
    assert result.reach <= 1.0 + 1e-9
    assert 1.0 - result.reach < 0.5 * (1.0 - result.first_reach)


def test_ascent_stays_at_an_optimum() -> None:
    facets = box_facets(np.array([X, -X, Y, -Y]), 0.5)
    loads = np.hstack([facets.normals, np.zeros((4, 3))])
    result = ascend(facets, loads, feet(facets))
    assert result.reach == pytest.approx(1.0, abs=1e-6)
    assert_allclose(result.positions, feet(facets), atol=1e-6)


def test_ascent_is_deterministic() -> None:
    facets, loads = random_facets(5, 4), random_loads(seeded(5), 3)
    one, other = (ascend(facets, loads, facets.centre) for _ in range(2))
    np.testing.assert_array_equal(one.positions, other.positions)
    assert (one.reach, one.evaluations) == (other.reach, other.evaluations)


def test_ascent_needs_a_start_that_carries_every_load() -> None:
    facets = box_facets(np.array([-Z, -Z, -Z]), 0.5)
    positions = facets.centre + np.array([0.01 * X, -0.01 * X, 0.01 * Y])
    with pytest.raises(SolverError, match="no gradient to follow"):
        ascend(facets, np.vstack([np.eye(6)[2], -np.eye(6)[2]]), positions)
