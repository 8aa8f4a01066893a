"""Contact synthesis: what a solved one states, optima known beforehand, proofs of infeasibility."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from gfo_env.contacts import has_interior_internal_force
from solvers.arrays import Array
from solvers.synthesis import (
    GRASP_MATRIX_FLOOR,
    ContactFacets,
    ContactSynthesis,
    SynthesisStatus,
    internal_work,
    synthesise,
)
from solvers.synthesis.ascent import reaches
from solvers.synthesis.lifted import INTERIOR_FRICTION, INTERIOR_PRELOAD
from solvers.synthesis.rank_one import RANK_ONE, RESIDUAL, separating_wrench
from tests.support.facets import (
    LENGTH,
    X,
    Y,
    Z,
    box_facets,
    even_internal_forces,
    feet,
    least_eigenvalue,
    outside,
    points_on,
    random_facets,
    random_loads,
)
from tests.support.seeds import SEEDS, seeded

COUNTS = st.integers(3, 5)
NO_LOADS = np.zeros((0, 6))
UNITS = np.repeat([1.0, 1.0 / LENGTH], 3)


def assert_solved(facets: ContactFacets, loads: Array, result: ContactSynthesis) -> None:
    """All that a solved synthesis states, measured anew."""
    n = len(facets)
    assert (result.status, result.message) == (SynthesisStatus.SOLVED, "")
    assert result.residual <= RESIDUAL
    assert result.eigenvalue_ratio <= RANK_ONE
    assert np.isnan(result.separating_wrench).all()
    assert outside(facets, result.positions) <= 1e-6 * LENGTH
    assert least_eigenvalue(facets, result.positions) >= GRASP_MATRIX_FLOOR - 1e-6
    forces = result.forces.reshape(1 + len(loads), n, 3)
    normal, tangential = forces[..., 2], np.linalg.norm(forces[..., :2], axis=-1)
    # strictly inside the cones, and within them
    assert (tangential[0] <= INTERIOR_FRICTION * facets.friction * normal[0] + 1e-6).all()
    assert normal[0].min() >= INTERIOR_PRELOAD - 1e-6
    assert normal[0].sum() == pytest.approx(n, rel=1e-6)
    assert (tangential[1:] <= facets.friction * normal[1:] + 1e-6).all()
    assert (normal[1:].sum(axis=1) <= n * (1 + 1e-6)).all()
    # the internal forces cancel, the others carry the reach along their loads
    wrenches = UNITS * (result.forces @ facets.grasp_map(result.positions).T)
    assert_allclose(wrenches[0], 0.0, atol=1e-6)
    if len(loads):
        assert_allclose(wrenches[1:], n * result.reach * loads, atol=1e-6)
        assert result.reach <= result.relaxation + 1e-6
        # at these positions the forces alone carry no less
        assert result.reach <= reaches(facets, result.positions, loads)[0].min() + 1e-6
    else:
        assert np.isnan([result.reach, result.relaxation]).all()


@pytest.mark.parametrize("loads", [0, 1, 3])
@pytest.mark.parametrize("count", [3, 4, 5])
def test_solved_syntheses_hold_what_they_state(count: int, loads: int) -> None:
    directions = random_loads(seeded(count), loads)
    # the method is local: it fails on one in five facets of three contacts with three loads (on
    # none in twelve of the others), and says so; of eight, one will do
    for draw in range(8):
        facets = random_facets(10 * count + loads + 100 * draw, count)
        result = synthesise(facets, directions)
        if result.status is not SynthesisStatus.FAILED:
            break
        assert result.message
    assert_solved(facets, directions, result)


@pytest.mark.parametrize("count", [3, 4, 6])
@pytest.mark.parametrize("friction", [0.2, 0.6])
def test_contacts_find_the_feet_of_the_origin(count: int, friction: float) -> None:
    """To carry a force along each contact's own normal, the one best place is under the origin.

    No force of the others has as much along that normal per newton, for mu < 1. So the reach is at
    most one, and one only if the contact carries the load alone, which then must pass through it.
    """
    facets = box_facets(np.array([X, -X, Y, -Y, Z, -Z])[:count], friction)
    loads = np.hstack([facets.normals, np.zeros((count, 3))])
    assert reaches(facets, facets.centre, loads)[0].min() < 0.95
    result = synthesise(facets, loads)
    assert_solved(facets, loads, result)
    assert result.reach == pytest.approx(1.0, abs=1e-6)
    assert result.relaxation == pytest.approx(1.0, abs=1e-6)
    assert_allclose(result.positions, feet(facets), atol=1e-6)


def test_synthesis_is_deterministic() -> None:
    facets = random_facets(2, 3)
    loads = random_loads(seeded(2), 2)
    one, other = synthesise(facets, loads), synthesise(facets, loads)
    np.testing.assert_array_equal(one.positions, other.positions)
    np.testing.assert_array_equal(one.forces, other.forces)
    assert (one.reach, one.steps) == (other.reach, other.steps)


def test_two_contacts_are_no_grasp_and_no_error() -> None:
    """Internal forces between them cancel, so that nothing is proved; but G has rank 5."""
    result = synthesise(box_facets(np.array([X, -X]), 0.5), NO_LOADS)
    assert result.status is SynthesisStatus.FAILED
    assert result.residual == pytest.approx(GRASP_MATRIX_FLOOR)
    assert "residual" in result.message
    assert separating_wrench(box_facets(np.array([X, -X]), 0.5)) is None


# Proofs


@cache
def one_sided() -> ContactFacets:
    """Three contacts on the upper half of a ball."""
    tilted = np.array([Z + 0.5 * X, Z - 0.5 * X, Z + 0.5 * Y]) / np.sqrt(1.25)
    turns = [np.linalg.svd(normal[None])[2][1:] for normal in tilted]
    ring = np.array([[1.0, 0], [0, 1], [-1, -1]])
    corners = tuple(0.01 * ring @ turn - 0.03 * n for turn, n in zip(turns, tilted, strict=True))
    return ContactFacets(corners, tilted, np.full(3, 0.3), LENGTH)


def out_of_line(friction: float) -> ContactFacets:
    """Two facets above, to the right, and one below, to the left, which no force line joins."""
    square = 0.005 * np.array([[1.0, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]])
    corners = tuple(square + 0.01 * np.array(c) for c in ([2, 1, 1], [2, -1, 1], [-2, 0, -1]))
    return ContactFacets(corners, np.array([-Z, -Z, Z]), np.full(3, friction), LENGTH)


def permitted_forces(facets: ContactFacets, rng: np.random.Generator) -> Array:
    """(3n,) random internal forces inside their margins, often at their edge."""
    n = len(facets)
    shares = rng.dirichlet(np.full(n, rng.choice([0.1, 1.0])))
    normal = INTERIOR_PRELOAD + n * (1.0 - INTERIOR_PRELOAD) * shares
    angles = rng.uniform(0.0, 2 * np.pi, n)
    slip = INTERIOR_FRICTION * facets.friction * normal * rng.choice([1.0, rng.random()])
    return np.stack([slip * np.cos(angles), slip * np.sin(angles), normal], axis=1).ravel()


@settings(max_examples=50)
@given(seed=SEEDS, count=COUNTS)
def test_internal_work_is_the_most_that_any_forces_do(seed: int, count: int) -> None:
    facets, rng = random_facets(seed, count), seeded(seed)
    direction = random_loads(rng, 1)[0]
    most, found = internal_work(facets, direction), -np.inf
    for _ in range(50):
        at_corners = np.array([ring[rng.integers(len(ring))] for ring in facets.corners])
        for positions in (points_on(facets, rng), at_corners):
            wrench = UNITS * (facets.grasp_map(positions) @ permitted_forces(facets, rng))
            found = max(found, float(direction @ wrench))
    assert found <= most + 1e-9
    # ... and attained: all that is free at one contact's best corner, the rest at their own
    best = []
    for index in range(count):
        pushes = np.einsum("d,kdc->kc", direction, facets.corner_maps(index))
        slip = INTERIOR_FRICTION * facets.friction[index]
        best.append(float(np.max(pushes[:, 2] + slip * np.linalg.norm(pushes[:, :2], axis=1))))
    assert most == pytest.approx(0.05 * sum(best) + 0.95 * count * max(best))


@pytest.mark.parametrize("loads", [0, 1])
@pytest.mark.parametrize("facets", [one_sided(), out_of_line(0.3)], ids=["one side", "not in line"])
def test_infeasible_facets_are_proved_to_be(facets: ContactFacets, loads: int) -> None:
    result = synthesise(facets, random_loads(seeded(0), loads))
    assert (result.status, result.message) == (SynthesisStatus.INFEASIBLE, "")
    assert np.isnan(result.positions).all()
    assert np.isnan(result.forces).all()
    wrench = result.separating_wrench
    assert np.linalg.norm(wrench) == pytest.approx(1.0)
    assert internal_work(facets, wrench) < -1e-3
    rng = seeded(1)
    for _ in range(2000):
        pushed = facets.grasp_map(points_on(facets, rng)) @ permitted_forces(facets, rng)
        assert wrench @ (UNITS * pushed) < 0


@pytest.mark.parametrize(("share", "feasible"), [(0.97, False), (1.03, True)])
def test_friction_decides_whether_a_line_joins_the_facets(share: float, feasible: bool) -> None:
    """The nearest points are 30 mm aside and 20 mm apart; forces lean by 0.95 mu at most."""
    facets = out_of_line(share * 1.5 / INTERIOR_FRICTION)
    assert (separating_wrench(facets) is None) is feasible
    assert (synthesise(facets, NO_LOADS).status is SynthesisStatus.INFEASIBLE) is not feasible


@settings(max_examples=60)
@given(seed=SEEDS, count=COUNTS, friction=st.floats(0.05, 0.6))
def test_where_there_are_internal_forces_there_is_no_proof(
    seed: int, count: int, friction: float
) -> None:
    drawn, rng = random_facets(seed, count), seeded(seed)
    facets = ContactFacets(drawn.corners, drawn.normals, np.full(count, friction), LENGTH)
    proof = separating_wrench(facets)
    for _ in range(3):
        least, _ = even_internal_forces(facets, points_on(facets, rng))
        assert proof is None or least < INTERIOR_PRELOAD + 1e-6
    assert proof is None or internal_work(facets, proof) < 0
    assert proof is None or np.linalg.norm(proof) == pytest.approx(1.0)


def test_the_proof_is_of_internal_forces_with_their_margins() -> None:
    """Two fingers that all but face each other leave the third less than 0.05 of the mean."""
    facets = box_facets(np.array([X, -X, Y]), friction=0.015, centre=(0, 0, 0))
    assert has_interior_internal_force(feet(facets), facets.normals, facets.friction)
    least, _ = even_internal_forces(facets, feet(facets))
    assert 0 < least < INTERIOR_PRELOAD
    assert separating_wrench(facets) is not None
