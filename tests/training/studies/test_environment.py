"""The report on the environment's speed: its parts, its page, bad input."""

import math
import sys
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from gfo_env.env import GraspForceEnv
from gfo_env.grasps.collection import CollectionPlan, collect
from gfo_env.objects import RANDOM_URDFS, ObjectSet
from gfo_env.simulation import Simulation
from scripts.benchmark_env import BenchmarkEnvSettings, main
from tests.support.commands import assert_one_clear_line, run_command
from training.reports.results import load_run
from training.studies.environment.accuracy import LEAST_NORM, RANDOM, accuracy
from training.studies.environment.peer import check_peer
from training.studies.environment.plan import EnvSpeedError, SpeedPlan
from training.studies.environment.recording import play, play_bare, record
from training.studies.environment.run import SpeedReport
from training.studies.environment.stages import REST, stage_times


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A few grasps of a few objects, by split."""
    folder = tmp_path_factory.mktemp("grasps")
    paths = {}
    for split, ids in (("train", ("001", "002", "003")), ("test", ("010", "020", "030"))):
        paths[split] = folder / f"{split}.npz"
        objects = ObjectSet(RANDOM_URDFS, split, object_ids=ids)
        collect(CollectionPlan(objects, 6, 0), output=paths[split])
    return paths


@pytest.fixture(scope="module")
def env(tables: dict[str, Path]) -> GraspForceEnv:
    return GraspForceEnv(grasps=tables["train"])


def numbers(row: Any) -> list[float]:
    """Every number in a row of the JSON file."""
    if isinstance(row, dict):
        return [number for value in row.values() for number in numbers(value)]
    if isinstance(row, list | tuple):
        return [number for value in row for number in numbers(value)]
    return [float(row)] if isinstance(row, int | float) else []


def test_bare_simulator_ends_in_the_same_bits(env: GraspForceEnv) -> None:
    episodes = record(env, 0.01, seed=3)
    # gravity, mass or friction change in every episode of seven loads
    assert any(len(each.commands) > 3 for each in episodes)
    played = play(env, episodes)
    bare = play_bare(Simulation(env.hand), episodes)
    assert bare.identical == len(episodes)
    assert 0.0 < bare.physics < bare.steps
    assert played.steps > 0.0
    assert len(played.resets) == len(bare.loads) == len(episodes)


def test_stages_add_up_to_the_step_and_leave_no_clock_behind(env: GraspForceEnv) -> None:
    episodes = record(env, 0.01, seed=4)
    before = GraspForceEnv.step
    stages = stage_times(env, episodes)
    assert GraspForceEnv.step is before
    assert all(seconds > 0.0 for seconds in stages.values())
    assert stages["physics, with its commands"] > stages[REST]


def test_accuracy_knows_a_bound_from_a_guess(tables: dict[str, Path]) -> None:
    found = {each.forces: each for each in accuracy(6, 0, tables["test"], lambda: None)}
    assert set(found) == {LEAST_NORM, RANDOM}
    for each in found.values():
        assert each.grasps == 6
        assert each.disagreeing == 0
        # an upper bound; pyramids are lower bounds, and more edges bring them closer
        assert -1e-9 <= each.estimate.median <= each.estimate.largest
        assert 0.0 <= each.eight.median <= each.four.median


def test_report_end_to_end(tables: dict[str, Path], tmp_path: Path) -> None:
    settings = BenchmarkEnvSettings(
        page=tmp_path / "environment.md",
        seconds=0.05,
        repeats=1,
        workers=(1,),
        resets=4,
        objects=2,
        grasps=3,
        chunks=1,
        table=tables["train"],
        held_out_table=tables["test"],
        json=tmp_path / "report.json",
    )
    main(settings)
    page = settings.page.read_text()
    assert "{" not in page
    assert "nan" not in page
    assert "--table train.npz" in page
    assert "pip install panda-gym" in page
    assert "## Memory" in page
    picture = tmp_path / "environment.png"
    assert picture.stat().st_size < 100_000
    assert len(np.unique(np.asarray(Image.open(picture).convert("L")))) > 5
    report = load_run(tmp_path / "report.json", SpeedReport).results
    assert all(math.isfinite(number) for number in numbers(asdict(report)))
    assert 0.0 < report.steps.ratio < 1.5
    assert report.steps.identical == 1.0
    assert report.memory.objects == 2
    assert report.memory.files[0] == report.memory.files[1]
    assert report.memory.clients[0] == report.memory.clients[1]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--peer-python", "no/such/python"), "no/such/python"),
        (("--peer-python", sys.executable), "panda_gym"),
        (("--repeats", "0"), "repeats is 0"),
        (("--seconds", "0"), "seconds is 0"),
        (("--workers", "0"), "workers is (0,)"),
        (("--page", "tests"), "tests is a folder"),
        (("--table", "no_such.npz"), "no_such.npz"),
    ],
)
def test_bad_input_is_one_clear_line(arguments: tuple[str, str], message: str) -> None:
    done = run_command("benchmark_env", *arguments)
    assert_one_clear_line(done, message)


def test_peer_needs_panda_gym() -> None:
    with pytest.raises(EnvSpeedError, match="panda_gym"):
        check_peer(Path(sys.executable))


@pytest.mark.parametrize("name", ["resets", "objects", "grasps", "chunks"])
def test_plan_refuses_nothing_to_do(name: str) -> None:
    with pytest.raises(EnvSpeedError, match=f"{name} is 0"):
        replace(SpeedPlan(), **{name: 0}).check()
