"""Policies on the same episodes, runs as one row, and the page about them."""

import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tyro

from gfo_env.grasps.collection import CollectionPlan, collect
from solvers import UnknownSolverError
from tests.support.commands import assert_one_clear_line, run_command
from tests.support.seeds import seeded
from tests.support.world import held_out_objects
from training.networks.settings import TrainingError
from training.reports.aggregate import curve_band, interquartile_mean, over_runs
from training.reports.intervals import Interval
from training.reports.results import Run, load_run
from training.rl.evaluation import METRICS, PolicyPlan, evaluate_policies
from training.rl.runs import run_groups
from training.rl.settings import RlSettings
from training.rl.trainer import train_rl
from training.studies.policies.page import PolicyStudy, markdown_table, write_page

STATIC = "GraspForceStatic-v0"


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("grasps") / "few.npz"
    collect(CollectionPlan(held_out_objects(), 20, 0), workers=1, output=path)
    return path


@pytest.fixture(scope="module")
def runs(table: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ...]:
    """Three seeds of one configuration, and one of another."""
    folder = tmp_path_factory.mktemp("runs")
    made = []
    for number, (algo, small) in enumerate(
        [("ppo", ("n_steps:32", "batch_size:32"))] * 3 + [("sac", ("buffer_size:200",))]
    ):
        settings = RlSettings(
            output=folder / f"{algo}_{number}",
            algo=algo,  # type: ignore[arg-type]
            env=STATIC,
            env_kwargs=("split:test", f"grasps:{table}"),
            steps=64,
            envs=1,
            seed=number,
            evaluation_episodes=4,
            evaluate_every=32,
            hyperparams=small,
        )
        train_rl(settings)
        made.append(settings.output)
    return tuple(made)


def plan(table: Path, **changes: Any) -> PolicyPlan:
    defaults: dict[str, Any] = {
        "env": STATIC,
        "env_kwargs": (f"grasps:{table}",),
        "policies": ("dual_newton", "equal_squeeze", "random"),
        "runs": (),
        "splits": ("test",),
        "episodes": 25,
        "seed": 0,
    }
    return PolicyPlan(**defaults | changes)


# -- episodes --------------------------------------------------------------------------------------


def test_the_same_plan_gives_the_same_rows_with_any_number_of_workers(table, runs) -> None:
    chosen = plan(table, runs=runs[:2])
    rows = evaluate_policies(chosen)
    assert rows == evaluate_policies(chosen, workers=2)
    assert [row["policy"] for row in rows[:3]] == ["dual_newton", "equal_squeeze", "random"]
    assert [row["runs"] for row in rows] == [1, 1, 1, 2]
    assert len({(row["episodes"], row["objects"]) for row in rows}) == 1
    for row in rows:
        for metric in METRICS:
            low, high = row[f"{metric}_ci"]
            assert low <= row[metric] <= high
    by_name = {row["policy"]: row for row in rows}
    rewards = [by_name[name]["reward"] for name in ("dual_newton", "equal_squeeze", "random")]
    assert rewards == sorted(rewards, reverse=True)
    assert rows != evaluate_policies(plan(table, runs=runs[:2], seed=1000))


def test_every_policy_meets_the_unannounced_environment(table) -> None:
    policies = (
        "dual_newton", "dual_newton+2", "conditioned", "pseudoinverse", "random", "reactive"
    )  # fmt: skip
    arguments = (f"grasps:{table}", "horizon:8")
    rows = evaluate_policies(
        plan(
            table,
            env="GraspForceUnannounced-v0",
            env_kwargs=arguments,
            policies=policies,
            episodes=3,
        )
    )
    assert [row["policy"] for row in rows] == list(policies)
    assert all(0.0 <= row["hold_rate"] <= 1.0 and row["steps"] <= 8 for row in rows)
    effort = {row["policy"]: row["effort"] for row in rows}
    assert effort["dual_newton+2"] > effort["dual_newton"] > effort["pseudoinverse"]


def test_what_cannot_be_evaluated(table, runs, tmp_path) -> None:
    with pytest.raises(TrainingError, match="episodes is 0"):
        plan(table, episodes=0)
    with pytest.raises(TrainingError, match="nothing to evaluate"):
        plan(table, policies=())
    with pytest.raises(UnknownSolverError, match="nosuch"):
        evaluate_policies(plan(table, policies=("nosuch",)))
    with pytest.raises(TrainingError, match="no run of reinforcement learning"):
        evaluate_policies(plan(table, runs=(tmp_path,)))
    with pytest.raises(TrainingError, match="other observations"):
        evaluate_policies(plan(table, env="GraspForceUnannounced-v0", runs=runs[:1]))


def test_gains_are_paired(table, runs) -> None:
    chosen = plan(table, runs=runs[:2], against="dual_newton")
    rows = evaluate_policies(chosen)
    by_name = {row["policy"]: row for row in rows}
    reward = by_name["dual_newton"]["reward"]
    for row in rows:
        low, high = row["gain_ci"]
        assert row["gain"] == pytest.approx(row["reward"] - reward)
        assert low <= row["gain"] <= high
    assert by_name["dual_newton"]["gain_ci"] == [0.0, 0.0]
    assert by_name["random"]["gain_ci"][1] < 0.0
    with pytest.raises(TrainingError, match="against is 'nosuch'"):
        plan(table, against="nosuch")


