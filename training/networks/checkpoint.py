"""Checkpoints of a training run: written whole or not at all, and only taken up by the same run."""

import dataclasses
import hashlib
import io
import json
import sys
from pathlib import Path
from typing import Any

import torch
from torch import nn

from gfo_env.grasps import GraspTable
from solvers.exceptions import UnreadableFileError
from solvers.files import check_archive, reading, write_bytes

from .settings import RunSettings, TrainingError

CHECKPOINT = "checkpoint.pt"

_STATE = {"settings": str, "step": int, "history": list, "network": dict, "optimizer": dict}
"""What a checkpoint holds."""

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
    """Write the state of a run after `step` steps.

    Raises:
        UnwritableFileError: if the system refuses; the checkpoint before this one is left.
    """
    state = {
        "settings": identity,
        "step": step,
        "history": history,
        "network": network.state_dict(),
        "optimizer": optimizer.state_dict(),
    }
    content = io.BytesIO()
    torch.save(_interned(state), content)
    write_bytes(output / CHECKPOINT, content.getvalue())


def _interned(value: Any) -> Any:
    """The same state with equal names in one place of memory each.

    A pickle refers to a text that it has met before, but only if it is the very same one, which
    depends on whether it was read from a checkpoint: the same state would not give the same bytes.
    """
    if isinstance(value, dict):
        return {_interned(key): _interned(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_interned(one) for one in value]
    return sys.intern(value) if type(value) is str else value


def resume(
    output: Path, identity: str, network: nn.Module, optimizer: torch.optim.Optimizer
) -> tuple[int, History]:
    """Steps already done, and their history; loads the checkpoint if there is one.

    Raises:
        TrainingError: if the folder holds a run with other settings, or a checkpoint that is
            damaged.
    """
    path = output / CHECKPOINT
    try:
        state = _read(path)
    except FileNotFoundError:
        return 0, []
    except UnreadableFileError as error:
        raise _damaged(path) from error
    if state["settings"] != identity:
        raise TrainingError(
            f"{output} holds a run with other settings or grasps; choose another output folder, "
            f"or delete {path}"
        )
    try:
        network.load_state_dict(state["network"])
        optimizer.load_state_dict(state["optimizer"])
    except (KeyError, IndexError, TypeError, ValueError, RuntimeError, AttributeError) as error:
        raise _damaged(path) from error
    return state["step"], state["history"]


def _read(path: Path) -> dict[str, Any]:
    """The state in a checkpoint: tensors, numbers and texts, never objects of other classes."""
    with reading(path) as stream:
        check_archive(stream)
        state = torch.load(stream, weights_only=True, map_location="cpu")
        for name, kind in _STATE.items():
            if not isinstance(state[name], kind):
                raise TypeError(f"{name} is a {type(state[name]).__name__}")
        return dict(state)


def _damaged(path: Path) -> TrainingError:
    return TrainingError(f"the checkpoint {path} is damaged; delete it to train from the beginning")


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
