"""The ablation: what it measures, that it resumes, and the page it writes."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from gfo_env.grasps import GraspTable
from solvers import solve
from solvers.duality import dual_bound
from solvers.exact.polish import polished
from solvers.learned.config import NetworkConfig
from solvers.learned.network import ConditionedKktNetwork
from solvers.problem import Multipliers
from tests.support.commands import assert_one_clear_line, run_command
from tests.support.grasp_tables import random_table
from tests.support.problems import random_batch
from tests.support.seeds import reseeded, seeded
from training.networks.settings import TrainingError, TrainingSettings
from training.reports.results import Run
from training.studies.ablation import run as module
from training.studies.ablation.page import write_page
from training.studies.ablation.run import (
    BASE,
    MOST_NEWTON_STEPS,
    SOLVED,
    VARIANTS,
    Ablation,
    AblationPlan,
    Reference,
    Variant,
    best_multipliers,
    reference,
    run_ablation,
    steps_to_gap,
)
from training.studies.ablation.stages import AblationStudy, Stages, run_stages

SMALL = NetworkConfig(steps=2, width=8, vectors=4, memory=4, joint_width=8)
FEW = (
    dataclasses.replace(BASE, network=SMALL),
    Variant("training", "none", SMALL, trained=False),
    Variant("loss", "half of each", SMALL, collocation=0.5),
    Variant("coordinates", "raw", dataclasses.replace(SMALL, coordinates="raw")),
)


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> AblationPlan:
    folder = tmp_path_factory.mktemp("ablation")
    random_table(seeded(0), 120).save(folder / "grasps.npz")
    return AblationPlan(folder / "grasps.npz", folder / "runs", 2, 16, 2, 0)


@pytest.fixture(scope="module")
def result(plan: AblationPlan) -> Ablation:
    return run_ablation(plan, FEW)


@pytest.fixture(scope="module")
def problems() -> Reference:
    batch = random_batch(seeded(0), 40)
    factor = np.where(np.arange(40) % 4 == 0, 0.2, 1.0)[:, None]
    return reference(batch.replace(friction=factor * batch.friction))


def test_every_variant_is_measured_as_often_as_it_is_trained(
    result: Ablation, plan: AblationPlan
) -> None:
    assert [(row.group, row.name) for row in result.rows] == [(v.group, v.name) for v in FEW]
    assert [len(row.gap_p99) for row in result.rows] == [plan.repeats, 1, 1, 1]
    for row in result.rows:
        values = np.array([row.gap_median, row.gap_p90, row.gap_p99])
        assert np.all(np.diff(values, axis=0) >= 0.0)
        assert np.all((values >= 0.0) & (values <= 1.0))
        assert all(0.0 <= share <= 1.0 for share in row.feasible)
        assert all(0.0 <= steps <= MOST_NEWTON_STEPS for steps in row.steps_to_gap)
        assert row.microseconds > 0.0
    assert result.rows[0].weights == sum(
        parameter.numel() for parameter in ConditionedKktNetwork(SMALL).parameters()
    )
    assert 0 < result.feasible <= result.problems


def test_objects_measured_on_are_in_no_training(result: Ablation, plan: AblationPlan) -> None:
    whole = GraspTable.load(plan.grasps)
    trained_on = GraspTable.load(plan.output / "grasps.npz")
    assert len(set(whole.object_id) - set(trained_on.object_id)) == result.objects
    assert result.problems == module.DRAWS * (len(whole) - len(trained_on))


def test_finished_trainings_are_not_done_again(
    result: Ablation, plan: AblationPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    resumed: list[Path] = []
    train = module.train

    def spy(settings: TrainingSettings, **options: object) -> object:
        resumed.append(settings.output)
        before = (settings.output / "checkpoint.pt").stat().st_mtime_ns
        summary = train(settings, **options)  # type: ignore[arg-type]
        assert (settings.output / "checkpoint.pt").stat().st_mtime_ns == before
        return summary

    monkeypatch.setattr(module, "train", spy)
    again = run_ablation(plan, FEW)
    assert len(resumed) == 4

    def without_times(ablation: Ablation) -> list[object]:
        return [dataclasses.replace(row, microseconds=0.0) for row in ablation.rows]

    assert without_times(again) == without_times(result)


def test_variants_differ_in_one_thing_and_have_folders_of_their_own() -> None:
    assert VARIANTS[0] is BASE
    assert len({variant.folder for variant in VARIANTS}) == len(VARIANTS)
    base = dataclasses.asdict(BASE)
    for variant in VARIANTS[1:]:
        values = dataclasses.asdict(variant)
        assert sum(values[name] != base[name] for name in set(base) - {"group", "name"}) == 1
    assert {variant.group for variant in VARIANTS} >= {"loss", "coordinates", "steps", "width"}


def test_reference_values_are_optimal(problems: Reference) -> None:
    exact = solve(problems.problem, "clarabel")
    feasible = exact.status == "optimal"
    np.testing.assert_array_equal(problems.feasible, feasible)
    assert 5 < feasible.sum() < 40
    value = (exact.objective / problems.form.scale**2)[feasible]
    np.testing.assert_allclose(problems.optimum, value, rtol=1e-6)


def test_gap_is_zero_at_the_optimum_and_one_where_nothing_is_proven(problems: Reference) -> None:
    form = problems.form.problem
    cold = Multipliers(2.0 * form.external_wrench, np.zeros_like(form.torque_min))
    assert np.median(problems.gap(polished(form, cold, 20))) < 1e-12
    nothing = Multipliers(np.zeros_like(form.external_wrench), np.zeros_like(form.torque_min))
    preload = np.any(form.normal_min > 0, axis=1)[problems.feasible]
    np.testing.assert_allclose(problems.gap(nothing)[~preload], 1.0)


def test_newton_steps_are_counted_to_the_first_solved_point(problems: Reference) -> None:
    form = problems.form.problem
    cold = Multipliers(2.0 * form.external_wrench, np.zeros_like(form.torque_min))
    counts = steps_to_gap(problems, cold)
    ahead = steps_to_gap(problems, polished(form, cold, 2))
    slow = counts == MOST_NEWTON_STEPS
    np.testing.assert_array_equal(ahead[~slow], np.maximum(counts[~slow] - 2, 0))
    for count in np.unique(counts[~slow]):
        gap = problems.gap(polished(form, cold, int(count)))
        assert np.all(gap[counts == count] <= SOLVED)


def test_answers_are_the_best_iterates(problems: Reference) -> None:
    torch.manual_seed(reseeded(0))
    network = ConditionedKktNetwork(SMALL)
    best = best_multipliers(network, problems)
    assert best.equilibrium.dtype == np.float64
    start = Multipliers(2.0 * problems.form.problem.external_wrench, np.zeros_like(best.torque))
    assert np.all(problems.gap(best) <= problems.gap(start) + 1e-6)
    values = dual_bound(problems.form.problem, best)
    assert np.all(values[problems.feasible] <= problems.optimum * (1 + 1e-9))


@pytest.fixture(scope="module")
def stages(problems: Reference) -> Stages:
    torch.manual_seed(reseeded(0))
    return run_stages(ConditionedKktNetwork().eval(), problems)


def test_stages_improve_with_newton_steps_and_beat_the_cold_start(stages: Stages) -> None:
    rows = {(row.start, row.polish_steps): row for row in stages.rows}
    assert len(rows) == 8
    for start in ("network", "cold"):
        medians = [max(rows[start, steps].gap[0], 1e-14) for steps in (0, 1, 2, 4)]
        assert medians == sorted(medians, reverse=True)
    assert rows["network", 0].gap[0] < 0.01 * rows["cold", 0].gap[0]
    assert stages.steps_to_gap["network"] < stages.steps_to_gap["cold"]


def test_page_holds_every_variant_and_leaves_no_gap_open(
    result: Ablation, stages: Stages, tmp_path: Path
) -> None:
    path, command = tmp_path / "network.md", "python scripts/ablate.py"
    study = AblationStudy(result, {"Held-out objects": stages})
    assert write_page(Run(command, {}, study), path) == f"{len(FEW)} variants"
    text = path.read_text()
    for variant in FEW:
        assert f"| {variant.name} |" in text
    assert "**Held-out objects**" in text
    assert "{" not in text
    assert "](network_ablation.png)" in text
    assert 1000 < (tmp_path / "network_ablation.png").stat().st_size < 60_000
    write_page(Run(command, {}, AblationStudy(result, {})), path)
    assert "Not measured in this run" in path.read_text()


@pytest.mark.parametrize("change", [{"steps": 0}, {"batch": 0}, {"repeats": 0}, {"seed": -1}])
def test_bad_plans_are_refused(plan: AblationPlan, change: dict[str, int]) -> None:
    with pytest.raises(TrainingError, match=next(iter(change))):
        dataclasses.replace(plan, **change)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("--grasps", "no_such.npz", "no grasps at no_such.npz"),
        ("--held-out", "no_such.npz", "no grasps at no_such.npz"),
        ("--page", "tests", "tests is a folder"),
    ],
)
def test_command_names_what_is_wrong_before_it_trains(
    plan: AblationPlan, tmp_path: Path, option: str, value: str, message: str
) -> None:
    options = {
        "--grasps": str(plan.grasps),
        "--output": str(tmp_path / "runs"),
        "--page": str(tmp_path / "network.md"),
    }
    options[option] = value
    words = [word for pair in options.items() for word in pair]
    done = run_command("ablate", *words)
    assert_one_clear_line(done, f"error: {message}")
    assert not (tmp_path / "runs").exists()
