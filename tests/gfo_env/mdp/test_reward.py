"""The reward's terms: bounds, signs, and the trade that they must never offer."""

from dataclasses import astuple, fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gfo_env.mdp.reward import (
    TERMS,
    ForceMeasures,
    RewardWeights,
    evaluate_forces,
    holding_simulated,
    holding_static,
    reward_terms,
    saturate,
)
from solvers import GraspForceProblem
from solvers.judge import force_residuals
from solvers.problem import force_scale, residuals
from tests.support.seeds import seeded

WEIGHTS = RewardWeights()
EVERY = replace(WEIGHTS, resistance=0.3)
PERFECT = ForceMeasures(
    balanceable=True,
    wrench_residual=0.0,
    friction_violation=0.0,
    normal_violation=0.0,
    torque_violation=0.0,
    q_lrw=1.0,
    load=3.0,
    least_force=4.0,
    max_torque=2.0,
    size=5.0,
    effort=0.1,
    resistance=2.0,
)

size = st.floats(0.0, 1e6)
scale = st.floats(1e-3, 1e3)
measures = st.builds(
    ForceMeasures,
    balanceable=st.booleans(),
    wrench_residual=size,
    friction_violation=size,
    normal_violation=size,
    torque_violation=size,
    q_lrw=size,
    load=st.floats(0.0, 1e3),
    least_force=scale,
    max_torque=scale,
    size=size,
    effort=st.floats(0.0, 1.0),
    resistance=size,
)


@given(measures=measures, motion=st.floats(0.0, 1.0), closes=st.booleans(), lost=st.booleans())
def test_every_term_is_bounded_by_its_weight(
    measures: ForceMeasures, motion: float, closes: bool, lost: bool
) -> None:
    terms = reward_terms(
        EVERY, measures, holding=holding_simulated(motion, lost=lost), force_closure=closes
    )
    assert tuple(terms) == TERMS == tuple(field.name for field in fields(RewardWeights))
    for name, value in terms.items():
        assert abs(value) <= getattr(EVERY, name)
    assert min(terms[name] for name in ("force_closure", "q_lrw", "resistance")) >= 0.0
    assert max(terms[name] for name in ("equilibrium", "friction", "torque", "effort")) <= 0.0


@given(one=measures, other=measures, motion=st.floats(0.0, 1.0), closes=st.booleans())
def test_holding_badly_beats_dropping_well(
    one: ForceMeasures, other: ForceMeasures, motion: float, closes: bool
) -> None:
    held = reward_terms(
        WEIGHTS, one, holding=holding_simulated(motion, lost=False), force_closure=False
    )
    dropped = reward_terms(
        WEIGHTS, other, holding=holding_simulated(1.0, lost=True), force_closure=closes
    )
    assert sum(held.values()) >= -1e-12
    assert sum(dropped.values()) <= -0.85 + 1e-12


@given(
    name=st.sampled_from(["wrench_residual", "friction_violation", "torque_violation", "effort"]),
    less=st.floats(0.0, 0.45),
)
def test_worse_forces_earn_less(name: str, less: float) -> None:
    def total(value: float) -> float:
        bad = PERFECT._replace(**{name: value})
        terms = reward_terms(WEIGHTS, bad, holding=1.0, force_closure=True)
        return sum(terms.values())

    assert total(2.0 * less + 1e-3) < total(less)


def test_more_motion_earns_less_and_more_quality_more() -> None:
    def total(motion: float, q_lrw: float) -> float:
        better = PERFECT._replace(q_lrw=q_lrw)
        terms = reward_terms(
            WEIGHTS, better, holding=holding_simulated(motion, lost=False), force_closure=True
        )
        return sum(terms.values())

    assert total(0.0, 1.0) > total(0.5, 1.0) > total(1.0, 1.0)
    assert total(0.0, 2.0) > total(0.0, 1.0) > total(0.0, 0.0)


def test_contacts_that_balance_nothing_pay_in_full() -> None:
    terms = reward_terms(
        WEIGHTS, PERFECT._replace(balanceable=False), holding=1.0, force_closure=False
    )
    assert terms["equilibrium"] == -WEIGHTS.equilibrium


