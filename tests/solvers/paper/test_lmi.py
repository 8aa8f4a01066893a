"""The linear matrix inequality says what the cones say, and its solver finds the same optimum."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import block_diag

from solvers import GraspForceProblem, ProblemError
from solvers.arrays import Array
from solvers.paper.contact_models import (
    ContactModel,
    FrictionContact,
    FrictionlessContact,
    SoftFingerContact,
)
from solvers.paper.lmi import LinearMatrixInequality, contact_inequality, linear_matrix_inequality
from solvers.problem import friction_violation, normal_violation, torque_violation
from tests.support.problems import forces_in_cones, random_problem, solved_by
from tests.support.seeds import SEEDS, seeded

VARIANTS = st.sampled_from(
    [
        {},
        {"normal_max": np.inf},
        {"torque_min": -np.inf, "torque_max": np.inf},
        {"friction": 0.0},
        {"normal_min": 3.0, "normal_max": 3.0},
    ]
)


def least_eigenvalue(problem: GraspForceProblem, forces: np.ndarray) -> float:
    return float(np.linalg.eigvalsh(linear_matrix_inequality(problem)(forces))[0])


def violation(problem: GraspForceProblem, forces: np.ndarray) -> float:
    """Largest violation of everything that the inequality covers; N or N·m."""
    return max(
        float(measure(problem, forces))
        for measure in (friction_violation, normal_violation, torque_violation)
    )


@given(SEEDS, VARIANTS, st.integers(3, 5))
@settings(max_examples=150)
def test_matrix_is_positive_exactly_where_the_cones_and_bounds_hold(
    seed: int, variant: dict[str, Any], count: int
) -> None:
    rng = seeded(seed)
    problem = random_problem(rng, count, **variant)
    inside = forces_in_cones(rng, problem)
    problem = solved_by(rng, problem, inside)
    assert least_eigenvalue(problem, inside) >= -1e-12
    assert violation(problem, inside) <= 1e-12
    for size in (1e-3, 1.0, 30.0):
        forces = inside + size * rng.standard_normal(3 * count) * rng.integers(0, 2, 3 * count)
        excess = violation(problem, forces)
        eigenvalue = least_eigenvalue(problem, forces)
        if excess > 1e-9:
            assert eigenvalue < 0.0
        else:
            assert eigenvalue >= -1e-9


@given(SEEDS)
@settings(max_examples=30)
def test_least_eigenvalue_crosses_zero_at_the_edge(seed: int) -> None:
    """On a ray out of the set, the inequality fails right after the constraints do."""
    rng = seeded(seed)
    problem = random_problem(rng, normal_min=1.0, normal_max=20.0)
    start = forces_in_cones(rng, problem)
    problem = solved_by(rng, problem, start)
    direction = rng.standard_normal(12)
    inside, outside = 0.0, 1e3
    for _ in range(60):
        middle = 0.5 * (inside + outside)
        if violation(problem, start + middle * direction) > 0.0:
            outside = middle
        else:
            inside = middle
    beyond = start + (outside + 1e-6) * direction
    assert least_eigenvalue(problem, start + inside * direction) >= -1e-10
    assert least_eigenvalue(problem, beyond) < 0.0


def test_blocks_of_a_small_example_by_hand() -> None:
    problem = random_problem(seeded(0), 3)
    jacobian = np.zeros((9, 2))
    jacobian[0, 0], jacobian[8, 1] = 0.1, 0.2
    problem = problem.replace(
        friction=np.array([0.5, 1.0, 0.0]),
        hand_jacobian=jacobian,
        torque_min=np.array([-1.0, -np.inf]),
        torque_max=np.array([2.0, 3.0]),
        external_torque=np.array([0.25, 0.5]),
        normal_min=np.array([1.0, 0.0, 0.0]),
        normal_max=np.array([10.0, np.inf, np.inf]),
    )
    forces = np.array([3.0, 4.0, 8.0, 0.0, -1.0, 2.0, 0.0, 0.0, 5.0])
    inequality = linear_matrix_inequality(problem)
    assert inequality.friction_size == 9
    expected = np.zeros((16, 16))
    expected[:3, :3] = [[4.0, 0.0, 3.0], [0.0, 4.0, 4.0], [3.0, 4.0, 4.0]]
    expected[3:6, 3:6] = [[2.0, 0.0, 0.0], [0.0, 2.0, -1.0], [0.0, -1.0, 2.0]]
    torque = (0.1 * 3.0 + 0.25, 0.2 * 5.0 + 0.5)
    bounds = [torque[0] + 1.0, 2.0 - torque[0], 3.0 - torque[1]]
    bounds += [8.0 - 1.0, 10.0 - 8.0, 2.0, 5.0]
    expected[range(9, 16), range(9, 16)] = bounds
    np.testing.assert_allclose(inequality(forces), expected, atol=1e-15)
    # |f_t| = 5 > mu f_n = 4: the eigenvalues are mu f_n and mu f_n +- |f_t|
    np.testing.assert_allclose(
        np.linalg.eigvalsh(inequality(forces)[:3, :3]), [-1.0, 4.0, 9.0], atol=1e-14
    )


@given(SEEDS)
@settings(max_examples=20)
def test_matrix_is_symmetric_and_affine(seed: int) -> None:
    rng = seeded(seed)
    inequality = linear_matrix_inequality(random_problem(rng))
    first, second = rng.standard_normal((2, 12))
    mixed = inequality(0.3 * first + 0.7 * second)
    np.testing.assert_allclose(mixed, 0.3 * inequality(first) + 0.7 * inequality(second), atol=1e-9)
    np.testing.assert_array_equal(mixed, mixed.T)
    np.testing.assert_array_equal(inequality(np.zeros(12)), inequality.constant)
    batch = rng.standard_normal((2, 5, 12))
    np.testing.assert_allclose(inequality(batch)[1, 3], inequality(batch[1, 3]), atol=1e-12)


@given(SEEDS, st.sampled_from([0.3, 1.0]))
@settings(max_examples=30)
def test_missing_normal_force_is_the_tangential_excess_of_the_residuals(
    seed: int, friction: float
) -> None:
    rng = seeded(seed)
    problem = random_problem(rng, friction=friction)
    forces = 5.0 * rng.standard_normal(12)
    missing = FrictionContact(friction).violation(forces.reshape(4, 3)).max()
    np.testing.assert_allclose(
        friction * missing, friction_violation(problem, forces), rtol=1e-12, atol=1e-14
    )


@dataclass(frozen=True)
class Mixture:
    """Contacts of any models with limits, and wrenches that satisfy them, some with equality."""

    contacts: tuple[ContactModel, ...]
    jacobian: Array
    limits: dict[str, Array]
    wrenches: Array
    inequality: LinearMatrixInequality

    def torque(self, wrenches: Array) -> Array:
        return self.jacobian.T @ wrenches + self.limits["external_torque"]

    def violation(self, wrenches: Array) -> float:
        """Largest violation of any cone, preload, cap or torque limit; N or N·m."""
        parts = np.split(wrenches, np.cumsum([contact.size for contact in self.contacts])[:-1])
        pairs = list(zip(self.contacts, parts, strict=True))
        normal = np.array([part[contact.normal] for contact, part in pairs])
        torque = self.torque(wrenches)
        excess = [
            *(contact.violation(part) for contact, part in pairs),
            *(self.limits["normal_min"] - normal),
            *(normal - self.limits["normal_max"]),
            *(self.limits["torque_min"] - torque),
            *(torque - self.limits["torque_max"]),
        ]
        return max(0.0, *(float(part) for part in excess))


def random_mixture(rng: np.random.Generator, joints: int = 3) -> Mixture:
    contacts: list[ContactModel] = []
    wrenches: list[Array] = []
    for kind in rng.integers(0, 3, rng.integers(1, 6)):
        normal = rng.choice([0.0, 1.0, 5.0])
        angle, turn = rng.uniform(0.0, 2 * np.pi), rng.choice([0.0, 0.5 * np.pi, 1.0])
        mu, torsional = rng.choice([0.0, 0.3, 1.0]), rng.choice([0.0, 0.003, 0.03])
        if kind < 2:
            turn = 0.0
        # inside, or on the surface
        used = normal * rng.choice([0.0, 0.5, 1.0])
        sliding = mu * used * np.cos(turn)
        tangential = [sliding * np.cos(angle), sliding * np.sin(angle)]
        if kind == 0:
            contacts.append(FrictionlessContact())
            wrenches.append(np.array([normal]))
        elif kind == 1:
            contacts.append(FrictionContact(float(mu)))
            wrenches.append(np.array([*tangential, normal]))
        else:
            contacts.append(SoftFingerContact(float(mu), float(torsional)))
            wrenches.append(np.array([*tangential, normal, torsional * used * np.sin(turn)]))
    stacked = np.concatenate(wrenches)
    jacobian = rng.uniform(-0.1, 0.1, (len(stacked), joints))
    external = rng.uniform(-0.1, 0.1, joints)
    torque = jacobian.T @ stacked + external
    normals = np.array([w[c.normal] for c, w in zip(contacts, wrenches, strict=True)])
    limits = {
        "torque_min": torque - rng.choice([0.0, 0.2, np.inf], joints),
        "torque_max": torque + rng.choice([0.0, 0.2, np.inf], joints),
        "external_torque": external,
        "normal_min": normals * rng.choice([0.0, 0.5, 1.0], len(normals)),
        "normal_max": normals + rng.choice([0.0, 2.0, np.inf], len(normals)),
    }
    inequality = contact_inequality(contacts, jacobian, **limits)
    return Mixture(tuple(contacts), jacobian, limits, stacked, inequality)


def random_direction(rng: np.random.Generator, mixture: Mixture) -> Array:
    """(size,) about 1 for forces and a centimetre for moments.

    No component is small: a contact without friction of a kind shows a load of that kind by an
    eigenvalue that has its square.
    """
    scale = [np.array([1.0, 1.0, 1.0, 0.01])[: contact.size] for contact in mixture.contacts]
    size = len(mixture.wrenches)
    signs = rng.choice([-1.0, 1.0], size)
    return np.concatenate(scale) * signs * rng.uniform(0.3, 1.0, size)


@given(SEEDS)
@settings(max_examples=300)
def test_mixture_is_positive_exactly_where_every_cone_and_limit_holds(seed: int) -> None:
    rng = seeded(seed)
    mixture = random_mixture(rng)
    # on limits and on surfaces, too, it still holds
    assert mixture.violation(mixture.wrenches) <= 1e-13
    assert np.linalg.eigvalsh(mixture.inequality(mixture.wrenches))[0] >= -1e-13
    for size in (1e-3, 1.0, 30.0):
        chosen = rng.integers(0, 2, len(mixture.wrenches))
        wrenches = mixture.wrenches + size * chosen * random_direction(rng, mixture)
        excess = mixture.violation(wrenches)
        eigenvalue = np.linalg.eigvalsh(mixture.inequality(wrenches))[0]
        # 1e-6 N beyond a soft finger's cone is an eigenvalue of mu_s^2 times that
        if excess > 1e-6:
            assert eigenvalue < 0.0
        elif excess == 0.0:
            assert eigenvalue >= -1e-13


@given(SEEDS)
@settings(max_examples=60)
def test_mixture_is_left_where_the_first_cone_or_limit_is(seed: int) -> None:
    rng = seeded(seed)
    mixture = random_mixture(rng)
    direction = random_direction(rng, mixture)
    inside, outside = 0.0, 1e3
    for _ in range(70):
        middle = 0.5 * (inside + outside)
        # what the edge itself violates by is rounding
        if mixture.violation(mixture.wrenches + middle * direction) > 1e-13:
            outside = middle
        else:
            inside = middle
    matrix = mixture.inequality
    assert np.linalg.eigvalsh(matrix(mixture.wrenches + inside * direction))[0] >= -1e-12
    if outside < 1e3:
        beyond = mixture.wrenches + (outside + 1e-3) * direction
        assert np.linalg.eigvalsh(matrix(beyond))[0] < 0.0


@given(SEEDS)
@settings(max_examples=60)
def test_parts_of_a_mixture_are_those_of_the_paper(seed: int) -> None:
    rng = seeded(seed)
    mixture = random_mixture(rng)
    inequality, limits = mixture.inequality, mixture.limits
    size = len(mixture.wrenches)
    wrenches = rng.standard_normal(size)
    parts = np.split(wrenches, np.cumsum([contact.size for contact in mixture.contacts])[:-1])
    blocks = [c.matrix(part) for c, part in zip(mixture.contacts, parts, strict=True)]
    friction = np.tensordot(wrenches, inequality.friction_coefficients, axes=(0, 0))
    np.testing.assert_allclose(friction, block_diag(*blocks), atol=1e-15)
    assert inequality.contact_blocks == tuple(len(block) for block in blocks)
    assert inequality.friction_size == len(friction)

    torque = mixture.torque(wrenches)
    below, above = (torque - limits["torque_min"], limits["torque_max"] - torque)
    expected = np.diag([*below[np.isfinite(below)], *above[np.isfinite(above)]])
    part = inequality.torque_constant + np.tensordot(
        wrenches, inequality.torque_coefficients, axes=(0, 0)
    )
    np.testing.assert_allclose(part, expected, atol=1e-14)
    assert inequality.torque_size == len(expected)

    normals = [p[c.normal] for c, p in zip(mixture.contacts, parts, strict=True)]
    rows = []
    for normal, least, most in zip(
        normals, limits["normal_min"], limits["normal_max"], strict=True
    ):
        rows += [normal - least] + [most - normal] * bool(np.isfinite(most))
    whole = inequality(wrenches)
    np.testing.assert_allclose(whole, block_diag(friction, part, np.diag(rows)), atol=1e-14)
    np.testing.assert_array_equal(whole, whole.T)
    # nothing of the friction is constant, as equation 33 says
    corner = inequality.friction_size
    assert np.all(inequality.constant[:corner, :corner] == 0.0)
    other = rng.standard_normal(size)
    np.testing.assert_allclose(
        inequality(0.3 * wrenches + 0.7 * other), 0.3 * whole + 0.7 * inequality(other), atol=1e-13
    )


@given(SEEDS)
@settings(max_examples=60)
def test_soft_fingers_without_moments_are_the_problem_with_point_contacts(seed: int) -> None:
    rng = seeded(seed)
    problem = random_problem(rng, friction=float(rng.choice([0.0, 0.5])), normal_min=0.0)
    forces = forces_in_cones(rng, problem)
    problem = solved_by(rng, problem, forces)
    count = problem.n_contacts
    jacobian = np.zeros((count, 4, problem.n_joints))
    jacobian[:, :3] = problem.hand_jacobian.reshape(count, 3, -1)
    # the moments' rows may be anything: they are multiplied by zero
    jacobian[:, 3] = rng.standard_normal((count, problem.n_joints))
    soft = contact_inequality(
        [
            SoftFingerContact(mu, torsional)
            for mu, torsional in zip(problem.friction, rng.choice([0.0, 0.01], count), strict=True)
        ],
        jacobian.reshape(4 * count, -1),
        problem.torque_min,
        problem.torque_max,
        problem.external_torque,
        problem.normal_min,
        problem.normal_max,
    )
    for size in (0.0, 0.1, 10.0):
        moved = forces + size * rng.standard_normal(3 * count) * rng.integers(0, 2, 3 * count)
        wrenches = np.concatenate([moved.reshape(count, 3), np.zeros((count, 1))], axis=1)
        point = least_eigenvalue(problem, moved)
        assert (point >= -1e-9) == (np.linalg.eigvalsh(soft(wrenches.reshape(-1)))[0] >= -1e-9)


def test_limits_may_be_left_out() -> None:
    inequality = contact_inequality(
        [FrictionlessContact(), FrictionContact(0.0)], np.zeros((4, 0)), [], []
    )
    assert inequality.torque_size == 0
    assert inequality.torque_constant.shape == (0, 0)
    assert inequality.torque_coefficients.shape == (4, 0, 0)
    # f_n >= 0 of the contact whose block says nothing about it
    diagonal = np.diagonal(inequality(np.array([2.0, 0.0, 0.0, -3.0])))
    np.testing.assert_array_equal(diagonal, [2.0, 0.0, 0.0, 0.0, 2.0, -3.0])


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"contacts": []}, "at least one contact"),
        ({"contacts": [0.5]}, "at least one contact, each a FrictionlessContact"),
        ({"hand_jacobian": np.zeros((3, 2))}, r"hand_jacobian has shape \(3, 2\) but must have"),
        ({"hand_jacobian": "J"}, "hand_jacobian is not a rectangular array"),
        ({"hand_jacobian": np.full((4, 2), np.inf)}, "hand_jacobian contains NaN, or a value"),
        ({"external_torque": [0.0, np.nan]}, "external_torque contains NaN"),
        ({"torque_min": [np.inf, 0.0]}, "torque_min contains NaN, or a value"),
        ({"torque_max": [-np.inf, 1.0]}, "torque_max contains NaN, or a value"),
        ({"torque_max": None}, r"torque_max has shape \(\)|torque_max contains"),
        ({"torque_min": [2.0, 0.0]}, "a lower limit exceeds its upper limit"),
        ({"torque_max": [1.0]}, r"torque_max has shape \(1,\) but must have \(2,\)"),
        ({"normal_min": [-1.0]}, "normal_min is negative"),
        ({"normal_min": [2.0], "normal_max": [1.0]}, "a lower limit exceeds its upper limit"),
        ({"normal_max": [np.nan]}, "normal_max contains NaN"),
    ],
)
def test_malformed_inequality_is_refused(changes: dict[str, Any], why: str) -> None:
    arguments: dict[str, Any] = {
        "contacts": [SoftFingerContact(0.5, 0.01)],
        "hand_jacobian": np.zeros((4, 2)),
        "torque_min": [-1.0, -np.inf],
        "torque_max": [1.0, np.inf],
    }
    contact_inequality(**arguments)
    with pytest.raises(ProblemError, match=why):
        contact_inequality(**(arguments | changes))
