"""Intervals over objects: they cover, they widen where grasps of an object are alike."""

import numpy as np

from tests.support.seeds import seeded
from training.reports.intervals import Interval, object_interval


def test_interval_covers_the_mean_as_often_as_it_says() -> None:
    rng = seeded(0)
    hits = 0
    for seed in range(60):
        effect = rng.normal(size=40)
        ids = np.repeat(np.arange(40), 5).astype(str)
        values = np.repeat(effect, 5) + 0.1 * rng.normal(size=200)
        low, high = object_interval(values, ids, seed=seed)
        hits += low <= 0.0 <= high
    assert 50 <= hits <= 60


def test_alike_grasps_do_not_count_as_independent() -> None:
    values = seeded(1).normal(size=20)
    many = np.repeat(values, 10)
    by_object = object_interval(many, np.repeat(np.arange(20), 10).astype(str))
    by_grasp = object_interval(many, np.arange(200).astype(str))
    assert (by_object[1] - by_object[0]) > 2.5 * (by_grasp[1] - by_grasp[0])


def test_degenerate_cases() -> None:
    assert object_interval(np.ones(5), np.array(list("aabbc"))) == (1.0, 1.0)
    assert np.isnan(object_interval(np.zeros(0), np.zeros(0, dtype=str))).all()


def test_intervals_are_written_in_one_form() -> None:
    interval = Interval(0.25, 0.125, 0.5)
    assert str(interval) == f"{interval}" == "0.250 [0.125, 0.500]"
    assert f"{interval:+.1%}" == "+25.0% [+12.5%, +50.0%]"
    assert interval.ends == [0.125, 0.5]


def test_an_interval_of_nothing_is_a_word() -> None:
    nothing = Interval.of(np.zeros(0), np.zeros(0, dtype=str))
    assert f"{nothing:+.3f}" == str(nothing) == "none"
    assert Interval.of(np.array([1.0, 3.0]), np.array(["a", "a"])) == Interval(2.0, 2.0, 2.0)
