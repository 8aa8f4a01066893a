"""Schedules of loads: one change at a time, of the size that the settings say."""

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gfo_env.conditions import STANDARD_GRAVITY
from gfo_env.mdp.loads import LOAD_STEPS, LoadSchedule, LoadSettings, draw_loads
from tests.support.seeds import seeded

SETTINGS = LoadSettings()
KINDS = ("push", "twist", "turn", "mass", "friction")
NEUTRAL = {
    "push": 0.0,
    "twist": 0.0,
    "turn": 0.0,
    "mass_change": (1.0, 1.0),
    "friction_change": (1.0, 1.0),
}
STILL = replace(SETTINGS, **NEUTRAL)  # type: ignore[arg-type]

seeds = st.integers(0, 2**32 - 1)
lengths = st.integers(1, 10 * LOAD_STEPS + 3)


def draw(
    seed: int, steps: int = 7 * LOAD_STEPS, settings: LoadSettings = SETTINGS, **fixed: Any
) -> LoadSchedule:
    return draw_loads(settings, seeded(seed), steps, **fixed)


def only(kind: str) -> LoadSettings:
    name = kind if kind in NEUTRAL else f"{kind}_change"
    return replace(STILL, **{name: getattr(SETTINGS, name)})


def arrays(schedule: LoadSchedule) -> dict[str, np.ndarray]:
    return {field.name: getattr(schedule, field.name) for field in fields(schedule)}


def changes(schedule: LoadSchedule, begin: int) -> set[str]:
    """What kinds of load the load that begins at a step is, from the arrays alone."""
    during, before = slice(begin, begin + LOAD_STEPS), begin - 1
    found = set()
    if schedule.push[during, :3].any():
        found.add("push")
    if schedule.push[during, 3:].any():
        found.add("twist")
    if (schedule.gravity[during] != schedule.gravity[before]).any():
        found.add("turn")
    if (schedule.mass[during] != schedule.mass[before]).any():
        found.add("mass")
    if (schedule.friction[during] != schedule.friction[before]).any():
        found.add("friction")
    return found


@given(seed=seeds, steps=lengths)
def test_shapes_sizes_and_the_first_load(seed: int, steps: int) -> None:
    schedule = draw(seed, steps)
    shapes = {name: array.shape for name, array in arrays(schedule).items()}
    assert shapes == {
        "gravity": (steps, 3), "push": (steps, 6), "mass": (steps,), "friction": (steps,)
    }  # fmt: skip
    assert len(schedule) == steps
    np.testing.assert_allclose(
        np.linalg.norm(schedule.gravity, axis=1), STANDARD_GRAVITY, rtol=1e-12
    )
    first = slice(0, min(steps, LOAD_STEPS))
    assert not schedule.push[first].any()
    for name in ("gravity", "mass", "friction"):
        array = getattr(schedule, name)
        np.testing.assert_array_equal(array[first], array[[0] * first.stop])
    assert SETTINGS.mass_range[0] <= schedule.mass[0] <= SETTINGS.mass_range[1]
    assert SETTINGS.friction_range[0] <= schedule.friction[0] <= SETTINGS.friction_range[1]


@given(seed=seeds, steps=lengths)
def test_every_later_load_is_one_change_of_the_right_size(seed: int, steps: int) -> None:
    schedule = draw(seed, steps)
    for begin in range(LOAD_STEPS, steps, LOAD_STEPS):
        during = slice(begin, begin + LOAD_STEPS)
        (kind,) = changes(schedule, begin)
        pushes = schedule.push[during]
        # pushes and twists last for the load, and no longer
        np.testing.assert_array_equal(pushes, pushes[[0] * len(pushes)])
        if kind in ("push", "twist"):
            size, part = (2.0, slice(0, 3)) if kind == "push" else (0.05, slice(3, 6))
            assert np.linalg.norm(pushes[0, part]) == pytest.approx(size, rel=1e-12)
            assert np.linalg.norm(pushes[0]) == pytest.approx(size, rel=1e-12)
        for name, share in (("mass", SETTINGS.mass_change), ("friction", SETTINGS.friction_change)):
            values = getattr(schedule, name)
            assert len(set(values[during])) == 1
            if kind == name:
                assert share[0] <= values[begin] / values[0] <= share[1]


