"""Holding: good forces hold an object in the simulator, and bad ones drop it."""

import numpy as np
import pytest

from gfo_env.conditions import STANDARD_GRAVITY
from gfo_env.holding import ShakeProtocol, random_gravity, shake
from gfo_env.simulation import Simulation
from solvers import solve
from tests.world import grasp_force_problem, real_grasps

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


def test_gravity_comes_from_all_sides() -> None:
    rng = np.random.default_rng(0)
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
        rng = np.random.default_rng([3, number])
        body = held.grasp_object.with_mass(rng.uniform(0.1, 0.5))
        friction, gravity = rng.uniform(0.4, 1.0), random_gravity(rng)
        problem = grasp_force_problem(
            held.grasp,
            simulation.hand,
            PROTOCOL.loads(body.mass, gravity),
            gravity,
            friction=0.8 * friction,
            preload=2.0,
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
    assert len(held_by["optimal"]) >= 20
    assert rate["optimal"] >= 0.8
    assert rate["zero"] == 0.0
    assert rate["noisy"] <= rate["optimal"] - 0.3
