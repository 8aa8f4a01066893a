"""Residuals in microseconds are the residuals that define them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from solvers import GraspForceProblem
from solvers.judge import force_residuals
from solvers.problem import force_scale, residuals
from tests.support.problems import VARIANTS, forces_in_cones, random_problem, solved_by
from tests.support.seeds import seeded

seeds = st.integers(0, 2**32 - 1)
DEFINITIONS = {
    "equilibrium": residuals.equilibrium_residual,
    "friction": residuals.friction_violation,
    "normal": residuals.normal_violation,
    "torque": residuals.torque_violation,
    "force_scale": lambda problem, _: force_scale(problem),
}


def assert_as_defined(
    problem: GraspForceProblem, forces: np.ndarray, rounding: float = 1e-12
) -> None:
    measured = force_residuals(problem, forces)
    for name, define in DEFINITIONS.items():
        value = getattr(measured, name)
        assert isinstance(value, float)
        # a difference of large numbers is as exact as they are
        size = max(1.0, float(np.linalg.norm(problem.external_wrench)), float(np.abs(forces).max()))
        assert value == pytest.approx(
            float(define(problem, forces)), rel=1e-12, abs=rounding * size
        ), name


@given(
    seed=seeds,
    variant=st.sampled_from(sorted(VARIANTS)),
    contacts=st.integers(3, 8),
    size=st.sampled_from([0.0, 0.1, 5.0, 100.0]),
)
def test_on_any_problem(seed: int, variant: str, contacts: int, size: float) -> None:
    rng = seeded(seed)
    problem = random_problem(rng, **({"contacts": contacts} | VARIANTS[variant]))
    assert_as_defined(problem, size * rng.normal(size=3 * problem.n_contacts))


@given(seed=seeds, extra=st.integers(1, 5))
def test_padding_counts_for_nothing(seed: int, extra: int) -> None:
    rng = seeded(seed)
    problem = random_problem(rng)
    forces = rng.normal(size=12)
    padded = problem.pad(4 + extra)
    longer = np.append(forces, np.zeros(3 * extra))
    assert_as_defined(padded, longer)
    one, other = force_residuals(problem, forces), force_residuals(padded, longer)
    for name in DEFINITIONS:
        assert getattr(one, name) == pytest.approx(getattr(other, name), rel=1e-9, abs=1e-9)


@given(seed=seeds)
def test_forces_that_satisfy_a_problem_have_no_residuals(seed: int) -> None:
    rng = seeded(seed)
    problem = random_problem(rng)
    forces = forces_in_cones(rng, problem)
    measured = force_residuals(solved_by(rng, problem, forces), forces)
    assert measured.equilibrium <= 1e-9 * max(1.0, np.abs(forces).max())
    assert measured.friction == 0.0
    assert measured.normal == 0.0
    assert measured.torque <= 1e-12


def test_a_hand_without_joints() -> None:
    problem = random_problem(seeded(0)).replace(
        hand_jacobian=np.zeros((12, 0)),
        torque_min=np.zeros(0),
        torque_max=np.zeros(0),
        external_torque=np.zeros(0),
    )
    assert_as_defined(problem, np.ones(12))


def test_any_layout_of_memory() -> None:
    rng = seeded(1)
    problem = random_problem(rng)
    forces = rng.normal(size=12)
    expected = force_residuals(problem, forces)
    turned = problem.replace(
        grasp_map=np.asfortranarray(problem.grasp_map),
        hand_jacobian=np.asfortranarray(problem.hand_jacobian),
    )
    assert force_residuals(turned, forces) == expected
    assert force_residuals(problem, np.repeat(forces, 2)[::2]) == expected
    locked = forces.copy()
    locked.flags.writeable = False
    assert force_residuals(problem, locked) == expected
    np.testing.assert_array_equal(locked, forces)
