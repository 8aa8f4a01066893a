"""Passive resistance: what its forces show, and the forces that have the most of it."""

from typing import Any

import numpy as np
import pytest

from solvers import (
    GraspForceProblem,
    Multipliers,
    ProblemError,
    SolverError,
    judge,
    make_solver,
    solve,
)
from solvers.conic import Rows, maximise
from solvers.passive_resistance import (
    LARGEST_MULTIPLE,
    most_passive_resistance,
    passive_resistance,
    settled_torque,
)
from solvers.problem import MAX_QUALITY
from tests.support.problems import random_rotation, skew
from tests.support.pushes import LENGTH, palm_only, posed, sides
from tests.support.seeds import seeded

JOINTS = {"joint_friction": 0.01}


@pytest.mark.parametrize("seed", range(8))
def test_passive_resistance_is_what_its_forces_show(seed: int) -> None:
    problem, forces = posed(seed)
    found = passive_resistance(problem, forces, sides(), LENGTH, **JOINTS)
    commanded = problem.hand_jacobian.T @ forces
    np.testing.assert_allclose(found.torque, commanded, atol=1e-5)
    for multiple, shown, wrench in zip(found.multiples, found.forces, sides(), strict=True):
        assert 0.0 <= multiple <= LARGEST_MULTIPLE
        vectors = shown.reshape(-1, 3)
        tangent = np.linalg.norm(vectors[:, :2], axis=1)
        assert np.all(tangent <= problem.friction * vectors[:, 2] + 1e-6)
        balance = problem.grasp_map @ shown + problem.external_wrench + multiple * wrench
        assert np.abs(balance).max() < 1e-5
        moved = problem.hand_jacobian.T @ shown - found.torque
        assert np.abs(moved).max() <= JOINTS["joint_friction"] + 1e-6


def test_passive_resistance_does_not_depend_on_the_object_frame() -> None:
    turn = np.kron(np.eye(2), random_rotation(seeded(4)))
    apart = []
    for seed in range(8):
        problem, forces = posed(seed)
        turned = problem.replace(
            grasp_map=turn @ problem.grasp_map, external_wrench=turn @ problem.external_wrench
        )
        one = passive_resistance(problem, forces, sides(), LENGTH, **JOINTS).multiples
        other = passive_resistance(turned, forces, sides() @ turn.T, LENGTH, **JOINTS).multiples
        apart.append(abs(other - one).max())
    # the error of the settled torque is multiplied: of 112 problems two were more than 1e-4 apart
    assert np.median(apart) < 1e-5
    assert np.max(apart) < 1e-3


@pytest.mark.parametrize("seed", range(4))
def test_passive_resistance_grows_with_friction_and_scales_with_the_disturbance(seed: int) -> None:
    problem, forces = posed(seed)
    found = passive_resistance(problem, forces, sides(), LENGTH, **JOINTS)
    base = found.multiples
    rough = problem.replace(friction=1.3 * problem.friction)
    grown = passive_resistance(rough, forces, sides(), LENGTH, **JOINTS)
    # both settle at the same torques but for what Clarabel leaves, for which dry friction makes up
    error = np.abs(grown.torque - found.torque).max()
    assert error < 1e-5
    grown = passive_resistance(
        rough, forces, sides(), LENGTH, joint_friction=JOINTS["joint_friction"] + 2 * error
    )
    assert np.all(grown.multiples >= base - 1e-5)
    stiff = passive_resistance(problem, forces, sides(), LENGTH, joint_friction=0.05).multiples
    assert np.all(stiff >= base - 1e-5)
    assert stiff.sum() > base.sum()
    half = passive_resistance(problem, forces, 2.0 * sides(), LENGTH, **JOINTS).multiples
    free = base < LARGEST_MULTIPLE - 1e-3
    np.testing.assert_allclose(half[free], 0.5 * base[free], atol=1e-5)


def test_palm_resists_what_a_table_does() -> None:
    problem = palm_only([0, 0, -2.0, 0, 0, 0])
    pushes = np.zeros((3, 6))
    pushes[0, 0], pushes[1, 2], pushes[2, 2] = 1.0, 1.0, -1.0
    found = passive_resistance(problem, np.zeros(9), pushes, 0.03, **JOINTS)
    # sideways mu m g, upwards the weight, downwards without end
    np.testing.assert_allclose(found.multiples, [1.0, 2.0, LARGEST_MULTIPLE], atol=1e-5)
    lifted = passive_resistance(
        palm_only([0, 0, 2.0, 0, 0, 0]), np.zeros(9), pushes, 0.03, **JOINTS
    )
    assert not lifted.multiples.any()
    assert np.isnan(lifted.forces).all()


