import dataclasses

import numpy as np
import pytest

from gfo_env.grasps import GraspTable
from solvers import solve
from tests.support.grasp_tables import random_table
from tests.support.seeds import seeded
from training.problems.sampling import SamplingSettings, sample_problems


@pytest.fixture(scope="module")
def table() -> GraspTable:
    return random_table(seeded(0), 400)


def test_same_seed_same_problems(table: GraspTable) -> None:
    first, again, other = (sample_problems(table, seeded(s)) for s in (1, 1, 2))
    for name in ("external_wrench", "friction", "torque_max", "normal_min", "normal_max"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    assert not np.any(np.all(first.external_wrench == other.external_wrench, axis=1))


def test_ranges_and_branches(table: GraspTable) -> None:
    settings = SamplingSettings()
    problem = sample_problems(table, seeded(0), settings)
    mask = problem.contact_mask
    force, torque = problem.external_wrench[:, :3], problem.external_wrench[:, 3:]
    size = np.linalg.norm(force, axis=1)
    assert size.max() <= settings.mass[1] * 9.80665 + settings.push
    assert np.any((size == 0) & (np.linalg.norm(torque, axis=1) > 0))  # pure torque
    assert np.any((size > 0) & np.all(torque == 0, axis=1))  # weight alone
    low, high = settings.friction
    assert problem.friction[mask].min() >= 0.5 * low
    assert problem.friction[mask].max() <= 1.5 * high
    spread = np.ptp(np.where(mask, problem.friction, problem.friction[:, :1]), axis=1)
    assert 0.1 < np.mean(spread > 0) < 0.6
    finite = np.isfinite(problem.torque_max)
    assert 0.0 < np.mean(~finite.any(axis=1)) < 0.15
    ratio = (problem.torque_max / table.max_torque)[finite]
    assert settings.torque_scale[0] <= ratio.min()
    assert ratio.max() <= settings.torque_scale[1]
    assert 0.05 < np.mean(np.any(problem.torque_max != -problem.torque_min, axis=1)) < 0.4
    assert problem.normal_min.max() <= settings.preload
    assert 0.2 < np.mean(np.all(problem.normal_min == 0, axis=1)) < 0.7
    capped = np.isfinite(problem.normal_max) & mask
    assert 0.2 < capped[mask].mean() < 0.7
    assert np.all((problem.normal_max - problem.normal_min)[capped] > 0.99 * settings.cap[0])


def test_gravity_loads_object_and_joints_alike(table: GraspTable) -> None:
    still = SamplingSettings(mass=(0.2, 0.2), push=0.0, torque=0.0)
    problem = sample_problems(table, seeded(0), still)
    loaded = np.linalg.norm(problem.external_wrench[:, :3], axis=1) > 0
    rotation, force = table.object_rotation[loaded], problem.external_wrench[loaded, :3]
    gravity = np.einsum("bij,bj->bi", rotation, force) / 0.2
    np.testing.assert_allclose(np.linalg.norm(gravity, axis=1), 9.80665)
    expected = np.einsum("bij,bj->bi", table.gravity_map[loaded], gravity)
    np.testing.assert_allclose(problem.external_torque[loaded], expected)


def test_padding_is_trimmed(table: GraspTable) -> None:
    small = table[table.contact_mask.sum(axis=1) <= 4]
    problem = sample_problems(small, seeded(0))
    assert problem.n_contacts == 4
    np.testing.assert_array_equal(problem.contact_mask, small.contact_mask[:, :4])


def test_feasible_and_infeasible_problems_come(table: GraspTable) -> None:
    problem = sample_problems(table[:100], seeded(0))
    status = solve(problem, "clarabel").status
    assert 0.3 < np.mean(status == "optimal") < 0.99
    assert np.mean(status == "infeasible") > 0.01


def test_settings_widen_the_ranges(table: GraspTable) -> None:
    settings = dataclasses.replace(SamplingSettings(), push=100.0)
    problem = sample_problems(table, seeded(0), settings)
    assert np.linalg.norm(problem.external_wrench[:, :3], axis=1).max() > 50.0


def test_hard_problems_are_hard_each_in_one_way_and_leave_the_others_alone(
    table: GraspTable,
) -> None:
    plain = sample_problems(table, seeded(0))
    some = sample_problems(table, seeded(0), SamplingSettings(hard=0.5))
    fields = ("friction", "torque_max", "normal_max", "external_wrench")
    ways = []
    for name in fields:
        before, after = getattr(plain, name), getattr(some, name)
        differs = (before != after) & ~(np.isinf(before) & np.isinf(after))
        ways.append(np.any(differs, axis=1))
    changed = np.sum(ways, axis=0)
    assert changed.max() == 1
    assert 0.4 < changed.mean() < 0.6
    slippery, weak, capped, heavy = ways
    assert min(np.mean(way) for way in ways) > 0.05
    assert some.friction[slippery].max() <= 0.2 + 0.2 * (1.2 - 0.2)
    assert np.all(some.torque_max[weak] <= 0.2 * table.max_torque)
    room = (some.normal_max - some.normal_min)[capped]
    assert np.all((room >= 4.0 - 1e-9) & (room <= 8.0 + 1e-9))
    ratio = np.linalg.norm(some.external_wrench, axis=1) / np.linalg.norm(
        plain.external_wrench, axis=1
    )
    assert np.all((ratio[heavy] > 1.0) & (ratio[heavy] <= 4.0))
    np.testing.assert_array_equal(some.normal_min, plain.normal_min)
    infeasible = [
        np.mean(solve(problem[:100], "clarabel").status == "infeasible")
        for problem in (plain, some)
    ]
    assert infeasible[1] > infeasible[0]
