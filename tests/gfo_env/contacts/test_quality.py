"""Grasp quality: closed forms, invariances, bounds that independent computations confirm."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog, minimize
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from gfo_env.contacts import (
    QualityInterval,
    has_interior_internal_force,
    is_force_closure,
    lowest_resisted_wrench,
)
from gfo_env.exceptions import QualityError
from solvers.quality.friction_discs import FrictionDiscs
from tests.support.seeds import seeded

LENGTH = 0.06
ROUND_OFF = 1e-7


@dataclasses.dataclass(frozen=True)
class Contacts:
    positions: np.ndarray
    normals: np.ndarray
    friction: np.ndarray

    def quality(self, **settings: Any) -> QualityInterval:
        settings = {"length": LENGTH} | settings
        return lowest_resisted_wrench(self.positions, self.normals, self.friction, **settings)

    def force_closure(self) -> bool:
        return is_force_closure(self.positions, self.normals, self.friction)

    def interior_force(self) -> bool:
        return has_interior_internal_force(self.positions, self.normals, self.friction)

    def rotated(self, rotation: Rotation) -> "Contacts":
        return Contacts(rotation.apply(self.positions), rotation.apply(self.normals), self.friction)


def random_contacts(seed: int, count: int, least_friction: float = 0.2) -> Contacts:
    """Contacts on a lumpy ball of a few centimetres, normals up to some 40 degrees off centre."""
    rng = seeded(seed)
    outward = rng.normal(size=(count, 3))
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    normals = -outward + 0.3 * rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    positions = outward * rng.uniform(0.02, LENGTH, (count, 1))
    return Contacts(positions, normals, rng.uniform(least_friction, 1.0, count))


def closing_contacts(seed: int, count: int, edges: int, least_friction: float = 0.2) -> Contacts:
    """The first random contacts from `seed` on that close even with pyramids of `edges` edges.

    Of five contacts with three edges half do, so that twenty draws without one are a fault.
    """
    drawn = (random_contacts(seed + k, count, least_friction) for k in range(20))
    return next(contacts for contacts in drawn if contacts.quality(edges=edges).lower > 0)


def equator(count: int, friction: float, tilt: float = 0.0) -> Contacts:
    """`count` contacts around a unit circle, normals to its centre, then tilted upwards."""
    angles = 2 * np.pi * np.arange(count) / count
    positions = np.stack([np.cos(angles), np.sin(angles), np.zeros(count)], axis=1)
    normals = -positions * np.cos(tilt) + np.array([0, 0, np.sin(tilt)])
    return Contacts(positions, normals, np.full(count, friction))


def octahedron(friction: float) -> Contacts:
    positions = np.vstack([np.eye(3), -np.eye(3)])
    return Contacts(positions, -positions, np.full(6, friction))


def cube(offset: float) -> Contacts:
    """Twelve frictionless contacts, two on each face of a cube of edge 2, +-offset off its middle.

    The contact at (s, b, 0) on face x = s, s = +-1, b = +-offset, has the normal (-s, 0, 0) and so
    the wrench (force -s e_x, torque s b e_z). All four sign combinations occur; likewise for y with
    torque about x and for z with torque about y.
    """
    positions, normals = [], []
    for axis in range(3):
        for side in (-1.0, 1.0):
            for shift in (-offset, offset):
                position = np.zeros(3)
                position[axis], position[(axis + 1) % 3] = side, shift
                positions.append(position)
                normals.append(-side * np.eye(3)[axis])
    return Contacts(np.array(positions), np.array(normals), np.zeros(12))


def true_support(
    contacts: Contacts, direction: np.ndarray, forces: np.ndarray | float = 1.0
) -> np.ndarray:
    """max of direction . wrench over each true cone's slice (n,), from the definition of both."""
    along = direction[:3] + np.cross(direction[3:], contacts.positions) / LENGTH
    normal_part = (along * contacts.normals).sum(axis=1)
    tangential_part = np.linalg.norm(along - normal_part[:, None] * contacts.normals, axis=1)
    return forces * (normal_part + contacts.friction * tangential_part)


seeds = st.integers(0, 2**32 - 1)
counts = st.integers(3, 6)


# Closed forms


