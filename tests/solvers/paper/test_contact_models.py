"""Each contact model's cone and matrix inequality say the same, where friction is zero too."""

import itertools
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from solvers import ProblemError
from solvers.arrays import Array
from solvers.paper.contact_models import (
    ContactModel,
    FrictionContact,
    FrictionlessContact,
    SoftFingerContact,
)
from tests.support.seeds import SEEDS, seeded

FRICTION = st.sampled_from([0.0, 0.1, 0.5, 1.0, 2.0])
TORSIONAL = st.sampled_from([0.0, 0.001, 0.01, 0.05])
MODELS = st.one_of(
    st.just(FrictionlessContact()),
    FRICTION.map(FrictionContact),
    st.builds(SoftFingerContact, FRICTION, TORSIONAL),
)


def wrench_of(rng: np.random.Generator, model: ContactModel, normal: float, share: float) -> Array:
    """A wrench in a random direction that uses `share` of the friction that `normal` gives."""
    angle, turn = rng.uniform(0.0, 2 * np.pi, 2)
    wrench = np.zeros(model.size)
    wrench[model.normal] = normal
    # all of the share goes to the kind of friction that there is
    if getattr(model, "torsional_friction", 0.0) == 0.0:
        turn = 0.0
    elif getattr(model, "friction", 0.0) == 0.0:
        turn = 0.5 * np.pi
    if isinstance(model, FrictionContact | SoftFingerContact):
        tangential = share * abs(normal) * np.cos(turn) * model.friction
        wrench[:2] = tangential * np.cos(angle), tangential * np.sin(angle)
    if isinstance(model, SoftFingerContact):
        wrench[3] = share * abs(normal) * np.sin(turn) * model.torsional_friction
    return wrench


def says_nothing_of_the_normal(model: ContactModel) -> bool:
    """The printed PCWF matrix without friction: f_n >= 0 is a row of its own."""
    return isinstance(model, FrictionContact) and model.friction == 0.0


def has_friction(model: ContactModel) -> bool:
    return any(getattr(model, name, 0.0) > 0 for name in ("friction", "torsional_friction"))


def least(model: ContactModel, wrench: Array) -> float:
    return float(np.linalg.eigvalsh(model.matrix(wrench))[0])


@given(SEEDS, MODELS, st.sampled_from([0.0, 0.5, 0.999, 1.0]), st.floats(1e-2, 50.0))
@settings(max_examples=200)
def test_cone_and_its_surface_are_inside(
    seed: int, model: ContactModel, share: float, normal: float
) -> None:
    wrench = wrench_of(seeded(seed), model, normal, share)
    assert model.violation(wrench) <= 1e-12 * normal
    assert least(model, wrench) >= -1e-14 * normal
    if share == 1.0 and has_friction(model):
        # on the surface, and not deep inside
        assert model.violation(wrench - 1e-6 * np.eye(model.size)[model.normal]) > 0.0
        assert abs(least(model, wrench)) <= 1e-14 * normal


@given(SEEDS, MODELS, st.sampled_from([1.001, 1.5, 30.0]), st.floats(1e-2, 50.0))
@settings(max_examples=200)
def test_beyond_the_surface_is_outside(
    seed: int, model: ContactModel, share: float, normal: float
) -> None:
    wrench = wrench_of(seeded(seed), model, normal, share)
    if has_friction(model):
        # the missing normal force, by how far beyond the surface the wrench is
        assert model.violation(wrench) == pytest.approx((share - 1.0) * normal, rel=1e-9)
        assert least(model, wrench) < -1e-12 * normal


@given(SEEDS, MODELS, st.sampled_from([0.0, 0.5, 1.0]), st.floats(1e-2, 50.0))
@settings(max_examples=100)
def test_pulling_is_outside(seed: int, model: ContactModel, share: float, pull: float) -> None:
    wrench = wrench_of(seeded(seed), model, -pull, share)
    assert model.violation(wrench) >= pull
    if says_nothing_of_the_normal(model):
        assert np.all(model.matrix(wrench) == 0.0)
    else:
        assert least(model, wrench) < -1e-7 * pull


@given(MODELS)
def test_apex_is_inside(model: ContactModel) -> None:
    zero = np.zeros(model.size)
    assert model.violation(zero) == 0.0
    assert np.all(model.matrix(zero) == 0.0)