@given(seed=seeds, steps=lengths)
def test_turns_rotate_gravity_evenly_about_a_horizontal_axis(seed: int, steps: int) -> None:
    schedule = draw(seed, steps, only("turn"))
    for begin in range(LOAD_STEPS, steps, LOAD_STEPS):
        down = schedule.gravity[begin - 1]
        during = schedule.gravity[begin : begin + LOAD_STEPS]
        cosines = during @ down / STANDARD_GRAVITY**2
        sines = np.linalg.norm(np.cross(down, during), axis=1) / STANDARD_GRAVITY**2
        expected = SETTINGS.turn * np.arange(1, len(during) + 1) / LOAD_STEPS
        np.testing.assert_allclose(np.arctan2(sines, cosines), expected, atol=1e-9)
        # all in one plane through the old gravity: the axis is perpendicular to it, and stays
        axes = np.cross(down, during) / (STANDARD_GRAVITY**2 * sines[:, None])
        np.testing.assert_allclose(axes, axes[[0] * len(axes)], atol=1e-9)
        turned = Rotation.from_rotvec(expected[-1] * axes[0]).apply(down)
        np.testing.assert_allclose(turned, during[-1], atol=1e-9)


@given(seed=seeds, kind=st.sampled_from(KINDS))
def test_factors_are_relative_to_the_beginning(seed: int, kind: str) -> None:
    """However many changes came before: they do not pile up."""
    schedule = draw(seed, 100 * LOAD_STEPS, only(kind))
    for begin in range(LOAD_STEPS, len(schedule), LOAD_STEPS):
        assert changes(schedule, begin) == {kind}
    for name in ("mass", "friction"):
        values, (low, high) = getattr(schedule, name), getattr(SETTINGS, f"{name}_change")
        ratio = values[LOAD_STEPS:] / values[0]
        assert ((low <= ratio) & (ratio <= high)).all()
        if kind == name:
            assert ratio.min() < low + 0.1 * (high - low)
            assert ratio.max() > high - 0.1 * (high - low)
        else:
            assert set(ratio) == {1.0}


@given(
    seed=seeds,
    fixed=st.fixed_dictionaries(
        {},
        optional={
            "mass": st.floats(0.01, 3.0),
            "friction": st.floats(0.05, 2.0),
            "gravity": st.tuples(*[st.floats(-10.0, 10.0)] * 3),
        },
    ),
)
def test_what_is_fixed_does_not_shift_what_is_drawn_later(seed: int, fixed: dict[str, Any]) -> None:
    free, bound = draw(seed), draw(seed, **fixed)
    np.testing.assert_array_equal(free.push, bound.push)
    for name in ("mass", "friction"):
        one, other = getattr(free, name), getattr(bound, name)
        assert other[0] == fixed.get(name, one[0])
        np.testing.assert_allclose(one / one[0], other / other[0], rtol=1e-12)
    if "gravity" in fixed:
        np.testing.assert_array_equal(bound.gravity[0], fixed["gravity"])
        sizes = np.linalg.norm(bound.gravity, axis=1)
        np.testing.assert_allclose(sizes, np.linalg.norm(fixed["gravity"]), rtol=1e-9)
    else:
        np.testing.assert_array_equal(free.gravity, bound.gravity)


def test_no_gravity_stays_none() -> None:
    schedule = draw(3, 60 * LOAD_STEPS, only("turn"), gravity=np.zeros(3))
    assert not schedule.gravity.any()
    assert not schedule.wrench(len(schedule) - 1).any()