@given(one=measures, other=measures)
def test_static_holding_falls_with_the_misfit(one: ForceMeasures, other: ForceMeasures) -> None:
    assert holding_static(PERFECT) == 1.0
    assert -1.0 <= holding_static(one) <= 1.0
    if one.misfit < other.misfit:
        assert holding_static(one) >= holding_static(other)


def test_squeezing_costs_more_than_its_quality_brings() -> None:
    """Normal forces at the cap at every contact, against forces of a tenth of that."""

    def total(share: float) -> float:
        measures = PERFECT._replace(q_lrw=5.0 * share, effort=share / 3.0**0.5)
        return sum(reward_terms(WEIGHTS, measures, holding=1.0, force_closure=True).values())

    assert total(1.0) < total(0.1)


def test_weights_scale_their_terms() -> None:
    double = RewardWeights(*(2.0 * weight for weight in astuple(EVERY)))
    arguments = {"holding": 0.85, "force_closure": True}
    bad = PERFECT._replace(wrench_residual=1.0, friction_violation=2.0, torque_violation=0.5)
    one = reward_terms(EVERY, bad, **arguments)  # type: ignore[arg-type]
    two = reward_terms(double, bad, **arguments)  # type: ignore[arg-type]
    for name in TERMS:
        assert two[name] == pytest.approx(2.0 * one[name])
        assert one[name] != 0.0


@given(measures=measures)
def test_resistance_counts_only_with_a_weight(measures: ForceMeasures) -> None:
    def resistance(weights: RewardWeights) -> float:
        return reward_terms(weights, measures, holding=1.0, force_closure=True)["resistance"]

    assert resistance(WEIGHTS) == 0.0
    r = measures.resistance
    assert resistance(EVERY) == pytest.approx(0.3 * r / (r + 1.0))


@given(value=size, scale=st.floats(0.0, 1e6))
def test_saturate(value: float, scale: float) -> None:
    assert 0.0 <= saturate(value, scale) <= 1.0
    assert saturate(0.0, scale) == 0.0
    assert saturate(scale, scale) == (0.5 if scale > 0 else 0.0)


def problem() -> GraspForceProblem:
    rng = seeded(0)
    return GraspForceProblem(
        grasp_map=rng.normal(size=(6, 12)),
        hand_jacobian=0.1 * rng.normal(size=(12, 8)),
        friction=np.full(4, 0.5),
        torque_min=np.full(8, -0.2),
        torque_max=np.full(8, 0.2),
        external_wrench=rng.normal(size=6),
        normal_min=np.full(4, 1.0),
    )


def test_forces_are_measured_by_the_residuals_of_the_judge() -> None:
    posed = problem()
    forces = 5.0 * seeded(1).normal(size=12)
    found = force_residuals(posed, forces)
    measured = evaluate_forces(found, forces, q_lrw=0.5, load=2.0, max_force=20.0, max_torque=1.0)
    assert measured.balanceable
    assert residuals.friction_violation(posed, forces) > 0
    assert residuals.torque_violation(posed, forces) > 0
    for value, function in (
        (measured.wrench_residual, residuals.equilibrium_residual),
        (measured.friction_violation, residuals.friction_violation),
        (measured.normal_violation, residuals.normal_violation),
        (measured.torque_violation, residuals.torque_violation),
    ):
        assert value == pytest.approx(float(function(posed, forces)), rel=1e-12)
    assert measured.least_force == pytest.approx(float(force_scale(posed)), rel=1e-12)
    assert measured.size == pytest.approx(float(np.linalg.norm(forces)))
    assert (measured.q_lrw, measured.load, measured.max_torque) == (0.5, 2.0, 1.0)


@given(count=st.integers(0, 8))
def test_effort_is_one_for_the_largest_forces(count: int) -> None:
    measured = evaluate_forces(
        None, np.full(3 * count, -20.0), q_lrw=0.0, load=2.0, max_force=20.0, max_torque=1.0
    )
    assert measured.effort == pytest.approx(1.0 if count else 0.0)
    assert not measured.balanceable
    assert measured.wrench_residual == 2.0
