"""Training for quality: it learns, resumes to the bit, and says what it cannot do."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import torch

import training.networks.quality as trainer_module
from solvers.learned.files import load_network, read_metadata
from solvers.max_quality.config import QualityNetworkConfig
from solvers.max_quality.network import QualityNetwork
from tests.support.grasp_tables import random_table
from tests.support.seeds import seeded
from training.networks.checkpoint import CHECKPOINT
from training.networks.loop import HISTORY
from training.networks.quality import quality_loss, train_quality
from training.networks.quality_settings import QualityTrainingSettings
from training.networks.settings import TrainingError
from training.problems.quality_sampling import QualitySamplingSettings, sample_quality_problems

SMALL = QualityNetworkConfig(steps=2, width=16, pair_width=8, reach_width=12)


@pytest.fixture(scope="module")
def settings(tmp_path_factory: pytest.TempPathFactory) -> QualityTrainingSettings:
    folder = tmp_path_factory.mktemp("quality")
    random_table(seeded(0), 200).save(folder / "grasps.npz")
    return QualityTrainingSettings(
        grasps=folder / "grasps.npz",
        output=folder / "run",
        steps=60,
        batch=48,
        learning_rate=5e-3,
        warmup=5,
        validate_every=20,
        network=SMALL,
    )


def test_training_raises_quality_on_other_objects(settings: QualityTrainingSettings) -> None:
    summary = train_quality(settings, command="python scripts/train_quality.py")
    history = json.loads((settings.output / HISTORY).read_text())
    assert [row["step"] for row in history] == [0, 20, 40, 60]
    # the even preload is always among the choices
    assert summary.metrics["gain_p10"] >= 0.0
    metadata = read_metadata(summary.weights, QualityNetwork)
    assert metadata["command"] == "python scripts/train_quality.py"
    network = load_network(summary.weights, QualityNetwork)
    table = random_table(seeded(9), 100)
    problem = sample_quality_problems(table, seeded(0))
    torch.manual_seed(settings.seed)
    before = float(quality_loss(QualityNetwork(SMALL), problem).detach())
    assert float(quality_loss(network, problem).detach()) < before


def test_a_stopped_run_goes_on_to_the_same_weights(
    settings: QualityTrainingSettings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = dataclasses.replace(settings, output=tmp_path / "whole", steps=4, validate_every=2)
    stopped = dataclasses.replace(whole, output=tmp_path / "stopped")
    train_quality(whole)
    loss, calls = trainer_module.quality_loss, []

    def failing(*arguments: object) -> torch.Tensor:
        calls.append(arguments)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return loss(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(trainer_module, "quality_loss", failing)
    with pytest.raises(KeyboardInterrupt):
        train_quality(stopped)
    monkeypatch.undo()
    assert torch.load(stopped.output / CHECKPOINT, weights_only=True)["step"] == 2
    first, second = (
        load_network(train_quality(run).weights, QualityNetwork) for run in (whole, stopped)
    )
    for name, value in first.state_dict().items():
        assert torch.equal(value, second.state_dict()[name]), name
    with pytest.raises(TrainingError, match="other settings"):
        train_quality(dataclasses.replace(whole, learning_rate=1e-4))


def test_problems_are_drawn_as_the_settings_say() -> None:
    table = random_table(seeded(1), 300)
    drawn = QualitySamplingSettings(budget=(1.5, 3.0), priced=0.5, price=(0.01, 0.02))
    problem = sample_quality_problems(table, seeded(2), drawn)
    again = sample_quality_problems(table, seeded(2), drawn)
    np.testing.assert_array_equal(problem.effort_budget, again.effort_budget)
    priced = problem.effort_weight > 0.0
    assert 0.35 < priced.mean() < 0.65
    assert (problem.effort_weight[priced] >= 0.01).all()
    assert (problem.effort_weight[priced] <= 0.02).all()
    assert 0 < len(problem) < len(table)


@pytest.mark.parametrize(
    ("changes", "message"),
    [({"steps": 0}, "steps is 0"), ({"validation_share": 1.0}, "validation_share is 1.0")],
)
def test_bad_settings_are_named(
    settings: QualityTrainingSettings, changes: dict[str, float], message: str
) -> None:
    with pytest.raises(TrainingError, match=message):
        dataclasses.replace(settings, **changes)  # type: ignore[arg-type]