@pytest.mark.parametrize(("offset", "length"), [(0.3, 1.0), (0.8, 0.5), (1.0, 1.0), (0.5, 2.0)])
def test_cube_of_frictionless_contacts(offset: float, length: float) -> None:
    """q_lrw = min(1, r) / sqrt(3), with r = offset / length.

    The wrenches are the corners (+-1, +-r) of a rectangle in each of three orthogonal planes
    (f_x, tau_z), (f_y, tau_x), (f_z, tau_y). Along a unit direction with the part rho_k in plane k
    a rectangle reaches at least min(1, r) rho_k, with equality along its short axis, and
    sum(rho_k^2) = 1: the largest of the three is least where all rho_k are 1 / sqrt(3).
    """
    quality = cube(offset).quality(length=length)
    expected = min(1.0, offset / length) / np.sqrt(3)
    assert quality.lower == pytest.approx(expected, rel=ROUND_OFF)
    assert quality.upper == pytest.approx(expected, rel=ROUND_OFF)
    assert quality.lower <= expected
    assert (quality.edges, quality.length) == (1, length)


def test_cube_with_a_force_for_each_pair_of_faces() -> None:
    """Forces N_k scale rectangle k: rho_k = q / (r N_k), so q = r / sqrt(sum(1 / N_k^2))."""
    forces = np.array([1.0, 2.0, 5.0])
    quality = cube(0.4).quality(length=1.0, normal_forces=np.repeat(forces, 4))
    expected = 0.4 / np.sqrt((forces**-2).sum())
    assert quality.lower == pytest.approx(expected, rel=ROUND_OFF)
    assert quality.upper == pytest.approx(expected, rel=ROUND_OFF)


@pytest.mark.parametrize("friction", [0.1, 0.5, 1.0])
def test_octahedron(friction: float) -> None:
    """q_lrw = mu sqrt(2 / 3): a torque along a diagonal, which no normal force helps to resist.

    About the unit axis a, the contacts at +-e_k resist mu |a x e_k| = mu sqrt(1 - a_k^2). The
    largest of the three is least, mu sqrt(2 / 3), where all |a_k| are equal.
    """
    quality = octahedron(friction).quality(length=1.0, edges=4, relative_width=1e-3)
    expected = friction * np.sqrt(2 / 3)
    assert quality.lower <= expected * (1 + ROUND_OFF)
    assert quality.upper == pytest.approx(expected, rel=ROUND_OFF)


@pytest.mark.parametrize("friction", [0.1, 0.4, 1.0])
def test_three_contacts_on_an_equator(friction: float) -> None:
    """Closed, and no better than the tripod's weakest wrench of friction along the axis.

    With a = force along the axis and w = torque in the plane, contact i resists mu |a + w x p_i|.
    Over unit (a, w) the largest of the three is least, 3 mu / sqrt(17), where all are equal and one
    has the other sign: a = 1 / 3, w = 4 / 3 before scaling.
    """
    contacts = equator(3, friction)
    quality = contacts.quality(length=1.0, edges=4, relative_width=0.02)
    assert 0 < quality.lower <= quality.upper <= friction * 3 / np.sqrt(17) * 1.02
    assert contacts.force_closure()
    assert contacts.interior_force()


@pytest.mark.parametrize(
    "contacts",
    [
        pytest.param(equator(2, 0.8), id="opposed contacts let the object spin about their line"),
        pytest.param(equator(4, 0.0), id="coplanar frictionless contacts"),
        pytest.param(octahedron(0.0), id="frictionless contacts on a ball"),
        pytest.param(
            Contacts(np.ones((4, 3)), octahedron(1.0).normals[:4], np.ones(4)), id="point"
        ),
        pytest.param(
            Contacts(equator(3, 1.0).positions, np.tile([0.0, 0, 1], (3, 1)), np.full(3, 0.5)),
            id="all normals alike",
        ),
        pytest.param(Contacts(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)), id="none"),
    ],
)
def test_contacts_that_do_not_close(contacts: Contacts) -> None:
    quality = contacts.quality(length=1.0)
    assert (quality.lower, quality.upper) == (0.0, 0.0)
    assert contacts.force_closure() is False
    assert contacts.interior_force() is False