def test_forces_that_do_not_carry_settle_at_the_nearest_torques_that_do() -> None:
    rng = seeded(0)
    problem, forces = posed(1)
    limits = problem.torque_min - problem.external_torque
    limits = np.array([limits, problem.torque_max - problem.external_torque])

    def carry(torque: np.ndarray, error: float) -> bool:
        """Whether some forces in the cones carry the load with torques this near."""
        commanded = torque + problem.external_torque
        near = problem.replace(torque_min=commanded - error, torque_max=commanded + error)
        return str(solve(near, "clarabel").status) != "infeasible"

    while True:  # until no torques within a thousandth of those that are told carry
        told = forces + 0.5 * rng.normal(size=len(forces))
        wanted = np.clip(told @ problem.hand_jacobian, *limits)
        if not carry(wanted, 1e-3):
            break
    settled = settled_torque(problem, told, LENGTH)
    assert settled is not None
    assert carry(settled, 1e-5)
    distance = np.linalg.norm(settled - wanted)
    assert 1e-3 < distance <= np.linalg.norm(forces @ problem.hand_jacobian - wanted) + 1e-9
    assert not carry(settled + 0.2 * (wanted - settled), 1e-5)


def test_maximise_knows_when_there_is_nothing() -> None:
    nothing = Rows(np.zeros((0, 1)), np.zeros(0))
    between = Rows(np.array([[-1.0], [1.0]]), np.array([-1.0, 3.0]))
    found = maximise(np.ones(1), nothing, between, nothing)
    assert found == pytest.approx([3.0])
    parabola = maximise(np.array([2.0]), nothing, between, nothing, np.array([[1.0]]))
    assert parabola == pytest.approx([2.0], abs=1e-6)
    never = Rows(np.array([[-1.0], [1.0]]), np.array([-3.0, 1.0]))
    assert maximise(np.ones(1), nothing, never, nothing) is None
    with pytest.raises(SolverError, match="Clarabel"):
        maximise(np.ones(1), nothing, Rows(-np.ones((1, 1)), np.zeros(1)), nothing)


# -- a grasp whose resistance is known -------------------------------------------------------------

ARM = 0.05


def ball(friction: float = 0.5) -> GraspForceProblem:
    """Four contacts around a ball; joint k feels the normal force of contact k, ARM metres off."""
    normals = np.array([[-1.0, 0, 0], [0, -1.0, 0], [1.0, 0, 0], [0, 1.0, 0]])
    blocks = []
    for normal in normals:
        frame = np.column_stack([np.cross([0, 0, 1.0], normal), [0, 0, 1.0], normal])
        frame[:, 1] *= np.sign(np.linalg.det(frame))
        blocks.append(np.vstack([frame, skew(-0.04 * normal) @ frame]))
    jacobian = np.zeros((12, 4))
    jacobian[np.arange(2, 12, 3), np.arange(4)] = ARM
    return GraspForceProblem(
        grasp_map=np.hstack(blocks),
        hand_jacobian=jacobian,
        friction=[friction] * 4,
        torque_min=[-2.0] * 4,
        torque_max=[2.0] * 4,
        external_wrench=np.zeros(6),
    )


def squeeze(normal: float) -> np.ndarray:
    return np.tile([0.0, 0.0, normal], 4)


def test_a_squeezed_ball_resists_what_its_friction_does() -> None:
    lift, spin, push = np.zeros((3, 6))
    lift[2], spin[5], push[0] = 3.0, 0.1, 1.0
    held = [
        passive_resistance(ball(), squeeze(n), np.array([lift, spin, push]), LENGTH, **JOINTS)
        for n in (0.5, 1.0, 2.0)
    ]
    for normal, found in zip((0.5, 1.0, 2.0), held, strict=True):
        most = normal + JOINTS["joint_friction"] / ARM
        # sideways: two contacts by friction, the others by what the joints do not feel
        expected = [4 * 0.5 * most / 3.0, 4 * 0.5 * most * 0.04 / 0.1, 2 * 0.5 * most + 0.4]
        np.testing.assert_allclose(found.multiples, expected, rtol=1e-5)


