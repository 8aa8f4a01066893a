"""Hyperparameters of each algorithm in each situation, from the YAML files beside this module."""

import dataclasses
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any, Self

import yaml
from cattrs import BaseValidationError

from solvers.exceptions import UnreadableFileError
from solvers.files import read_json, write_json
from training.networks.settings import TrainingError

from .settings import CONVERTER, SETTINGS

HYPERPARAMETERS = "hyperparameters.json"

_UNFIT = (BaseValidationError, TypeError, ValueError)
"""What cattrs raises for values of other types."""

_ACTIONS = ("cone", "forces")
_NETWORKS = ("mlp", "contacts", "reactions")


@dataclass(frozen=True)
class Hyperparameters:
    """How an agent learns.

    Args:
        actions: of an agent from scratch: "forces" as the environment takes them, or "cone": see
            `training.rl.actions`.
        network: "mlp"; "contacts": see `training.rl.network`; or, for corrections of a load,
            "reactions": see `training.rl.reactions`.
        normalize: arguments of `VecNormalize`.
        noise_std: standard deviation of the noise on actions, for algorithms that have no other.
        algorithm: arguments of the algorithm's class in stable-baselines3.
    """

    actions: str = "cone"
    network: str = "mlp"
    normalize: dict[str, Any] = field(default_factory=dict)
    noise_std: float = 0.0
    algorithm: dict[str, Any] = field(default_factory=dict)

    def save(self, folder: Path) -> None:
        """Write them into the folder of a run: the YAML files may change, the run does not."""
        write_json(folder / HYPERPARAMETERS, dataclasses.asdict(self), sort_keys=True)

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Those of the run in a folder.

        Raises:
            TrainingError: if they are missing or damaged.
        """
        path = folder / HYPERPARAMETERS
        try:
            return CONVERTER.structure(read_json(path), cls)
        except (FileNotFoundError, UnreadableFileError, *_UNFIT) as error:
            raise TrainingError(
                f"{path} is missing or damaged; delete {folder / SETTINGS}, and the command that "
                "began the run writes both again"
            ) from error


def _numbers(name: str, value: Any) -> Iterator[tuple[str, float]]:
    """All fractions in nested dictionaries and lists, with the name of where they stand."""
    if isinstance(value, dict):
        for key, one in value.items():
            yield from _numbers(str(key), one)
    elif isinstance(value, list):
        for one in value:
            yield from _numbers(name, one)
    elif isinstance(value, float):
        yield name, value


def hyperparameters(algo: str, situation: str, changes: dict[str, Any]) -> Hyperparameters:
    """The hyperparameters of an algorithm.

    Args:
        algo: ppo, sac or td3.
        situation: static, dynamic, residual, residual_forces or preloads: a section of the YAML
            file.
        changes: in place of what the file says; `policy_kwargs` are merged.

    Raises:
        TrainingError: if a value of `actions` or `network` does not exist, or a number is not
            finite.
    """
    text = resources.files(__package__).joinpath(f"{algo}.yaml").read_text()
    values: dict[str, Any] = yaml.safe_load(text)[situation]
    changes = dict(changes)
    if "policy_kwargs" in changes:
        changes["policy_kwargs"] = values.get("policy_kwargs", {}) | changes["policy_kwargs"]
    values = values | changes
    own = {
        name: values.pop(name)
        for name in ("actions", "network", "normalize", "noise_std")
        if name in values
    }
    for name, number in _numbers("", own | values):
        if not math.isfinite(number):
            raise TrainingError(f"{name} is {number}; it must be finite")
    try:
        result = CONVERTER.structure(own | {"algorithm": values}, Hyperparameters)
    except _UNFIT as error:
        raise TrainingError(f"these hyperparameters cannot be read: {own}") from error
    if result.noise_std < 0.0:
        raise TrainingError(f"noise_std is {result.noise_std}; it must be 0 or more")
    for name, choices in (("actions", _ACTIONS), ("network", _NETWORKS)):
        if getattr(result, name) not in choices:
            raise TrainingError(
                f"{name} is {getattr(result, name)!r}; choose one of {', '.join(choices)}"
            )
    return result
