import dataclasses
import json
import math
import os
import pickle
from pathlib import Path

import numpy as np
import pytest
import torch
from rich.progress import Progress

from gfo_env.grasps import GraspTable
from solvers import SolverError, solve
from solvers.learned.config import NetworkConfig
from solvers.learned.files import load_network, read_metadata
from solvers.learned.network import ConditionedKktNetwork
from solvers.max_quality.config import QualityNetworkConfig
from tests.support.commands import assert_one_clear_line, run_command
from tests.support.grasp_tables import random_table
from tests.support.problems import random_batch
from tests.support.seeds import seeded
from training.networks import conditioned as trainer
from training.networks.checkpoint import CHECKPOINT
from training.networks.conditioned import prepare, train
from training.networks.loop import HISTORY, split_by_object
from training.networks.settings import TrainingError, TrainingSettings
from training.problems.quality_sampling import QualitySamplingSettings
from training.problems.sampling import SamplingError, SamplingSettings

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
    for name in (HISTORY, CHECKPOINT, "conditioned.safetensors"):
        assert (whole.output / name).read_bytes() == (stopped.output / name).read_bytes(), name


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
        {"steps": 1.5},
        {"batch": -1},
        {"validate_every": 0},
        {"warmup": -1},
        {"seed": -1},
        {"seed": 2**63},
        {"learning_rate": 0.0},
        {"learning_rate": math.nan},
        {"learning_rate": math.inf},
        {"gradient_norm": math.nan},
        {"gradient_norm": math.inf},
        {"gradient_norm": -1.0},
        {"validation_share": 1.0},
        {"validation_share": math.nan},
        {"collocation": math.nan},
        {"collocation": -0.1},
        {"collocation": 1.1},
    ],
)
def test_bad_settings_are_refused(settings: TrainingSettings, change: dict[str, float]) -> None:
    with pytest.raises(TrainingError, match=next(iter(change))):
        dataclasses.replace(settings, **change)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("kind", "change"),
    [
        (SamplingSettings, {"mass": (0.0, 1.0)}),
        (SamplingSettings, {"mass": (math.nan, 1.0)}),
        (SamplingSettings, {"push": math.inf}),
        (SamplingSettings, {"torque": -1.0}),
        (SamplingSettings, {"friction": (1.0, 0.5)}),
        (SamplingSettings, {"cap": (0.0, 1.0)}),
        (SamplingSettings, {"hard": 1.5}),
        (QualitySamplingSettings, {"budget": (0.0, 2.0)}),
        (QualitySamplingSettings, {"priced": math.nan}),
        (QualitySamplingSettings, {"price": (0.1, math.inf)}),
    ],
)
def test_ranges_that_nothing_can_be_drawn_from_are_refused(
    kind: type[object], change: dict[str, object]
) -> None:
    with pytest.raises(SamplingError, match=next(iter(change))):
        kind(**change)


@pytest.mark.parametrize(
    "change",
    [{"width": 0}, {"width": -1}, {"width": 10**9}, {"memory": 1.5}, {"steps": -1}, {"steps": 1e9}],
)
def test_networks_that_cannot_be_made_are_refused(change: dict[str, int]) -> None:
    for kind in (NetworkConfig, QualityNetworkConfig):
        if next(iter(change)) in vars(kind()):
            with pytest.raises(SolverError, match=next(iter(change))):
                kind(**change)
    with pytest.raises(SolverError, match="coordinates"):
        NetworkConfig(coordinates="polar")  # type: ignore[arg-type]


def test_gradients_that_are_not_finite_end_the_training(
    settings: TrainingSettings, tmp_path: Path
) -> None:
    run = dataclasses.replace(settings, output=tmp_path, learning_rate=1e30, warmup=0)
    with pytest.raises(TrainingError, match="not finite; use a smaller learning rate"):
        train(run)


class Trap:
    """What must never be called."""

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return os.mkdir, ("sprung",)


def test_damaged_checkpoints_are_named_and_never_run(
    settings: TrainingSettings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    run = dataclasses.replace(settings, output=tmp_path / "run", steps=2, validate_every=1)
    train(run)
    path = run.output / CHECKPOINT
    whole = path.read_bytes()
    state = torch.load(path, weights_only=True)
    flipped = bytearray(whole)
    weight = max(state["network"].values(), key=torch.numel)
    flipped[whole.index(weight.numpy().tobytes())] ^= 1
    half = whole[: len(whole) // 2]
    strange: list[bytes] = [b"", b"text", half, bytes(flipped), pickle.dumps(Trap())]
    for content in (Trap(), [1], {}, state | {"step": "2"}, state | {"optimizer": {}}):
        torch.save(content, path)
        strange.append(path.read_bytes())
    for content in strange:
        path.write_bytes(content)
        with pytest.raises(TrainingError, match=r"checkpoint\.pt is damaged; delete it"):
            train(run)
    assert sorted(os.listdir(tmp_path)) == ["run"]
    path.write_bytes(whole)
    assert train(run).steps == 2


@pytest.mark.parametrize(
    "words",
    [
        ("--seed", "-1"),
        ("--learning-rate", "nan"),
        ("--gradient-norm", "nan"),
        ("--network.width", "-3"),
        ("--sampling.mass", "nan", "1"),
    ],
)
@pytest.mark.parametrize("command", ["train", "train_quality"])
def test_commands_refuse_settings_in_one_line(command: str, words: tuple[str, ...]) -> None:
    names = {"train_quality": {"--sampling.mass": "--sampling.constraints.mass"}}
    words = (names.get(command, {}).get(words[0], words[0]), *words[1:])
    done = run_command(command, "--grasps", "grasps.npz", "--output", "run", *words)
    assert_one_clear_line(done, f"{words[0].split('.')[-1].strip('-').replace('-', '_')} ")


def test_command_names_what_is_wrong_in_one_line(tmp_path: Path) -> None:
    missing = tmp_path / "missing.npz"
    done = run_command("train", "--grasps", missing, "--output", tmp_path / "run")
    assert_one_clear_line(done, "error: no grasps at")
