"""What the simulator gets right: Newton, Euler, Coulomb, and the same answer twice."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from gfo_env.conditions import STANDARD_GRAVITY
from gfo_env.hand import BARRETT_BH8_280
from gfo_env.holding import ShakePhysics, ShakeProtocol, commanded_torques, shake
from gfo_env.objects import GraspObject, ObjectSet
from gfo_env.pose import Pose
from gfo_env.simulation import TIME_STEP, Simulation
from solvers import solve
from tests.support.seeds import seeded
from tests.support.world import grasp_force_problem, held_out_objects, real_grasps

BOX = np.array([0.03, 0.02, 0.01])
MARGIN = 0.001
"""m, by which the engine keeps bodies apart."""


@pytest.fixture
def simulation():
    simulation = Simulation()
    yield simulation
    simulation.close()


@pytest.fixture
def box(tmp_path: Path) -> GraspObject:
    trimesh.creation.box(BOX).export(tmp_path / "box.obj")
    objects = ObjectSet(str(tmp_path), "all")
    return objects[objects.object_ids[0]].with_mass(0.3)


def in_the_air() -> Pose:
    return Pose(np.array([0.2, -0.3, 1.0]), Rotation.random(rng=seeded(4)).as_matrix())


def launch(simulation: Simulation, linear: np.ndarray, angular: np.ndarray) -> None:
    simulation.bullet.resetBaseVelocity(
        simulation.object_id,
        linear.tolist(),
        angular.tolist(),
        physicsClientId=simulation.client,
    )


def spin_error(simulation: Simulation, body: GraspObject, time_step: float) -> tuple[float, float]:
    """Relative change of angular momentum and of energy in a quarter of a second of free spin."""
    start = in_the_air()
    simulation.load(body, start, np.zeros(8), friction=0.5, time_step=time_step)
    linear, angular = np.array([0.3, -0.2, 0.1]), np.array([8.0, 3.0, -5.0])
    launch(simulation, linear, angular)

    def state() -> tuple[np.ndarray, float]:
        rotation = simulation.object_pose().rotation
        velocity, spin = simulation.object_velocity()
        momentum = rotation @ body.inertia @ rotation.T @ spin
        return momentum, 0.5 * body.mass * velocity @ velocity + 0.5 * momentum @ spin

    momentum, energy = state()
    for _ in range(round(0.25 / time_step)):
        simulation.step()
    later, left = state()
    np.testing.assert_allclose(simulation.object_velocity()[0], linear, rtol=1e-12)
    change = np.linalg.norm(later - momentum) / np.linalg.norm(momentum)
    return float(change), abs(left - energy) / energy


def test_free_flight_conserves_momentum_and_energy_to_first_order(simulation) -> None:
    objects = held_out_objects()
    for object_id in objects.object_ids[:4]:
        body = objects[object_id]
        coarse = spin_error(simulation, body, TIME_STEP)
        fine = spin_error(simulation, body, TIME_STEP / 4)
        assert max(coarse) < 0.1
        for rough, smooth in zip(coarse, fine, strict=True):
            assert smooth < 0.4 * rough + 1e-9


def test_a_fall_gains_the_energy_it_should_to_first_order(simulation) -> None:
    body = held_out_objects()[held_out_objects().object_ids[0]]
    gravity, time = np.array([0.0, 0.0, -STANDARD_GRAVITY]), 0.25
    for time_step in (TIME_STEP, TIME_STEP / 4):
        simulation.load(body, in_the_air(), np.zeros(8), friction=0.5, time_step=time_step)
        simulation.set_gravity(gravity)
        for _ in range(round(time / time_step)):
            simulation.step()
        fallen = in_the_air().position[2] - simulation.object_pose().position[2]
        # semi-implicit Euler: the speed is exact, the path half a step ahead
        exact = 0.5 * STANDARD_GRAVITY * time * (time + time_step)
        assert fallen == pytest.approx(exact, rel=1e-6)
        speed = np.linalg.norm(simulation.object_velocity()[0])
        assert speed == pytest.approx(STANDARD_GRAVITY * time, rel=1e-9)


def test_a_push_accelerates_by_force_over_mass(simulation, box) -> None:
    push = np.array([1.0, -2.0, 0.5, 0.0, 0.0, 0.0])
    for mass in (0.1, 0.5):
        simulation.load(box.with_mass(mass), in_the_air(), np.zeros(8), friction=0.5)
        simulation.advance(48, np.zeros(8), push)
        linear, angular = simulation.object_velocity()
        np.testing.assert_allclose(linear, push[:3] / mass * 48 * TIME_STEP, rtol=1e-9)
        np.testing.assert_allclose(angular, 0.0, atol=1e-9)


@pytest.mark.parametrize("friction", [0.4, 0.7, 1.0])
def test_a_block_on_the_palm_slips_at_the_friction_angle(simulation, box, friction) -> None:
    (height,) = BARRETT_BH8_280.surface_height(np.zeros((1, 3)))
    pose = Pose(np.array([0.0, -0.01, height + BOX[2] / 2 + MARGIN]), np.eye(3))
    slipped = []
    for angle in np.arctan(friction) + np.deg2rad([-1.0, 1.0]):
        simulation.load(box, pose, np.zeros(8), friction=friction)
        simulation.drive(BARRETT_BH8_280.joint_names, 0.0, 50.0)
        simulation.set_gravity(STANDARD_GRAVITY * np.array([np.sin(angle), 0.0, -np.cos(angle)]))
        for _ in range(120):
            simulation.step()
        moved = np.linalg.norm((simulation.object_pose().position - pose.position)[:2])
        slipped.append(moved)
    # half a second down a slope of one degree more than holds: about 2 cm
    assert slipped[0] < 5e-4
    assert slipped[1] > 5e-3


def test_measured_contact_forces_stay_in_the_friction_cone(simulation) -> None:
    ratios = []
    for number, held in enumerate(real_grasps(6)):
        friction = 0.5
        gravity = STANDARD_GRAVITY * np.eye(3)[number % 3]
        grasp = held.grasp
        problem = grasp_force_problem(
            grasp, simulation.hand, np.append(0.2 * gravity, np.zeros(3)), gravity, friction=0.4
        )
        torques = commanded_torques(
            simulation.hand, grasp, np.nan_to_num(solve(problem).forces), gravity
        )
        simulation.load(
            held.grasp_object.with_mass(0.2), grasp.pose, grasp.joint_angles, friction=friction
        )
        simulation.set_gravity(gravity)
        for _ in range(60):
            simulation.advance(1, torques, np.zeros(6))
            raw = simulation.contacts()
            normal = np.einsum("ki,ki->k", raw.forces, raw.normals)
            tangent = np.linalg.norm(raw.forces - normal[:, None] * raw.normals, axis=1)
            ratios += (tangent / np.maximum(normal, 1e-9))[normal > 1e-3].tolist()
    assert len(ratios) > 500
    assert max(ratios) <= 0.5 * (1 + 1e-6)
    assert np.mean(np.array(ratios) > 0.45) > 0.01


def test_a_shake_replays_to_the_bit_whatever_was_shaken_before(simulation) -> None:
    first, second = real_grasps(2)
    gravity = np.array([0.0, 0.0, -STANDARD_GRAVITY])
    protocol = ShakeProtocol(phase_time=0.1)

    def run(held, physics: ShakePhysics) -> tuple:
        forces = np.tile([0.0, 0.0, 3.0], (7, len(held.grasp.contacts)))
        result = shake(
            simulation,
            held.grasp,
            held.grasp_object.with_mass(0.3),
            forces,
            gravity,
            friction=0.8,
            protocol=protocol,
            physics=physics,
        )
        return result.phases_held, result.displacement, result.rotation

    usual, other = ShakePhysics(), ShakePhysics(TIME_STEP / 2, 30, 0.03, 0.01)
    before = run(first, usual)
    assert run(second, other) != before
    assert run(first, other) != before
    assert run(first, usual) == before
