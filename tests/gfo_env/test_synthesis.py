"""Improvement of a grasp's contacts: never worse, on the surface, by the quality's own word."""

from functools import cache

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from gfo_env.contacts import has_interior_internal_force, lowest_resisted_wrench
from gfo_env.exceptions import QualityError
from gfo_env.objects import Patches
from gfo_env.synthesis import EDGES, ContactPlan, Improvement, Route, improve
from solvers.arrays import Array
from solvers.exceptions import SolverError
from solvers.quality.friction_discs import FrictionDiscs, critical_directions
from solvers.synthesis import SynthesisStatus
from tests.support.facets import X, Y, Z, off_surface, points_on, random_facets
from tests.support.seeds import SEEDS, seeded
from tests.support.shapes import box
from tests.support.world import real_grasps

BOX = box((0.06, 0.05, 0.04))
LENGTH = float(np.linalg.norm(BOX.vertices, axis=1).max())
ROUTES: tuple[Route, ...] = ("bmi", "gradient")
every_route = pytest.mark.parametrize("route", ROUTES)

STARTS = {
    "pinched off centre": (
        [[0.03, 0.01, 0.005], [0.03, -0.012, 0.005], [-0.03, 0.0, -0.008]],
        [-X, -X, X],
        0.5,
    ),
    "three sides": (
        [[0.03, 0.008, 0.012], [-0.03, -0.008, 0.005], [0.01, 0.025, -0.01]],
        [-X, X, -Y],
        0.9,
    ),
    "not closed": (
        [[0.03, 0.01, 0.012], [-0.03, -0.008, 0.005], [0.01, 0.025, -0.01]],
        [-X, X, -Y],
        0.5,
    ),
    "one side": (
        [[0.03, 0.01, 0.01], [0.03, -0.01, 0.01], [0.03, 0.01, -0.01], [0.03, -0.01, -0.01]],
        [-X, -X, -X, -X],
        0.9,
    ),
    "one line": ([[0.03, 0, 0], [-0.03, 0, 0], [-0.03, 0, 0]], [-X, X, X], 0.5),
    "two contacts": ([[0.03, 0.01, 0], [-0.03, 0, 0]], [-X, X], 0.5),
}
every_start = pytest.mark.parametrize("start", STARTS)


def improved(start: str, route: Route) -> Improvement:
    positions, normals, friction = STARTS[start]
    contacts = (np.array(positions), np.array(normals), np.full(len(normals), friction))
    return improve(Patches(BOX), *contacts, LENGTH, route)


improved_once = cache(improved)


def assert_plan(
    plan: ContactPlan, mesh: trimesh.Trimesh, patches: Patches, friction: Array, length: float
) -> None:
    """On the patches, on the surface, and as good as `lowest_resisted_wrench` says."""
    for index, position, normal in zip(plan.patches, plan.positions, plan.normals, strict=True):
        assert_allclose(normal, patches[index].normal, rtol=0, atol=0)
        arms = patches[index].corners - position
        assert np.abs(arms @ normal).max() < 1e-6
        across = np.cross(np.roll(arms, -1, axis=0) - arms, arms) @ normal
        assert across.max() < 1e-6 * length or across.min() > -1e-6 * length
    assert off_surface(mesh, plan.positions).max() <= 1e-6
    quality = lowest_resisted_wrench(
        plan.positions, plan.normals, friction, edges=EDGES, length=length
    )
    assert plan.quality == quality.lower


def assert_improvement(
    result: Improvement, mesh: trimesh.Trimesh, patches: Patches, friction: Array, length: float
) -> None:
    """All that an improvement states."""
    for plan in (result.before, result.on_facets, result.after):
        assert_plan(plan, mesh, patches, friction, length)
        if plan.synthesis is not None:
            assert plan.synthesis.status is SynthesisStatus.SOLVED
            assert_allclose(plan.positions, plan.synthesis.positions, rtol=0, atol=0)
    assert result.before.quality <= result.on_facets.quality <= result.after.quality
    assert result.on_facets.patches == result.before.patches
    assert result.before.synthesis is None
    crossed = np.not_equal(result.after.patches, result.before.patches).sum()
    assert crossed <= result.hops
    assert result.hops > 0 or result.after is result.on_facets
    assert result.solves > 0
    assert result.seconds > 0