@given(seed=seeds, neutral=st.sets(st.sampled_from(tuple(NEUTRAL))))
def test_neutral_settings_give_no_such_loads(seed: int, neutral: set[str]) -> None:
    settings = replace(SETTINGS, **{name: NEUTRAL[name] for name in neutral})  # type: ignore[arg-type]
    absent = {name.removesuffix("_change") for name in neutral}
    assert settings.kinds == tuple(kind for kind in KINDS if kind not in absent)
    schedule = draw(seed, 30 * LOAD_STEPS, settings)
    for begin in range(LOAD_STEPS, len(schedule), LOAD_STEPS):
        found = changes(schedule, begin)
        assert len(found) == bool(settings.kinds)
        assert found <= set(settings.kinds)


def test_kinds_have_equal_chances() -> None:
    schedule = draw(0, 5001 * LOAD_STEPS)
    counts = dict.fromkeys(KINDS, 0)
    for begin in range(LOAD_STEPS, len(schedule), LOAD_STEPS):
        (kind,) = changes(schedule, begin)
        counts[kind] += 1
    # 1,000 each are expected; 5 standard deviations are 141
    assert all(abs(count - 1000) < 141 for count in counts.values())


@given(seed=seeds, step=st.integers(0, 7 * LOAD_STEPS - 1))
def test_wrenches(seed: int, step: int) -> None:
    schedule = draw(seed)
    weight = schedule.mass[step] * schedule.gravity[step]
    wrench = schedule.wrench(step)
    np.testing.assert_allclose(wrench[:3] - weight, schedule.push[step, :3], atol=1e-12)
    np.testing.assert_array_equal(wrench[3:], schedule.push[step, 3:])
    np.testing.assert_array_equal(
        schedule.known_wrench(step), [*(schedule.mass[0] * schedule.gravity[step]), 0, 0, 0]
    )
    later = schedule.from_step(step)
    assert len(later) == len(schedule) - step
    for one, other in zip(arrays(schedule).values(), arrays(later).values(), strict=True):
        np.testing.assert_array_equal(one[step:], other)
    # a schedule belongs to nobody else: asking for a wrench changes nothing
    np.testing.assert_array_equal(schedule.wrench(step), wrench)


@given(seed=seeds)
def test_changes_and_turns_are_what_differs_from_the_step_before(seed: int) -> None:
    schedule = draw(seed)
    assert len(schedule.changes) == len(schedule.turns) == len(schedule)
    assert not schedule.changes[0]
    assert not schedule.turns[0]
    for step in range(1, len(schedule)):
        now, before = ((schedule.mass[k], schedule.friction[k]) for k in (step, step - 1))
        assert schedule.changes[step] is (now != before)
        turned = (schedule.gravity[step] != schedule.gravity[step - 1]).any()
        assert schedule.turns[step] is bool(turned)


@given(
    seed=seeds,
    mass_change=st.sampled_from([(0.5, 0.9), (0.7, 1.3), (1.2, 2.0)]),
    friction_change=st.sampled_from([(0.5, 0.9), (0.8, 1.0), (1.0, 1.5)]),
)
def test_limits_hold(
    seed: int, mass_change: tuple[float, float], friction_change: tuple[float, float]
) -> None:
    settings = replace(SETTINGS, mass_change=mass_change, friction_change=friction_change)
    schedule = draw(seed, settings=settings)
    heaviest = settings.mass_range[1] * max(mass_change[1], 1.0)
    roughest = settings.friction_range[1] * max(friction_change[1], 1.0)
    assert schedule.mass.max() <= heaviest * (1 + 1e-12)
    assert schedule.friction.max() <= roughest * (1 + 1e-12)


def test_equal_seeds_give_equal_bits() -> None:
    for one, other in zip(arrays(draw(5)).values(), arrays(draw(5)).values(), strict=True):
        np.testing.assert_array_equal(one, other)
    assert not np.array_equal(draw(5).gravity, draw(6).gravity)