@pytest.mark.parametrize("tilt", [0.2, 0.5])
@settings(max_examples=10, deadline=None)
@given(seed=seeds)
def test_force_closure_is_decided_by_the_round_cones(tilt: float, seed: int) -> None:
    """Normals tilted upwards by `tilt` close if and only if mu > tan(tilt).

    Below, every force has an upward part. Above, equal forces to the centre lie inside the cones.
    """
    rotation = Rotation.random(rng=seeded(seed))
    for excess, closes in ((0.98, False), (1.02, True)):
        contacts = equator(3, excess * np.tan(tilt), tilt).rotated(rotation)
        assert contacts.force_closure() is closes
        assert contacts.interior_force() is closes


def test_few_edges_can_miss_a_closure_that_is_force_closure() -> None:
    contacts = equator(3, 1.02 * np.tan(0.5), 0.5).rotated(Rotation.from_rotvec([0.3, 0.2, 0.1]))
    quality = contacts.quality(edges=4, length=1.0)
    assert quality.lower == 0 < quality.upper
    assert contacts.force_closure()


# Bounds against independent computations


@settings(max_examples=15, deadline=None)
@given(seed=seeds, count=counts)
def test_no_direction_of_the_true_cones_falls_below_the_lower_bound(seed: int, count: int) -> None:
    contacts = random_contacts(seed, count)
    forces = seeded(seed).uniform(0.5, 5.0, count)
    quality = contacts.quality(normal_forces=forces)
    directions = seeded(seed).normal(size=(300, 6))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    support = np.array([true_support(contacts, d, forces).max() for d in directions])
    assert 0 <= quality.lower <= quality.upper
    assert quality.lower <= max(support.min(), 0)


def test_discs_reach_as_far_as_the_definition_says() -> None:
    contacts = random_contacts(7, 5)
    forces = np.array([1.0, 2.0, 0.5, 3.0, 1.5])
    discs = FrictionDiscs.of_contacts(
        contacts.positions, contacts.normals, contacts.friction, forces, LENGTH
    )
    for direction in seeded(0).normal(size=(20, 6)):
        expected = true_support(contacts, direction, forces)
        np.testing.assert_allclose(discs.support(direction[None])[0], expected, rtol=0, atol=1e-12)


@settings(max_examples=10, deadline=None)
@given(seed=seeds)
def test_frictionless_contacts_agree_with_a_plain_hull(seed: int) -> None:
    contacts = dataclasses.replace(random_contacts(seed, 12), friction=np.zeros(12))
    torques = np.cross(contacts.positions, contacts.normals) / LENGTH
    hull = ConvexHull(np.hstack([contacts.normals, torques]))
    expected = max(-hull.equations[:, 6].max(), 0.0)
    quality = contacts.quality()
    assert quality.lower == pytest.approx(expected, abs=1e-7)
    assert quality.upper == pytest.approx(expected, abs=1e-7)


@pytest.mark.parametrize("edges", [3, 4, 7])
def test_pyramids_resist_the_lower_bound_in_every_direction(edges: int) -> None:
    """A linear program stretches random wrenches until they leave the hull of the pyramids."""
    contacts = closing_contacts(7, 5, edges)
    lower = contacts.quality(edges=edges).lower
    discs = FrictionDiscs.of_contacts(
        contacts.positions, contacts.normals, contacts.friction, np.ones(5), LENGTH
    )
    wrenches, _ = discs.pyramids(edges)
    directions = seeded(0).normal(size=(40, 6))
    for direction in directions / np.linalg.norm(directions, axis=1, keepdims=True):
        program = linprog(
            np.append(np.zeros(len(wrenches)), -1.0),
            A_ub=np.append(np.ones(len(wrenches)), 0.0)[None],
            b_ub=[1.0],
            A_eq=np.column_stack([wrenches.T, -direction]),
            b_eq=np.zeros(6),
        )
        assert -program.fun >= lower > 0