@given(SEEDS, MODELS)
@settings(max_examples=100)
def test_both_forms_are_left_at_the_same_point_of_a_ray(seed: int, model: ContactModel) -> None:
    rng = seeded(seed)
    start = wrench_of(rng, model, rng.uniform(1.0, 20.0), 0.5)
    # no component too small: without friction of its kind, the eigenvalue has its square
    direction = rng.choice([-1.0, 1.0], model.size) * rng.uniform(0.3, 1.0, model.size)
    # moments are about a centimetre's worth
    direction *= np.array([1.0, 1.0, 1.0, 0.01][: model.size])
    # down, so that every ray leaves in the end
    direction[model.normal] = -abs(direction[model.normal])
    inside, outside = 0.0, 1e3
    assert model.violation(start) == 0.0
    assert model.violation(start + outside * direction) > 0.0
    for _ in range(80):
        middle = 0.5 * (inside + outside)
        if model.violation(start + middle * direction) > 0.0:
            outside = middle
        else:
            inside = middle
    assert least(model, start + inside * direction) >= -1e-11
    assert least(model, start + (outside + 1e-3) * direction) < 0.0


@pytest.mark.parametrize("friction", [0.0, 0.5])
@pytest.mark.parametrize("torsional", [0.0, 0.25])
def test_soft_finger_without_friction_of_a_kind_by_exhaustion(
    friction: float, torsional: float
) -> None:
    """Against the cone spelt out for each of the four cases, on a grid that hits the surface."""
    model = SoftFingerContact(friction, torsional)
    seen = set()
    for wrench in itertools.product([-1.5, 0.0, 0.3], [0.0, 0.4], [-1.0, 0.0, 1.0, 3.0], [0, 0.75]):
        tangential, normal, moment = np.hypot(*wrench[:2]), wrench[2], wrench[3]
        if friction > 0 and torsional > 0:
            inside = np.hypot(tangential / friction, moment / torsional) <= normal
        elif friction > 0:
            inside = moment == 0 and tangential <= friction * normal
        elif torsional > 0:
            inside = tangential == 0 and moment <= torsional * normal
        else:
            inside = tangential == 0 and moment == 0 and normal >= 0
        assert (model.violation(wrench) == 0.0) == inside
        assert (least(model, np.array(wrench)) >= -1e-14) == inside
        seen.add(bool(inside))
    assert seen == {True, False}


@given(SEEDS, st.sampled_from([0.0, 0.3, 1.5]))
def test_point_contact_matrix_is_the_printed_one(seed: int, friction: float) -> None:
    first, second, normal = seeded(seed).standard_normal(3)
    printed = [
        [friction * normal, 0.0, first],
        [0.0, friction * normal, second],
        [first, second, friction * normal],
    ]
    model = FrictionContact(friction)
    np.testing.assert_array_equal(model.matrix([first, second, normal]), printed)
    # the eigenvalues that the docstring states
    size, middle = np.hypot(first, second), friction * normal
    np.testing.assert_allclose(
        np.linalg.eigvalsh(printed), [middle - size, middle, middle + size], atol=1e-14
    )


@given(SEEDS, st.floats(0.05, 2.0), st.floats(1e-3, 0.1))
def test_soft_finger_matrix_is_congruent_to_the_one_with_divisions(
    seed: int, friction: float, torsional: float
) -> None:
    first, second, normal, moment = seeded(seed).standard_normal(4)
    loads = np.array([first / friction, second / friction, moment / torsional])
    divided = normal * np.eye(4)
    divided[:3, 3] = divided[3, :3] = loads
    scale = np.diag([friction, friction, torsional, 1.0])
    model = SoftFingerContact(friction, torsional)
    np.testing.assert_allclose(
        model.matrix([first, second, normal, moment]), scale @ divided @ scale, atol=1e-14
    )


@given(SEEDS, FRICTION, TORSIONAL)
def test_soft_finger_without_a_moment_is_the_point_contact(
    seed: int, friction: float, torsional: float
) -> None:
    forces = seeded(seed).standard_normal((20, 3)) * [1.0, 1.0, 3.0]
    forces[:5, :2] = 0.0
    wrenches = np.concatenate([forces, np.zeros((20, 1))], axis=1)
    soft, point = SoftFingerContact(friction, torsional), FrictionContact(friction)
    np.testing.assert_array_equal(soft.violation(wrenches), point.violation(forces))
    semidefinite = np.linalg.eigvalsh(soft.matrix(wrenches))[:, 0] >= -1e-14
    pushing = np.linalg.eigvalsh(point.matrix(forces))[:, 0] >= -1e-14
    np.testing.assert_array_equal(semidefinite, pushing & (forces[:, 2] >= 0.0))