@every_route
@every_start
def test_improvements_hold_what_they_state(start: str, route: Route) -> None:
    result = improved_once(start, route)
    _, normals, friction = STARTS[start]
    assert_improvement(result, BOX, Patches(BOX), np.full(len(normals), friction), LENGTH)
    positions, normals, _ = STARTS[start]
    assert_allclose(result.before.positions, positions, atol=1e-12)
    assert_allclose(result.before.normals, normals, atol=1e-12)
    assert (result.first is None) is (route == "gradient")
    for plan in (result.on_facets, result.after):
        by_synthesis = route == "bmi" and plan is not result.before
        assert (plan.synthesis is not None) is by_synthesis


@pytest.mark.parametrize(
    ("start", "route", "least"),
    [
        ("pinched off centre", "gradient", 0.15),
        ("three sides", "bmi", 0.2),
        ("three sides", "gradient", 0.2),
        ("not closed", "bmi", 0.05),
    ],
)
def test_contacts_off_centre_are_moved_to_better_places(
    start: str, route: Route, least: float
) -> None:
    result = improved_once(start, route)
    assert result.before.quality < 0.05
    assert result.after.quality > least


def test_the_synthesis_closes_a_grasp_that_the_gradient_cannot_start_from() -> None:
    positions, normals, friction = STARTS["not closed"]
    assert not has_interior_internal_force(positions, normals, np.full(3, friction))
    first = improved_once("not closed", "bmi").first
    assert first is not None
    assert first.status is SynthesisStatus.SOLVED
    left = improved_once("not closed", "gradient")
    assert left.after is left.before
    assert left.after.quality == 0


@every_route
@pytest.mark.parametrize("start", ["one side", "two contacts"])
def test_hopeless_contacts_stay_where_they_are(start: str, route: Route) -> None:
    result = improved_once(start, route)
    assert result.after is result.before
    assert (result.after.quality, result.hops) == (0, 0)
    if start == "one side" and route == "bmi":
        assert result.first is not None
        assert result.first.status is SynthesisStatus.INFEASIBLE


@every_route
@pytest.mark.parametrize("start", ["pinched off centre", "not closed"])
def test_improvement_is_deterministic(start: str, route: Route) -> None:
    one, other = improved_once(start, route), improved(start, route)
    for plan, same in zip(
        (one.before, one.on_facets, one.after),
        (other.before, other.on_facets, other.after),
        strict=True,
    ):
        assert plan.patches == same.patches
        assert plan.quality == same.quality
        np.testing.assert_array_equal(plan.positions, same.positions)
    assert (one.hops, one.solves) == (other.hops, other.solves)


def test_a_contact_crosses_an_edge_where_that_helps() -> None:
    result = improved_once("three sides", "gradient")
    assert result.hops > 0
    assert result.after.patches != result.before.patches
    assert result.after.quality > 1.05 * result.on_facets.quality


