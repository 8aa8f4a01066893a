"""Holding: good forces hold an object in the simulator, and bad ones drop it."""

import numpy as np
import pytest

from gfo_env.conditions import FRICTION_FACTOR, PRELOAD, STANDARD_GRAVITY
from gfo_env.exceptions import GeometryError
from gfo_env.holding import (
    SHAKE_PROTOCOLS,
    HoldingError,
    ShakePhysics,
    ShakeProtocol,
    commanded_torques,
    random_gravity,
    shake,
)
from gfo_env.simulation import Simulation
from solvers import solve
from tests.support.seeds import seeded
from tests.support.world import grasp_force_problem, held_out_objects, real_grasps
from training.studies.holding.prediction import roc_rows
from training.studies.holding.rates import HoldPlan, disturbed, hold_rows, judge_holding

PROTOCOL = ShakeProtocol()


def test_loads_are_the_weight_and_six_pushes() -> None:
    gravity = np.array([0.0, 3.0, -9.0])
    loads = PROTOCOL.loads(0.2, gravity)
    assert loads.shape == (PROTOCOL.phases, 6)
    np.testing.assert_allclose(loads[0], [0, 0.6, -1.8, 0, 0, 0])
    pushes = loads[1:, :3] - loads[0, :3]
    np.testing.assert_allclose(np.linalg.norm(pushes, axis=1), PROTOCOL.push)
    np.testing.assert_allclose(pushes.sum(axis=0), 0, atol=1e-15)
    assert np.linalg.matrix_rank(pushes) == 3


def test_loads_of_the_weight_protocol_scale_with_the_weight() -> None:
    protocol = SHAKE_PROTOCOLS["weight"]
    gravity, radius = np.array([0.0, 3.0, -9.0]), 0.05
    loads = protocol.loads(0.2, gravity, radius)
    assert loads.shape == (protocol.phases, 6) == (13, 6)
    weight = 0.2 * np.linalg.norm(gravity)
    extra = loads - loads[0]
    np.testing.assert_allclose(
        np.linalg.norm(extra[1:7, :3], axis=1), protocol.weight_push * weight
    )
    torque = protocol.weight_torque * weight * radius
    np.testing.assert_allclose(np.linalg.norm(extra[7:, 3:], axis=1), torque)
    assert not extra[1:7, 3:].any()
    assert not extra[7:, :3].any()
    for block in (extra[1:7, :3], extra[7:, 3:]):
        np.testing.assert_allclose(block.sum(axis=0), 0, atol=1e-15)
        assert np.linalg.matrix_rank(block) == 3
    np.testing.assert_allclose(protocol.loads(0.4, gravity, radius), 2 * loads)
    np.testing.assert_allclose(protocol.disturbances(weight, radius), extra, atol=1e-15)


@pytest.mark.parametrize(
    "settings",
    [
        {"time_step": 0.0},
        {"time_step": np.nan},
        {"iterations": 0},
        {"joint_friction": -0.1},
        {"joint_damping": np.inf},
        {"iterations": 50.5},
        {"time_step": "0.004"},
    ],
)
def test_physics_that_no_simulator_could_use_are_refused(settings) -> None:
    with pytest.raises(HoldingError):
        ShakePhysics(**settings)


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"push": -1.0}, "push"),
        ({"push": "2"}, "push"),
        ({"weight_torque": np.nan}, "weight_torque"),
        ({"phase_time": 0.0}, "phase_time"),
        ({"max_rotation": None}, "max_rotation"),
    ],
)
def test_protocols_that_make_no_sense_are_refused(settings, named) -> None:
    with pytest.raises(HoldingError, match=named):
        ShakeProtocol(**settings)


def test_arrays_of_a_shake_are_checked() -> None:
    held = real_grasps(1)[0]
    columns, hand = 3 * len(held.grasp.contacts), Simulation().hand
    right = {"forces": np.zeros((7, columns)), "gravity": np.array([0.0, 0.0, -9.8])}
    for change, message in (
        ({"forces": np.zeros((columns, 7))}, rf"forces .*\(7, {columns}\).*: transpose it"),
        ({"forces": np.zeros((6, columns))}, rf"forces .*\(7, {columns}\), not \(6, {columns}\)"),
        ({"forces": np.full((7, columns), np.nan)}, "forces must be finite"),
        ({"gravity": np.zeros(2)}, r"gravity .*\(3\), not \(2,\)"),
        ({"gravity": None}, "gravity must be an array of numbers"),
        ({"friction": 0.0}, "friction must be a positive number"),
    ):
        arguments = right | {"friction": 0.5} | change
        with pytest.raises(HoldingError, match=message):
            shake(Simulation(), held.grasp, held.grasp_object, **arguments)
    with pytest.raises(HoldingError, match=rf"forces .*\(\.\.\., {columns}\)"):
        commanded_torques(hand, held.grasp, np.zeros(columns + 3), right["gravity"])
    with pytest.raises(HoldingError, match="gravity"):
        PROTOCOL.loads(0.2, np.zeros((7, 3)))
    gravity = right["gravity"]
    with pytest.raises(GeometryError, match=r"wrench .*\(\.\.\., 6\), not \(3,\)"):
        grasp_force_problem(held.grasp, hand, np.zeros(3), gravity, friction=0.5)
    with pytest.raises(GeometryError, match="gravity must be finite"):
        grasp_force_problem(held.grasp, hand, np.zeros(6), np.nan * gravity, friction=0.5)


@pytest.mark.parametrize("settings", [{"friction_factor": 0.0}, {"preload": -1.0}])
def test_plans_that_make_no_sense_are_refused(settings) -> None:
    with pytest.raises(HoldingError):
        HoldPlan(held_out_objects(), 4, 0, **settings)


