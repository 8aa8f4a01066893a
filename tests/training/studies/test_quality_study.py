"""The comparison of forces of high quality: fair, resumable, its page made of its rows."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from solvers import solve
from tests.support.commands import assert_one_clear_line, run_command
from tests.support.quality_problems import quality_batch
from tests.support.seeds import seeded
from training.reports.results import load_run
from training.studies.quality.figures import LOOKS, pareto_figure
from training.studies.quality.measures import Measures, QualityStudy
from training.studies.quality.page import summary
from training.studies.quality.plan import QualityStudyError, QualityStudyPlan
from training.studies.quality.problems import StudyProblems
from training.studies.quality.results import Results, median, tenth
from training.studies.quality.run import METHODS, NETWORK, PRICED, REFERENCE, Job, answer_job
from training.studies.quality.squeeze import NearestSqueezeSolver

TINY = ("--grasps", 2, "--times", 2, "--prices", 0.02, "--batch", 16, "--timed", 1, "--rounds", 3)


def test_the_nearest_squeeze_is_feasible_and_near() -> None:
    rng = seeded(0)
    problem = quality_batch(rng, 4, 5, 6, times=3.0, friction=0.8)
    answer = solve(problem, NearestSqueezeSolver())
    assert (answer.status == "feasible").all()
    count = problem.contact_mask.sum(axis=1)
    wanted = np.zeros_like(answer.forces)
    wanted[:, 2::3] = problem.contact_mask * (problem.effort_budget / count)[:, None]
    other = solve(problem, "uniform_preload").forces
    within = answer.forces[:, 2::3].sum(axis=1) < problem.effort_budget * (1 - 1e-6)
    near = np.linalg.norm(answer.forces - wanted, axis=1)
    far = np.linalg.norm(other - wanted, axis=1)
    # where the budget does not bind, nothing feasible is nearer
    assert (near[within] <= far[within] * (1 + 1e-6)).all()
    assert (near <= 1.2 * far).all()


@pytest.fixture(scope="module")
def study() -> tuple[QualityStudyPlan, Results]:
    plan = QualityStudyPlan(times=(1.5, 3.0), prices=(0.02,), rounds=20)
    rows = []
    for number in range(len(plan.sets)):
        for first in (0, 2):
            rng = seeded([number, first])
            problem = quality_batch(rng, 5, 6, times=1.0, friction=0.8).flat()
            owners = np.array([f"{first}", f"{first + 1}"])
            rows += answer_job(plan, Job(number, first, StudyProblems(problem, owners)))
    return plan, Results(json.loads(json.dumps(rows)))


def test_rows_are_those_of_the_judge(study: tuple[QualityStudyPlan, Results]) -> None:
    plan, table = study
    count = len(plan.sets) * 4
    assert len(table.rows) == count * (len(METHODS) * 2 + len(PRICED))
    for row in table.rows:
        assert row["feasible"] == (row["lower"] is not None)
        if row["feasible"]:
            assert 0.0 <= row["lower"] <= row["upper"]
            assert row["effort"] <= row["times"] * (1 + 1e-9)
    for times in plan.times:
        reference = table.answers(0, REFERENCE, times)
        assert np.isfinite(reference.bound).all()
        for method in METHODS:
            answers = table.answers(0, method, times)
            assert (answers.lower <= reference.bound * (1 + 1e-9)).all()
            assert (answers.owners == reference.owners).all()
    shares, owners = table.shares(0, REFERENCE, 3.0)
    assert (shares == 1.0).all()
    assert len(owners) == table.compared(0, 3.0).sum()


def test_gains_and_shares_say_the_same(study: tuple[QualityStudyPlan, Results]) -> None:
    _, table = study
    gains, _ = table.gains(0, NETWORK, REFERENCE, 3.0)
    shares, _ = table.shares(0, NETWORK, 3.0)
    np.testing.assert_allclose(gains + 1.0, shares)
    assert tenth(np.arange(11.0)) == 1.0
    found = median(np.array([1.0, 2.0, 3.0]), np.array(["a", "b", "c"]))
    assert found.low <= found.value == 2.0 <= found.high


def test_every_method_has_a_look(study: tuple[QualityStudyPlan, Results]) -> None:
    assert set(LOOKS) == set(METHODS)
    point = median(np.ones(2), np.array(["a", "b"]))
    figure = pareto_figure({"held out": {name: [(1.0, point)] for name in METHODS}})
    assert len(figure.axes) == 1


@pytest.mark.slow
def test_the_command_goes_on_after_a_kill_and_writes_the_page(tmp_path: Path) -> None:
    page, output = tmp_path / "page.md", tmp_path / "study"
    arguments = (*TINY, "--workers", 1, "--output", output, "--page", page)
    done = run_command("compare_quality", *arguments, "--json", tmp_path / "rows.json")
    assert done.returncode == 0, done.stderr
    rows = load_run(tmp_path / "rows.json", QualityStudy).results.rows
    text, picture = page.read_text(), page.with_suffix(".png").read_bytes()
    assert "{" not in text.replace("${", "")
    assert "In batches of 16" in text
    kept = output / "rows.jsonl"
    lines = kept.read_text().splitlines()
    kept.write_text("\n".join(lines[:1]) + "\n" + lines[1][:40])
    again = run_command("compare_quality", *arguments, "--json", tmp_path / "again.json")
    assert again.returncode == 0, again.stderr
    assert load_run(tmp_path / "again.json", QualityStudy).results.rows == rows
    assert page.with_suffix(".png").read_bytes() == picture
    other = run_command("compare_quality", *arguments, "--seed", 5)
    assert_one_clear_line(other, "holds a study of other settings")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"grasps": 0}, "grasps is 0"),
        ({"times": (1.0,)}, "all must exceed 1"),
        ({"prices": (0.0,)}, "all must be above 0"),
    ],
)
def test_bad_plans_are_named(changes: dict[str, object], message: str) -> None:
    with pytest.raises(QualityStudyError, match=message):
        dataclasses.replace(QualityStudyPlan(), **changes)  # type: ignore[arg-type]


def test_the_summary_counts_answers(study: tuple[QualityStudyPlan, Results]) -> None:
    plan, results = study
    measures = Measures(64, {NETWORK: 1e-3, REFERENCE: 2.0}, 1e-2, {}, 8)
    text = summary(QualityStudy.of(plan, results.rows, measures), results)
    answers = sum(row["method"] == NETWORK for row in results.rows)
    assert f"{answers:,} of its {answers:,} answers are feasible" in text
    assert "2,000 times less" in text