@pytest.mark.parametrize("above", [-0.001, 0.0, 0.002, 0.03])
@pytest.mark.parametrize("normal", [-X, -Y, -Z])
def test_at_a_corner_the_normal_chooses_the_facet(normal: Array, above: float) -> None:
    """Contacts off the surface come to lie on it, however far; and on none but for being nearer."""
    corner = np.array([0.0299, 0.0249, 0.0199]) - above * normal
    others = np.array([[-0.03, 0.0, 0.0], [0.0, -0.025, 0.0], [0.0, 0.0, -0.02]])
    positions, normals = np.vstack([corner, others]), np.vstack([normal, X, Y, Z])
    patches = Patches(BOX)
    before = improve(patches, positions, normals, np.full(4, 0.5), LENGTH, "gradient").before
    assert_plan(before, BOX, patches, np.full(4, 0.5), LENGTH)
    assert_allclose(before.normals, normals, atol=1e-12)
    assert_allclose(before.positions[1:], others, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(("route", "count"), [("bmi", 1), ("gradient", 4)])
def test_contacts_of_real_grasps_are_improved(route: Route, count: int) -> None:
    gains: list[float] = []
    # four of seven did not close, on one draw
    for held in real_grasps(3 * count + 3):
        solid, contacts = held.grasp_object.solid, held.grasp.contacts
        length, friction = (
            float(np.linalg.norm(solid.vertices, axis=1).max()),
            np.full(len(contacts), 0.5),
        )
        patches = Patches(solid)
        result = improve(patches, contacts.positions, contacts.normals, friction, length, route)
        assert_improvement(result, solid, patches, friction, length)
        # a contact may have been on an edge, but no farther from the facet it is given
        moved = np.linalg.norm(result.before.positions - contacts.positions, axis=1)
        assert moved.max() < 0.003
        if result.before.quality == 0:  # a grasp that does not close
            continue
        gains.append(result.after.quality / result.before.quality)
        if len(gains) == count:
            break
    assert len(gains) == count
    assert min(gains) > 1.0
    assert np.mean(gains) > 1.05


# Critical directions


@settings(max_examples=30)
@given(
    seed=SEEDS,
    count=st.integers(3, 6),
    most=st.integers(1, 8),
    aligned=st.sampled_from([0.5, 0.9, 0.99]),
)
def test_critical_directions_are_the_nearest_facets(
    seed: int, count: int, most: int, aligned: float
) -> None:
    facets, rng = random_facets(seed, count), seeded(seed)
    contacts = (points_on(facets, rng), facets.normals, facets.friction)
    discs = FrictionDiscs.of_contacts(*contacts, np.ones(count), facets.length)
    directions = critical_directions(discs, 8, most, aligned)
    assert 1 <= len(directions) <= most
    assert_allclose(np.linalg.norm(directions, axis=1), 1.0, atol=1e-9)
    cosines = directions @ directions.T - 2.0 * np.eye(len(directions))
    assert cosines.max() < aligned
    # worst first, the hull containing the origin
    wrenches, _ = discs.pyramids(8)
    reach = np.maximum((wrenches @ directions.T).max(axis=0), 0.0)
    assert np.diff(reach).min(initial=0.0) >= -1e-7
    quality = lowest_resisted_wrench(*contacts, edges=8, length=facets.length)
    assert reach[0] == pytest.approx(quality.lower, abs=1e-7)
    # no other direction is reached less far
    others = rng.normal(size=(200, 6))
    others /= np.linalg.norm(others, axis=1, keepdims=True)
    assert (wrenches @ others.T).max(axis=0).min() >= reach[0] - 1e-7
    np.testing.assert_array_equal(directions, critical_directions(discs, 8, most, aligned))


@pytest.mark.parametrize(("count", "expected"), [(3, 3), (12, 12), (20, 12)])
def test_axes_stand_in_where_wrenches_do_not_span(count: int, expected: int) -> None:
    positions, normals, friction = STARTS["two contacts"]
    discs = FrictionDiscs.of_contacts(
        np.array(positions), np.array(normals), np.full(2, friction), np.ones(2), LENGTH
    )
    directions = critical_directions(discs, EDGES, count, 0.9)
    assert_allclose(directions, np.vstack([np.eye(6), -np.eye(6)])[:expected], rtol=0, atol=0)


def test_unknown_route_is_refused() -> None:
    with pytest.raises(SolverError, match="choose one of bmi, gradient"):
        improved("not closed", "downhill")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"positions": np.zeros((3, 2))}, r"positions must have shape \(n, 3\), not \(3, 2\)"),
        ({"normals": np.zeros((2, 3))}, r"normals must have shape \(3, 3\), not \(2, 3\)"),
        ({"normals": 2.0 * np.eye(3)}, "normals must have unit length"),
        ({"friction": 0.5}, r"friction must have shape \(3\), not \(\)"),
        ({"positions": np.full((3, 3), np.nan)}, "positions must be finite"),
    ],
)
def test_wrong_arrays_are_refused(change: dict[str, object], message: str) -> None:
    right = {"positions": np.eye(3), "normals": -np.eye(3), "friction": np.full(3, 0.5)}
    with pytest.raises(QualityError, match=message):
        improve(Patches(BOX), **right | change, length=LENGTH)  # type: ignore[arg-type]
