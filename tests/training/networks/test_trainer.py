import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import torch
from rich.progress import Progress

from gfo_env.grasps import GraspTable
from solvers import solve
from solvers.learned.config import NetworkConfig
from solvers.learned.files import load_network, read_metadata
from solvers.learned.network import ConditionedKktNetwork
from tests.support.commands import assert_one_clear_line, run_command
from tests.support.grasp_tables import random_table
from tests.support.problems import random_batch
from tests.support.seeds import seeded
from training.networks import conditioned as trainer
from training.networks.checkpoint import CHECKPOINT
from training.networks.conditioned import prepare, train
from training.networks.loop import HISTORY, split_by_object
from training.networks.settings import TrainingError, TrainingSettings

SMALL = NetworkConfig(steps=2, width=16, vectors=4, memory=4, joint_width=8)


@pytest.fixture(scope="module")
def settings(tmp_path_factory: pytest.TempPathFactory) -> TrainingSettings:
    folder = tmp_path_factory.mktemp("training")
    random_table(seeded(0), 400).save(folder / "grasps.npz")
    return TrainingSettings(
        grasps=folder / "grasps.npz",
        output=folder / "run",
        steps=80,
        batch=64,
        learning_rate=3e-3,
        warmup=5,
        # on a tenth of 200 grasps, which is twenty, the loss grew for three of four draws
        validation_share=0.3,
        validate_every=20,
        network=SMALL,
    )


def test_training_improves_the_bound_on_other_objects(settings: TrainingSettings) -> None:
    with Progress(disable=True) as progress:
        summary = train(settings, command="python scripts/train.py", progress=progress)
        assert progress.finished
    history = json.loads((settings.output / HISTORY).read_text())
    assert [row["step"] for row in history] == [0, 20, 40, 60, 80]
    # what is trained falls by 0.011 to 0.027 on seven draws; of eighty steps single grasps may gain
    # or lose: the gap of the worst grew on three draws of twenty, by up to 5 %
    assert history[-1]["loss"] < history[0]["loss"] - 0.005
    assert history[-1]["gap_p99"] < 1.1 * history[0]["gap_p99"]
    assert summary.metrics["loss"] == history[-1]["loss"]
    metadata = read_metadata(summary.weights, ConditionedKktNetwork)
    assert metadata["command"] == "python scripts/train.py"
    assert json.loads(metadata["validation"]) == summary.metrics
    answer = solve(random_batch(seeded(0), 5), "conditioned", weights=summary.weights)
    assert np.all(np.isin(answer.status, ["optimal", "feasible", "infeasible"]))


def test_validation_problems_do_not_depend_on_how_hard_the_training_is(
    settings: TrainingSettings, tmp_path: Path
) -> None:
    rows = []
    for hard in (0.0, 1.0):
        sampling = dataclasses.replace(settings.sampling, hard=hard)
        run = dataclasses.replace(
            settings, output=tmp_path / str(hard), steps=1, validate_every=1, sampling=sampling
        )
        train(run)
        rows.append(json.loads((run.output / HISTORY).read_text()))
    assert rows[0][0] == rows[1][0]
    assert rows[0][1] != rows[1][1]


class Killed(Exception):
    """Stands for a signal that ends the process."""


def test_killed_run_goes_on_to_the_same_weights(
    settings: TrainingSettings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = dataclasses.replace(settings, output=tmp_path / "whole", steps=12, validate_every=5)
    stopped = dataclasses.replace(whole, output=tmp_path / "stopped")
    train(whole)

    calls = iter(range(1000))
    sample = trainer.sample_problems

    def killing(*arguments: object) -> object:
        if next(calls) == 9:  # the first call makes the validation problems
            raise Killed
        return sample(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(trainer, "sample_problems", killing)
    with pytest.raises(Killed):
        train(stopped)
    monkeypatch.undo()
    assert torch.load(stopped.output / CHECKPOINT, weights_only=True)["step"] == 5
    first, second = (
        load_network(train(run).weights, ConditionedKktNetwork) for run in (whole, stopped)
    )
    for name, value in first.state_dict().items():
        assert torch.equal(value, second.state_dict()[name]), name
    assert (whole.output / HISTORY).read_text() == (stopped.output / HISTORY).read_text()


def test_other_settings_do_not_resume(settings: TrainingSettings, tmp_path: Path) -> None:
    run = dataclasses.replace(settings, output=tmp_path, steps=2, validate_every=1)
    train(run)
    with pytest.raises(TrainingError, match="other settings"):
        train(dataclasses.replace(run, steps=3))


def test_other_grasps_do_not_resume_and_moved_ones_do(
    settings: TrainingSettings, tmp_path: Path
) -> None:
    run = dataclasses.replace(settings, output=tmp_path / "run", steps=2, validate_every=1)
    train(run)
    moved = tmp_path / "moved.npz"
    moved.write_bytes(settings.grasps.read_bytes())
    assert train(dataclasses.replace(run, grasps=moved)).steps == 2
    GraspTable.load(moved)[::2].save(moved)
    with pytest.raises(TrainingError, match="or grasps"):
        train(dataclasses.replace(run, grasps=moved))


def test_objects_are_split_not_grasps(settings: TrainingSettings) -> None:
    table = random_table(seeded(0), 60)
    training, held_out = split_by_object(table, settings.validation_share, settings.seed)
    assert len(training) + len(held_out) == len(table)
    assert set(training.object_id).isdisjoint(held_out.object_id)
    assert len(set(held_out.object_id)) == 6
    with pytest.raises(TrainingError, match="all grasps of the table are of 000"):
        split_by_object(table[table.object_id == "000"], 0.1, 0)


def test_prepared_problems_are_float32() -> None:
    exact, form = prepare(random_batch(seeded(0), 3))
    assert exact.problem.grasp_map.dtype == np.float64
    assert form.problem.grasp_map.dtype == torch.float32
    assert form.problem.contact_mask.dtype == torch.bool


@pytest.mark.parametrize(
    "change",
    [
        {"steps": 0},
        {"batch": -1},
        {"learning_rate": 0.0},
        {"validation_share": 1.0},
        {"collocation": -0.1},
        {"collocation": 1.1},
    ],
)
def test_bad_settings_are_refused(settings: TrainingSettings, change: dict[str, float]) -> None:
    with pytest.raises(TrainingError, match=next(iter(change))):
        dataclasses.replace(settings, **change)  # type: ignore[arg-type]


def test_command_names_what_is_wrong_in_one_line(tmp_path: Path) -> None:
    missing = tmp_path / "missing.npz"
    done = run_command("train", "--grasps", missing, "--output", tmp_path / "run")
    assert_one_clear_line(done, "error: no grasps at")
