"""Solvers on real grasps of held-out objects: two forms of the problem, one optimum."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gfo_env.contacts import grasp_map, is_force_closure
from gfo_env.hand import BARRETT_BH8_280
from gfo_env.holding import random_gravity
from solvers import GraspForceProblem, solve
from tests.support.seeds import seeded
from tests.support.world import grasp_force_problem, real_grasps


def problems(count: int, objective: str = "min_norm") -> GraspForceProblem:
    """A weight and a push for each grasp, with preloads, caps and torque limits that can bind."""
    built = []
    for number, held in enumerate(real_grasps(count)):
        rng = seeded([4, number])
        gravity = random_gravity(rng)
        wrench = np.concatenate([0.3 * gravity + rng.normal(size=3), 0.02 * rng.normal(size=3)])
        built.append(
            grasp_force_problem(
                held.grasp,
                BARRETT_BH8_280,
                wrench,
                gravity,
                friction=rng.uniform(0.3, 0.9),
                preload=rng.choice([0.0, 1.0]),
                cap=rng.choice([15.0, np.inf]),
                torque_scale=rng.uniform(0.15, 1.0),
            )
        )
    return GraspForceProblem.stack(built).replace(objective=objective)


@pytest.mark.slow
def test_lmi_and_cone_form_agree_on_200_real_grasps() -> None:
    batch = problems(200)
    cone, lmi = solve(batch, "clarabel"), solve(batch, "lmi")
    solved = cone.status == "optimal"
    assert set(cone.status.tolist()) <= {"optimal", "infeasible"}
    assert 120 <= solved.sum() < 200
    np.testing.assert_array_equal(lmi.status == "optimal", solved)
    np.testing.assert_allclose(lmi.objective[solved], cone.objective[solved], rtol=1e-6)
    size = np.linalg.norm(cone.forces[solved], axis=1)
    apart = np.linalg.norm(lmi.forces[solved] - cone.forces[solved], axis=1)
    assert np.max(apart / size) < 1e-4
    assert np.median(apart / size) < 1e-6


def test_sum_of_normal_forces_needs_no_more_than_the_least_norm_forces() -> None:
    least_norm = solve(problems(30))
    least_sum = solve(problems(30, "sum_normal"))
    np.testing.assert_array_equal(least_norm.status, least_sum.status)
    solved = least_norm.status == "optimal"
    assert solved.sum() >= 15
    normal = least_norm.forces.reshape(30, -1, 3)[solved, :, 2].sum(axis=1)
    assert np.all(least_sum.objective[solved] <= normal * (1 + 1e-7))
    assert np.any(least_sum.objective[solved] < 0.99 * normal)


def test_optimum_does_not_depend_on_the_object_frame() -> None:
    wrench = np.array([1.0, -0.5, -2.0, 0.01, 0.02, -0.01])
    turn = Rotation.random(rng=seeded(0)).as_matrix()
    carried = 0
    for held in real_grasps(4):
        grasp = held.grasp
        problem = grasp_force_problem(grasp, BARRETT_BH8_280, wrench, np.zeros(3), friction=0.6)
        moved = problem.replace(
            grasp_map=grasp_map(grasp.contacts.positions @ turn.T, turn @ grasp.contacts.frames),
            external_wrench=(wrench.reshape(2, 3) @ grasp.pose.rotation @ turn.T).ravel(),
        )
        here, there = solve(problem), solve(moved)
        assert here.status == there.status
        np.testing.assert_allclose(there.forces, here.forces, atol=1e-7)
        carried += str(here.status) == "optimal"
    assert carried >= 1


def test_force_closure_with_strong_joints_can_carry_any_load() -> None:
    rng = seeded(1)
    closed = 0
    for held in real_grasps(30):
        contacts = held.grasp.contacts
        friction = np.full(len(contacts), 0.5)
        wrenches = rng.normal(size=(6, 6)) * [1, 1, 1, 0.03, 0.03, 0.03]
        problem = grasp_force_problem(
            held.grasp, BARRETT_BH8_280, wrenches, np.zeros(3), friction=0.5, torque_scale=1e6
        )
        if is_force_closure(contacts.positions, contacts.normals, friction):
            closed += 1
            assert set(solve(problem).status.tolist()) == {"optimal"}
    assert closed >= 10