def test_more_squeeze_resists_more() -> None:
    problem = ball().replace(external_wrench=[0, 0, -1.0, 0, 0, 0])
    least = [
        passive_resistance(problem, squeeze(n), sides(), LENGTH, **JOINTS).multiples.min()
        for n in (1.0, 2.0, 3.0, 4.0)
    ]
    assert (np.diff(least) > 0.3).all()


# -- the most of it --------------------------------------------------------------------------------


def verdict_of(problem: GraspForceProblem, forces: np.ndarray) -> str:
    unknown = Multipliers(np.full(6, np.nan), np.full(problem.n_joints, np.nan))
    return str(judge(problem, forces, unknown).status)


@pytest.mark.parametrize("bounded", [False, True])
@pytest.mark.parametrize("seed", range(5))
def test_most_resists_no_less_than_uniform_preload_and_keeps_every_constraint(
    seed: int, bounded: bool
) -> None:
    problem, forces = posed(seed, 4 + seed % 3)
    if bounded:
        largest = float(forces[2::3].max())
        ends = np.full((2, problem.n_contacts), [[0.5], [1.2 * largest]])
        problem = problem.replace(normal_min=ends[0], normal_max=ends[1])
    budget = float(forces[2::3].sum()) + problem.n_contacts
    quality = problem.replace(
        objective=MAX_QUALITY, effort_budget=budget, characteristic_length=LENGTH
    )
    uniform = np.asarray(make_solver("uniform_preload").solve(quality).forces)
    assert np.isfinite(uniform).all()
    most = most_passive_resistance(problem, float(uniform[2::3].sum()), sides(), LENGTH, **JOINTS)
    assert most is not None
    assert verdict_of(problem, most) == "feasible"
    assert most[2::3].sum() <= uniform[2::3].sum()
    rough = most_passive_resistance(
        problem, float(uniform[2::3].sum()), sides(), LENGTH, **JOINTS, exact=False
    )
    assert rough is not None
    held, roughly, simply = (
        passive_resistance(problem, f, sides(), LENGTH, **JOINTS).multiples.min()
        for f in (most, rough, uniform)
    )
    assert held == pytest.approx(roughly, abs=1e-4)
    # ties are broken by a thousandth of a multiple
    assert held >= simply - 1e-3


def test_nothing_where_the_load_cannot_be_carried() -> None:
    lifted = palm_only([0, 0, 2.0, 0, 0, 0])
    assert most_passive_resistance(lifted, 10.0, sides(), 0.03, **JOINTS) is None
    # nor within a budget that is below what the load asks for
    table = palm_only([0, 0, -2.0, 0, 0, 0])
    assert most_passive_resistance(table, 1.0, sides(), 0.03, **JOINTS) is None


def test_forces_without_any_room_are_an_error() -> None:
    # a table at the very angle at which its load slides
    with pytest.raises(SolverError, match="too little room"):
        most_passive_resistance(
            palm_only([0.8, 0.6, -2.0, 0, 0, 0]), 10.0, np.eye(6), 0.03, **JOINTS
        )


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"budget": 0.0}, "budget"),
        ({"budget": np.inf}, "budget"),
        ({"budget": np.nan}, "budget"),
        ({"disturbances": np.zeros(6)}, "disturbances"),
        ({"disturbances": np.zeros((0, 6))}, "disturbances"),
        ({"disturbances": np.zeros((2, 5))}, "disturbances"),
        ({"disturbances": np.full((2, 6), np.nan)}, "disturbances"),
        ({"length": 0.0}, "length"),
        ({"length": np.inf}, "length"),
        ({"joint_friction": -0.01}, "joint_friction"),
        ({"joint_friction": np.inf}, "joint_friction"),
        ({"problem": GraspForceProblem.stack([ball(), ball()])}, "single"),
    ],
    ids=str,
)
def test_bad_arguments_are_named(changes: dict[str, Any], named: str) -> None:
    given: dict[str, Any] = {
        "problem": ball(),
        "budget": 10.0,
        "disturbances": sides(),
        "length": LENGTH,
        **JOINTS,
    } | changes
    with pytest.raises(ProblemError, match=named):
        most_passive_resistance(**given)
    if "budget" not in changes:
        del given["budget"]
        with pytest.raises(ProblemError, match=named):
            passive_resistance(forces=squeeze(1.0), **given)


@pytest.mark.parametrize("forces", [np.zeros(9), np.full(12, np.nan)])
def test_bad_forces_are_named(forces: np.ndarray) -> None:
    with pytest.raises(ProblemError, match="12 finite numbers"):
        passive_resistance(ball(), forces, sides(), LENGTH, **JOINTS)
