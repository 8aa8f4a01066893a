"""Checkpoints of a training run: written whole or not at all, and only taken up by the same run."""

import dataclasses
import hashlib
import json
import os
from pathlib import Path
from typing import Any

import torch
from torch import nn

from gfo_env.grasps import GraspTable

from .settings import RunSettings, TrainingError

CHECKPOINT = "checkpoint.pt"

History = list[dict[str, float]]


def run_identity(settings: RunSettings, kind: type[RunSettings]) -> str:
    """What must not change between the parts of a run: settings and grasps, not where they lie.

    Args:
        settings: of the run.
        kind: the class whose fields count, those of a command's own left out.
    """
    values = dataclasses.asdict(settings)
    names = {field.name for field in dataclasses.fields(kind)} - {"grasps", "output"}
    content = hashlib.sha256(settings.grasps.read_bytes()).hexdigest()
    kept = {name: values[name] for name in names} | {"grasps": content}
    return json.dumps(kept, sort_keys=True)


def save_checkpoint(
    output: Path,
    identity: str,
    network: nn.Module,
    optimizer: Any,
    step: int,
    history: History,
) -> None:
    """Write the state of a run after `step` steps."""
    state = {
        "settings": identity,
        "step": step,
        "history": history,
        "network": network.state_dict(),
        "optimizer": optimizer.state_dict(),
    }
    path = output / CHECKPOINT
    partial = path.with_suffix(".partial")
    torch.save(state, partial)
    os.replace(partial, path)  # a kill leaves the old checkpoint or the new one, never half of one


def resume(
    output: Path, identity: str, network: nn.Module, optimizer: torch.optim.Optimizer
) -> tuple[int, History]:
    """Steps already done, and their history; loads the checkpoint if there is one.

    Raises:
        TrainingError: if the folder holds a run with other settings.
    """
    path = output / CHECKPOINT
    if not path.exists():
        return 0, []
    state = torch.load(path, weights_only=True, map_location="cpu")
    if state["settings"] != identity:
        raise TrainingError(
            f"{output} holds a run with other settings or grasps; choose another output folder, "
            f"or delete {path}"
        )
    network.load_state_dict(state["network"])
    optimizer.load_state_dict(state["optimizer"])
    return state["step"], state["history"]


def provenance(
    settings: RunSettings, command: str, training: GraspTable, metrics: dict[str, float]
) -> dict[str, str]:
    """What a file of weights says about how it was made.

    Args:
        settings: of the run.
        command: that made it.
        training: grasps that it was trained on.
        metrics: of the last validation.
    """
    return {
        "command": command,
        "seed": str(settings.seed),
        "steps": str(settings.steps),
        "grasps": f"{len(training)} of {len(set(training.object_id))} objects "
        f"({training.object_set}, {training.split})",
        "validation": json.dumps(metrics),
    }
