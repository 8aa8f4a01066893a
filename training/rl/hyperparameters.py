"""Hyperparameters of each algorithm in each situation, from the YAML files beside this module."""

import dataclasses
import json
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any, Self

import yaml

from training.networks.settings import TrainingError

HYPERPARAMETERS = "hyperparameters.json"

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
        text = json.dumps(dataclasses.asdict(self), indent=2, sort_keys=True)
        (folder / HYPERPARAMETERS).write_text(text + "\n")

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Those of the run in a folder."""
        return cls(**json.loads((folder / HYPERPARAMETERS).read_text()))


def hyperparameters(algo: str, situation: str, changes: dict[str, Any]) -> Hyperparameters:
    """The hyperparameters of an algorithm.

    Args:
        algo: ppo, sac or td3.
        situation: static, dynamic, residual, residual_forces or preloads: a section of the YAML
            file.
        changes: in place of what the file says; `policy_kwargs` are merged.

    Raises:
        TrainingError: if a value of `actions` or `network` does not exist.
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
    result = Hyperparameters(**own, algorithm=values)
    for name, choices in (("actions", _ACTIONS), ("network", _NETWORKS)):
        if getattr(result, name) not in choices:
            raise TrainingError(
                f"{name} is {getattr(result, name)!r}; choose one of {', '.join(choices)}"
            )
    return result