@pytest.mark.parametrize(("seed", "count"), [(10, 3), (7, 5), (3, 8)])
def test_refined_interval_holds_the_least_reach_that_descent_finds(seed: int, count: int) -> None:
    contacts = closing_contacts(seed, count, edges=4, least_friction=0.5)
    quality = contacts.quality(edges=4, relative_width=1e-3)
    directions = seeded(seed).normal(size=(200_000, 6))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    along = directions[:, None, :3] + np.cross(directions[:, None, 3:], contacts.positions) / LENGTH
    normal_part = np.einsum("knd,nd->kn", along, contacts.normals)
    tangential = np.linalg.norm(along - normal_part[:, :, None] * contacts.normals, axis=2)
    support = (normal_part + contacts.friction * tangential).max(axis=1)
    assert support.min() >= quality.lower > 0

    def descend(start: np.ndarray) -> float:
        """Least t with reach <= t near `start`, on the unit sphere."""
        result = minimize(
            lambda x: x[6],
            np.append(start, true_support(contacts, start).max()),
            method="SLSQP",
            constraints=[
                {"type": "ineq", "fun": lambda x: x[6] - true_support(contacts, x[:6])},
                {"type": "eq", "fun": lambda x: x[:6] @ x[:6] - 1.0},
            ],
        )
        unit = result.x[:6] / np.linalg.norm(result.x[:6])
        return float(true_support(contacts, unit).max())

    found = min(descend(directions[start]) for start in np.argsort(support)[:20])
    assert quality.lower <= found <= quality.upper * (1 + 1e-3)


@settings(max_examples=20, deadline=None)
@given(seed=seeds, count=st.integers(2, 6), frictionless=st.booleans())
def test_force_closure_agrees_with_the_interior_internal_force(
    seed: int, count: int, frictionless: bool
) -> None:
    contacts = random_contacts(seed, count, least_friction=0.05)
    if frictionless:
        contacts.friction[0] = 0.0
    try:
        quality = contacts.quality(edges=4, relative_width=0.5)
    except QualityError:
        quality = None
    assume(quality is not None and (quality.upper == 0 or quality.lower > 1e-4))
    assert contacts.force_closure() is contacts.interior_force()
    assert quality is not None
    assert contacts.force_closure() is (quality.lower > 0)


# Invariances and monotonicity


@settings(max_examples=15, deadline=None)
@given(seed=seeds, count=counts, exponent=st.integers(-10, 10))
def test_scaling(seed: int, count: int, exponent: int) -> None:
    """Powers of two, for they scale without round-off: the numbers agree to the last bit."""
    contacts = random_contacts(seed, count)
    factor = 2.0**exponent
    quality = contacts.quality()
    stronger = contacts.quality(normal_forces=np.full(count, factor))
    assert stronger.lower == factor * quality.lower
    assert stronger.upper == factor * quality.upper
    larger = dataclasses.replace(contacts, positions=contacts.positions * factor)
    scaled = larger.quality(length=LENGTH * factor)
    assert (scaled.lower, scaled.upper) == (quality.lower, quality.upper)
    assert larger.force_closure() is contacts.force_closure()


@settings(max_examples=15, deadline=None)
@given(seed=seeds, count=counts)
def test_rotation_and_translation(seed: int, count: int) -> None:
    """Rotation turns the pyramids in their cones a little, never the cones themselves."""
    contacts = random_contacts(seed, count)
    rotated = contacts.rotated(Rotation.random(rng=seeded(seed)))
    here, there = contacts.quality(), rotated.quality()
    assert max(here.lower, there.lower) <= min(here.upper, there.upper)
    moved = dataclasses.replace(rotated, positions=rotated.positions + np.array([3.0, -2.0, 1.0]))
    assert contacts.force_closure() is rotated.force_closure() is moved.force_closure()
    assert contacts.interior_force() is moved.interior_force()


def test_refinement_removes_the_dependence_on_the_frame() -> None:
    contacts = closing_contacts(7, 5, edges=4)
    rotated = contacts.rotated(Rotation.from_rotvec([0.5, -1.0, 0.7]))
    here = contacts.quality(relative_width=1e-3)
    there = rotated.quality(relative_width=1e-3)
    assert here.upper - here.lower <= 1e-3 * here.upper
    assert here.lower == pytest.approx(there.lower, rel=2e-3)
    assert here.edges > 8