def test_gravity_comes_from_all_sides() -> None:
    rng = seeded(0)
    samples = np.array([random_gravity(rng) for _ in range(2000)])
    np.testing.assert_allclose(np.linalg.norm(samples, axis=1), STANDARD_GRAVITY)
    assert np.abs(samples.mean(axis=0)).max() < 0.5


def test_problem_states_the_load_in_the_object_frame() -> None:
    held = real_grasps(1)[0]
    grasp = held.grasp
    gravity = np.array([0.0, 0.0, -STANDARD_GRAVITY])
    wrench = np.array([1.0, 2.0, 3.0, 0.1, 0.2, 0.3])
    problem = grasp_force_problem(
        grasp, Simulation().hand, wrench, gravity, friction=0.5, preload=1.0, torque_scale=0.5
    )
    rotation = grasp.pose.rotation
    np.testing.assert_allclose(rotation @ problem.external_wrench[:3], wrench[:3])
    np.testing.assert_allclose(rotation @ problem.external_wrench[3:], wrench[3:])
    np.testing.assert_allclose(problem.external_torque, grasp.gravity_map @ gravity)
    assert problem.torque_max.tolist() == (0.5 * np.array(Simulation().hand.max_torque)).tolist()
    assert set(problem.normal_min.tolist()) == {1.0}
    batch = grasp_force_problem(
        grasp, Simulation().hand, np.stack([wrench, -wrench]), gravity, friction=0.5
    )
    assert batch.batch_shape == (2,)
    np.testing.assert_allclose(batch.external_wrench[1], -problem.external_wrench)


@pytest.mark.slow
def test_optimal_forces_hold_zero_forces_drop_and_noise_hurts() -> None:
    simulation = Simulation()
    held_by = {"optimal": [], "zero": [], "noisy": []}
    for number, held in enumerate(real_grasps(30)):
        rng = seeded([3, number])
        body = held.grasp_object.with_mass(rng.uniform(0.1, 0.5))
        friction, gravity = rng.uniform(0.4, 1.0), random_gravity(rng)
        problem = grasp_force_problem(
            held.grasp,
            simulation.hand,
            PROTOCOL.loads(body.mass, gravity),
            gravity,
            friction=FRICTION_FACTOR * friction,
            preload=PRELOAD,
        )
        solution = solve(problem)
        if not np.all(solution.status == "optimal"):
            continue
        forces = solution.forces
        size = np.linalg.norm(forces, axis=1, keepdims=True) / np.sqrt(forces.shape[1])
        noise = 0.4 * size * rng.normal(size=forces.shape)
        for name, commanded in (
            ("optimal", forces),
            ("zero", 0.0 * forces),
            ("noisy", forces + noise),
        ):
            result = shake(simulation, held.grasp, body, commanded, gravity, friction=friction)
            assert result.held == (result.phases_held == PROTOCOL.phases)
            held_by[name].append(result.held)
    simulation.close()
    rate = {name: np.mean(values) for name, values in held_by.items()}
    # of the loads that are drawn two in three can be carried, 19 of 30 on one draw
    assert len(held_by["optimal"]) >= 15
    # on fourteen draws of loads 97 % held, 86 % on the worst
    assert rate["optimal"] >= 0.8
    # dry friction of the joints alone holds an object that happens to rest on the hand
    assert rate["zero"] <= 0.1
    assert rate["noisy"] <= rate["optimal"] - 0.3


@pytest.mark.slow
def test_methods_rank_as_they_should_and_margins_foretell_survival() -> None:
    plan = HoldPlan(held_out_objects(), 16, 3)
    outcomes = judge_holding(plan)
    rows = {row["solver"]: row for row in hold_rows(plan, outcomes)}
    exact = rows["dual_newton"]
    assert exact["grasps"] == 16
    assert exact["grasps_shaken"] >= 8
    assert exact["hold_rate"] >= 0.85
    assert abs(rows["conditioned"]["hold_rate"] - exact["hold_rate"]) <= 0.1
    for name in ("equal_squeeze_same_effort", "random_in_cone_same_effort"):
        assert rows[name]["effort_median"] == pytest.approx(exact["effort_median"])
        assert rows[name]["hold_rate"] <= exact["hold_rate"] - 0.2
    assert rows["zero_force"]["hold_rate"] <= 0.1  # what happens to rest on the hand
    margins = {row["predictor"]: row for row in roc_rows(plan, outcomes)}
    assert margins["margin"]["roc_area"] > 0.7
    assert margins["acceleration"]["certified_error_max"] < 1.0
    for row in (*rows.values(), *margins.values()):
        for key in row:
            if key.endswith("_ci"):
                low, high = row[key]
                assert np.isnan(low) or low - 1e-12 <= row[key.removesuffix("_ci")] <= high + 1e-12


def test_random_forces_keep_to_the_cones_and_every_control_to_its_size() -> None:
    rng = seeded(0)
    mask = np.array([[True, True, True, False]] * 5)
    friction = np.where(mask, 0.6, 0.0)
    forces = rng.normal(size=(5, 4, 3)) * mask[..., None]
    made = disturbed(forces.reshape(5, 12), mask, friction, 1)
    size = np.linalg.norm(forces, axis=(1, 2))
    for name in ("equal_squeeze_same_effort", "random_in_cone_same_effort"):
        np.testing.assert_allclose(np.linalg.norm(made[name], axis=1), size)
        vectors = made[name].reshape(5, 4, 3)
        tangent = np.linalg.norm(vectors[..., :2], axis=-1)
        assert np.all(tangent <= friction * vectors[..., 2] + 1e-12)
    for name in made:
        assert not made[name].reshape(5, 4, 3)[:, 3].any()