@given(SEEDS, st.floats(0.05, 2.0), st.sampled_from([0.0, 0.5, 0.999]), st.floats(-1.0, 1.0))
def test_soft_finger_with_much_torsional_friction_contains_the_point_contact(
    seed: int, friction: float, share: float, moment: float
) -> None:
    point = FrictionContact(friction)
    force = wrench_of(seeded(seed), point, 2.0, share)
    soft = SoftFingerContact(friction, 1e3)
    assert soft.violation([*force, moment]) == 0.0
    assert least(soft, np.array([*force, moment])) >= -1e-9
    # never more than the point contact: a moment only uses friction up
    beyond = wrench_of(seeded(seed), point, 2.0, 1.001)
    assert soft.violation([*beyond, moment]) >= point.violation(beyond) > 0.0


@given(SEEDS, FRICTION, st.lists(st.floats(0.0, 0.1), min_size=2, max_size=2))
def test_more_torsional_friction_never_needs_more_normal_force(
    seed: int, friction: float, torsional: list[float]
) -> None:
    wrench = seeded(seed).standard_normal(4)
    less, more = sorted(torsional)
    loose, tight = SoftFingerContact(friction, more), SoftFingerContact(friction, less)
    assert loose.violation(wrench) <= tight.violation(wrench)


@given(st.floats(-10.0, 10.0))
def test_frictionless_is_the_point_contact_with_neither_friction_nor_load(normal: float) -> None:
    wrench = [0.0, 0.0, normal]
    expected = FrictionContact(0.0).violation(wrench)
    assert FrictionlessContact().violation([normal]) == expected == max(0.0, -normal)
    np.testing.assert_array_equal(FrictionlessContact().matrix([normal]), [[normal]])


def test_a_load_that_no_normal_force_can_hold_misses_infinitely_much() -> None:
    assert FrictionContact(0.0).violation([1e-9, 0.0, 5.0]) == np.inf
    assert SoftFingerContact(0.5, 0.0).violation([0.0, 0.0, 5.0, 1e-9]) == np.inf
    assert SoftFingerContact(0.0, 0.1).violation([1e-9, 0.0, 5.0, 0.0]) == np.inf
    # too small a coefficient to divide by without overflow
    assert FrictionContact(1e-300).violation([1e10, 0.0, 5.0]) == np.inf


@given(SEEDS, MODELS)
def test_coefficients_are_symmetric_and_matrices_linear_and_batched(
    seed: int, model: ContactModel
) -> None:
    coefficients = model.coefficients()
    width = coefficients.shape[-1]
    assert coefficients.shape == (model.size, width, width)
    np.testing.assert_array_equal(coefficients, np.swapaxes(coefficients, 1, 2))
    np.testing.assert_array_equal(model.matrix(np.eye(model.size)), coefficients)
    batch = seeded(seed).standard_normal((2, 3, model.size))
    assert model.violation(batch).shape == (2, 3)
    assert model.matrix(batch).shape == (2, 3, width, width)
    assert model.violation(batch)[1, 2] == model.violation(batch[1, 2])
    np.testing.assert_allclose(model.matrix(batch)[1, 2], model.matrix(batch[1, 2]), atol=1e-15)
    np.testing.assert_allclose(
        model.matrix(0.3 * batch[0] + 2.0 * batch[1]),
        0.3 * model.matrix(batch[0]) + 2.0 * model.matrix(batch[1]),
        atol=1e-13,
    )


@pytest.mark.parametrize("value", [-1e-9, np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", ["friction", "torsional_friction"])
def test_impossible_friction_is_refused(name: str, value: float) -> None:
    coefficients = {"friction": 0.5, "torsional_friction": 0.01, name: value}
    with pytest.raises(ProblemError, match=f"^{name} must be finite and not negative"):
        SoftFingerContact(**coefficients)
    if name == "friction":
        with pytest.raises(ProblemError, match=r"^friction must be finite and not negative"):
            FrictionContact(value)


@pytest.mark.parametrize("value", [None, "0.5", True, np.bool_(True), [0.5], np.array([0.5]), 1j])
def test_friction_that_is_no_number_is_refused(value: Any) -> None:
    with pytest.raises(ProblemError, match=r"^friction must be a number"):
        FrictionContact(value)


@pytest.mark.parametrize("value", [1, np.float32(0.5), np.int64(1)])
def test_any_real_number_is_a_friction(value: Any) -> None:
    assert FrictionContact(value).violation([float(value), 0.0, 1.0]) == 0.0


@pytest.mark.parametrize("shape", [(), (1,), (2,), (3, 5), (0,)])
def test_wrench_of_the_wrong_size_is_refused(shape: tuple[int, ...]) -> None:
    for model in (FrictionContact(0.5), SoftFingerContact(0.5, 0.01)):
        with pytest.raises(ProblemError, match=r"component\(s\) in its last dimension"):
            model.violation(np.zeros(shape))
        with pytest.raises(ProblemError, match=type(model).__name__):
            model.matrix(np.zeros(shape))
