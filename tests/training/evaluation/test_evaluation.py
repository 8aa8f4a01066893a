"""Evaluation: rows with every metric and interval, sane figures, reproducible."""

import json

import numpy as np
import pytest

from gfo_env.objects import ObjectSet
from solvers import UnknownSolverError
from training.evaluation.solvers import EvaluationPlan, evaluate

TIMES = {"time_ms"}


def plan(*solvers: str, grasps: int = 12) -> EvaluationPlan:
    return EvaluationPlan(ObjectSet("random_urdfs", "test"), solvers, grasps, 1)


@pytest.fixture(scope="module")
def rows() -> list[dict]:
    return evaluate(plan("pseudoinverse", "equal_squeeze"))


def test_rows_have_the_contracts_keys(rows) -> None:
    names = [row["solver"] for row in rows]
    assert names[:3] == ["clarabel", "pseudoinverse", "equal_squeeze"]
    assert names[-1] == "zero_force"
    metrics = {key.removesuffix("_ci") for key in rows[0] if key.endswith("_ci")}
    assert {"hold_rate", "gap_median", "q_lrw_mean", "feasible_rate"} <= metrics
    for row in rows:
        assert row.keys() == rows[0].keys()
        assert (row["grasps"], row["split"], row["object_set"]) == (12, "test", "random_urdfs")
        for metric in metrics:
            if row[metric] is not None:
                low, high = row[f"{metric}_ci"]
                assert low <= high
    json.dumps(rows, allow_nan=False)


def test_oracle_is_optimal_and_heuristics_are_not(rows) -> None:
    by_name = {row["solver"]: row for row in rows}
    oracle = by_name["clarabel"]
    assert oracle["feasible_rate"] == 1.0
    assert oracle["gap_p99"] < 1e-7
    assert oracle["q_lrw_ratio"] == 1.0
    assert oracle["equilibrium_residual_max"] < 1e-12
    assert by_name["pseudoinverse"]["equilibrium_residual_max"] < 1e-12
    assert by_name["pseudoinverse"]["friction_violation_max"] > 0.1
    assert by_name["equal_squeeze"]["friction_violation_max"] == 0.0
    assert by_name["zero_force"]["hold_rate"] == 0.0
    assert oracle["hold_rate"] > by_name["equal_squeeze"]["hold_rate"]


def test_same_seed_same_rows_whatever_the_workers(rows) -> None:
    again = evaluate(plan("pseudoinverse", "equal_squeeze"), workers=2)
    for one, other in zip(rows, again, strict=True):
        for key in one.keys() - TIMES:
            assert one[key] == other[key], key


def test_unknown_solver_is_refused_before_any_work(monkeypatch) -> None:
    monkeypatch.setattr(
        "training.evaluation.solvers.collect", lambda *a, **k: pytest.fail("worked")
    )
    with pytest.raises(UnknownSolverError, match="clarabel"):
        evaluate(plan("no_such_solver"))


def test_intervals_contain_their_metric(rows) -> None:
    for row in rows:
        for metric in ("feasible_rate", "hold_rate", "q_lrw_mean"):
            low, high = row[f"{metric}_ci"]
            assert low - 1e-12 <= row[metric] <= high + 1e-12
            assert np.isfinite(row[metric])