@settings(max_examples=10, deadline=None)
@given(seed=seeds, count=counts)
def test_more_contacts_friction_or_edges_never_lower_it(seed: int, count: int) -> None:
    contacts = random_contacts(seed, count)
    fewer = Contacts(contacts.positions[1:], contacts.normals[1:], contacts.friction[1:])
    rougher = dataclasses.replace(contacts, friction=contacts.friction * 1.1)
    coarse, quality, fine = (contacts.quality(edges=edges) for edges in (4, 8, 16))
    assert fewer.quality().lower <= quality.lower + ROUND_OFF
    assert quality.lower <= rougher.quality().lower + ROUND_OFF
    assert coarse.lower <= quality.lower + ROUND_OFF
    assert quality.lower <= fine.lower + ROUND_OFF
    assert fine.lower <= min(coarse.upper, quality.upper, fine.upper)
    assert (coarse.edges, quality.edges, fine.edges) == (4, 8, 16)


@settings(max_examples=10, deadline=None)
@given(seed=seeds, count=counts)
def test_contacts_without_force_and_copies_of_a_contact_change_nothing(
    seed: int, count: int
) -> None:
    contacts = random_contacts(seed, count)
    quality = contacts.quality()
    again = np.append(np.arange(count), 0)
    copied = Contacts(contacts.positions[again], contacts.normals[again], contacts.friction[again])
    assert copied.quality(normal_forces=np.append(np.ones(count), 0.0)) == quality
    assert copied.quality().lower == pytest.approx(quality.lower, abs=ROUND_OFF)
    assert copied.quality().upper >= quality.lower - ROUND_OFF


def test_same_input_same_bits() -> None:
    contacts = random_contacts(3, 5)
    assert contacts.quality() == contacts.quality()


def test_default_length_is_the_largest_contact_distance() -> None:
    contacts = random_contacts(3, 5)
    distance = float(np.linalg.norm(contacts.positions, axis=1).max())
    assert contacts.quality(length=None) == contacts.quality(length=distance)
    assert contacts.quality(length=None).length == distance


# Bad input


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"positions": np.zeros((3, 2))}, r"positions must have shape \(n, 3\), not \(3, 2\)"),
        ({"positions": [[0, 0, 0], [1]]}, "positions must be an array of numbers"),
        ({"positions": np.full((3, 3), np.nan)}, "positions must be finite"),
        ({"normals": np.eye(3)[:2]}, r"normals must have shape \(3, 3\), not \(2, 3\)"),
        ({"normals": 2 * np.eye(3)}, "normals must have unit length"),
        ({"friction": 0.5}, r"friction must have shape \(3\), not \(\)"),
        ({"friction": [0.5, -0.1, 0.5]}, "friction must be >= 0"),
        ({"friction": [0.5, np.inf, 0.5]}, "friction must be finite"),
        ({"normal_forces": [1.0, -1.0, 1.0]}, "normal_forces must be >= 0"),
        ({"normal_forces": [1.0, 1.0]}, r"normal_forces must have shape \(3\)"),
        ({"edges": 2}, "edges must be >= 3"),
        ({"edges": 8.0}, "edges must be a whole number"),
        ({"length": 0.0}, "length must be a positive number of metres"),
        ({"length": np.nan}, "length must be a positive number of metres"),
        ({"positions": np.zeros((3, 3))}, "length must be given"),
        ({"relative_width": 0.0}, "relative_width must lie between 0 and 1"),
        ({"relative_width": np.nan}, "relative_width must lie between 0 and 1"),
    ],
)
def test_malformed_arguments(change: dict[str, Any], message: str) -> None:
    arguments: dict[str, Any] = {
        "positions": np.eye(3),
        "normals": -np.eye(3),
        "friction": np.full(3, 0.5),
    }
    arguments |= change
    with pytest.raises(QualityError, match=message):
        lowest_resisted_wrench(**arguments)
    if change.keys() <= {"normals", "friction"}:
        for test in (is_force_closure, has_interior_internal_force):
            with pytest.raises(QualityError, match=message):
                test(**arguments)


def test_unreachable_width_is_an_error_that_says_how_far_it_came() -> None:
    with pytest.raises(QualityError, match=r"relative_width=1e-12.*narrower than \d\.\de-\d\d"):
        closing_contacts(7, 5, edges=4).quality(edges=4, relative_width=1e-12)