def test_quality_is_told_where_it_is_paid_for(table, runs, tmp_path) -> None:
    arguments = (f"grasps:{table}", "reward_weights:{q_lrw: 5.0}")
    policies = ("dual_newton", "dual_newton+4")
    rows = evaluate_policies(
        plan(table, env_kwargs=arguments, policies=policies, against="dual_newton", episodes=10)
    )
    assert rows[1]["q_lrw"] > rows[0]["q_lrw"] > 0.0
    page = tmp_path / "page.md"
    write_page(Run("x", {}, PolicyStudy.of(rows, ())), page)
    text = page.read_text()
    assert "| gain over dual_newton |" in text
    assert "| q_lrw, N |" in text
    assert "less that of `dual_newton`" in text
    rows = evaluate_policies(plan(table, episodes=4))
    write_page(Run("x", {}, PolicyStudy.of(rows, ())), page)
    assert "q_lrw" not in page.read_text()
    assert "gain" not in page.read_text()


# -- several runs ----------------------------------------------------------------------------------


def test_seeds_of_one_configuration_are_one_group(runs) -> None:
    groups = run_groups(runs)
    assert [len(folders) for folders in groups.values()] == [3, 1]
    assert next(iter(groups)).startswith("PPO scratch")


def test_configurations_of_one_name_stay_apart(tmp_path) -> None:
    folders = []
    for number, (steps, seed) in enumerate([(100, 0), (100, 1), (200, 0)]):
        settings = RlSettings(output=tmp_path / str(number), steps=steps, seed=seed)
        settings.output.mkdir()
        settings.save()
        folders.append(settings.output)
    assert run_groups(folders) == {"PPO scratch": folders[:2], "PPO scratch (2)": folders[2:]}


def test_arguments_of_the_environment_are_named_where_they_differ(tmp_path) -> None:
    folders = []
    arguments = [("preload:2",), ("preload:2",), ("preload:2", "push:3")]
    for number, env_kwargs in enumerate(arguments):
        settings = RlSettings(output=tmp_path / str(number), env_kwargs=env_kwargs, seed=number)
        settings.output.mkdir()
        settings.save()
        folders.append(settings.output)
    assert run_groups(folders) == {"PPO scratch": folders[:2], "PPO scratch push:3": folders[2:]}


def test_interquartile_mean_leaves_out_the_extremes() -> None:
    assert interquartile_mean(np.array([-100.0, 1.0, 2.0, 3.0, 100.0])) == 2.0
    assert interquartile_mean(np.array([1.0, 2.0])) == 1.5


def test_intervals_cover_what_runs_and_objects_leave_open() -> None:
    rng = seeded(0)
    objects = np.repeat([f"{index:02d}" for index in range(20)], 5)
    of_object = np.repeat(rng.normal(0.0, 1.0, 20), 5)
    of_run = rng.normal(0.0, 1.0, (5, 1))
    alike = over_runs(np.tile(of_object, (5, 1)), objects)
    assert alike.value == pytest.approx(of_object.mean())
    alone = Interval.of(of_object, objects)
    assert alike.ends == pytest.approx(alone.ends, abs=0.1)
    differing = over_runs(of_object + of_run, objects)
    assert differing.value == pytest.approx(interquartile_mean(of_run[:, 0]) + of_object.mean())
    assert np.ptp(differing.ends) > np.ptp(alike.ends)
    assert over_runs(of_object + of_run, objects) == differing


def test_bands_of_curves() -> None:
    middle, low, high = curve_band(np.array([[0.0, 1.0], [2.0, 1.0], [4.0, 1.0]]))
    assert middle.tolist() == [2.0, 1.0]
    assert low[0] < 2.0 < high[0]
    assert low[1] == high[1] == 1.0


# -- page and command ------------------------------------------------------------------------------


def test_page_has_tables_and_curves(table, runs, tmp_path) -> None:
    rows = evaluate_policies(plan(table, runs=runs, episodes=4))
    page = tmp_path / "docs" / "policies.md"
    run = Run("python scripts/evaluate_policies.py --runs x", {}, PolicyStudy.of(rows, runs))
    write_page(run, page)
    text = page.read_text()
    assert "python scripts/evaluate_policies.py --runs x" in text
    assert "| dual_newton |" in text
    assert "(policies.png)" in text
    for folder in (runs[0], runs[3]):
        command = RlSettings.load(folder).command()
        assert f"\n{command}\n" in text
        assert tyro.cli(RlSettings, args=shlex.split(command)[2:]) == RlSettings.load(folder)
    assert "seeds 0, 1, 2\n" in text
    assert (page.parent / "policies.png").stat().st_size > 10_000
    widths = {line.count("|") for line in markdown_table(rows).splitlines()}
    assert len(widths) == 1


@pytest.mark.slow
def test_command_writes_rows_and_page(table, runs, tmp_path) -> None:
    arguments = ["--env", STATIC, "--env-kwargs", f"grasps:{table}", "--episodes", "5"]
    outputs = ["--json", str(tmp_path / "rows.json"), "--page", str(tmp_path / "page.md")]
    done = run_command("evaluate_policies", *arguments, "--workers", 1, "--runs", *runs, *outputs)
    assert done.returncode == 0, done.stderr
    rows = load_run(tmp_path / "rows.json", PolicyStudy).results.rows
    assert {"dual_newton", "reactive", "random"} < {row["policy"] for row in rows}
    assert (tmp_path / "page.md").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--policies", "nosuch"), "unknown solver 'nosuch'"),
        (("--against", "nosuch"), "against is 'nosuch'"),
        (("--policies", "dual_newton+much"), "dual_newton+2"),
        (("--runs", "no/such/run"), "no/such/run"),
        (("--episodes", "0"), "episodes is 0"),
        (("--env", "NoSuch-v0"), "NoSuch"),
        (("--splits", "nosuch"), "nosuch"),
        (("--env-kwargs", "push"), "key:value"),
    ],
)
def test_bad_input_is_one_clear_line(arguments, message) -> None:
    done = run_command("evaluate_policies", *arguments)
    assert_one_clear_line(done, message)
