"""Margins: accelerations that mechanics knows in closed form, their certificates, ROC areas."""

import numpy as np
import pytest

from solvers import GraspForceProblem, solve
from solvers.duality import project_cones
from tests.support.problems import feasible_problem, random_problem, random_rotation
from tests.support.seeds import seeded
from training.studies.holding.margins import predicted_acceleration, roc_area

MASS = 0.3
INERTIA = np.diag([MASS] * 3 + [2e-4, 3e-4, 4e-4])
RADIUS = 0.05


def palm_contact(
    wrench: list[float], friction: float = 0.5, contacts: int = 1
) -> GraspForceProblem:
    """Contacts under the centre of mass that no joint moves; the normal is z."""
    padding = np.zeros((6, 9))
    padding[:3, :3] = np.eye(3)
    # two frictionless contacts that the load never presses give the grasp map its rank
    for column, arm in enumerate([(0.04, 0, 0), (0, 0.04, 0)], start=1):
        force = np.eye(3)
        padding[:3, 3 * column : 3 * column + 3] = force
        padding[3:, 3 * column : 3 * column + 3] = np.cross(arm, force).T
    return GraspForceProblem(
        grasp_map=padding,
        hand_jacobian=np.zeros((9, 1)),
        friction=[friction, 0.0, 0.0],
        torque_min=[-1.0],
        torque_max=[1.0],
        external_wrench=wrench,
    )


def test_a_load_that_the_palm_carries_moves_nothing() -> None:
    problem = palm_contact([0.4, 0.2, -1.0, 0, 0, 0])
    found = predicted_acceleration(problem, np.zeros(9), INERTIA, RADIUS)
    assert found.value <= found.error + 1e-12
    assert found.error < 1e-2


def test_a_load_that_pulls_away_accelerates_by_force_over_mass() -> None:
    problem = palm_contact([0.0, 0.0, 2.0, 0, 0, 0])
    found = predicted_acceleration(problem, np.zeros(9), INERTIA, RADIUS)
    assert found.value == pytest.approx(2.0 / MASS, abs=found.error + 1e-9)
    assert found.error < 1e-2


def test_optimal_forces_of_feasible_problems_leave_the_object_at_rest() -> None:
    rng = seeded(2)
    checked = 0
    for _ in range(30):
        problem = random_problem(rng, torque_min=-2.0, torque_max=2.0)
        solution = solve(problem)
        if solution.status != "optimal":
            continue
        found = predicted_acceleration(problem, solution.forces, INERTIA, RADIUS)
        assert found.value <= found.error + 1e-6
        assert found.error < 0.1
        checked += 1
    assert checked > 10


def test_without_joints_that_give_way_the_forces_are_a_projection_on_the_cone() -> None:
    """A unit mass matrix and one contact at the centre: the least residual is a projection."""
    rng = seeded(5)
    for _ in range(20):
        load = rng.normal(size=3)
        problem = palm_contact([*load, 0, 0, 0])
        found = predicted_acceleration(problem, np.zeros(9), INERTIA, RADIUS)
        cone = problem.replace(normal_min=None)
        nearest = project_cones(cone, np.tile(-load, (3, 1)))[0]
        expected = np.linalg.norm(nearest + load) / MASS
        # the other contacts can only help
        assert found.value <= expected + found.error + 1e-6


def test_prediction_does_not_depend_on_the_object_frame() -> None:
    rng = seeded(8)
    problem = random_problem(rng)
    forces = rng.normal(size=problem.grasp_map.shape[1])
    turn = np.kron(np.eye(2), random_rotation(rng))
    turned = problem.replace(
        grasp_map=turn @ problem.grasp_map, external_wrench=turn @ problem.external_wrench
    )
    one = predicted_acceleration(problem, forces, INERTIA, RADIUS)
    other = predicted_acceleration(turned, forces, turn @ INERTIA @ turn.T, RADIUS)
    assert other.value == pytest.approx(one.value, abs=one.error + other.error + 1e-9)


def test_torques_beyond_the_limits_do_nothing() -> None:
    rng = seeded(9)
    problem = random_problem(rng, torque_min=-0.01, torque_max=0.01, external_torque=0.0)
    forces = 100.0 * np.abs(rng.normal(size=problem.grasp_map.shape[1]))
    torque = np.abs(forces @ problem.hand_jacobian)
    assert np.all((torque > 0.01) | (torque == 0.0))
    one = predicted_acceleration(problem, forces, INERTIA, RADIUS)
    other = predicted_acceleration(problem, 2.0 * forces, INERTIA, RADIUS)
    assert one.value == other.value


def test_joints_that_do_not_move_carry_what_the_cones_allow() -> None:
    problem = feasible_problem(seeded(9))
    nothing = np.zeros(problem.grasp_map.shape[1])
    loose = predicted_acceleration(problem, nothing, INERTIA, RADIUS, joint_friction=0.0)
    stuck = predicted_acceleration(problem, nothing, INERTIA, RADIUS, joint_friction=100.0)
    assert stuck.value <= stuck.error + 1e-6
    assert loose.value > 0.1  # 0.33 to 12.3 for 21 draws, with an error of 0.001


def test_roc_area_is_the_share_of_pairs_in_order() -> None:
    rng = seeded(1)
    scores = rng.integers(0, 5, 40).astype(float)
    held = rng.random(40) < 0.4
    good, bad = scores[held], scores[~held]
    pairs = (good[:, None] > bad).mean() + 0.5 * (good[:, None] == bad).mean()
    assert roc_area(scores, held) == pytest.approx(pairs)
    assert roc_area(held.astype(float), held) == 1.0
    assert np.isnan(roc_area(scores, np.ones(40, dtype=bool)))
