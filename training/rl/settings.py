"""Settings of a reinforcement learning run; reading them needs neither torch nor an environment."""

import dataclasses
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import yaml
from cattrs import BaseValidationError, Converter

from solvers.exceptions import UnreadableFileError
from solvers.files import read_json, write_json
from training.networks.settings import TrainingError, expect_whole

SETTINGS = "settings.json"

CONVERTER = Converter(forbid_extra_keys=True)
"""From values of JSON to dataclasses, and nothing but what these have."""

_MOST_ENVS = 1000
"""So many clients of the simulator end a process."""
_LARGEST_SEED = 2**31 - 1
"""Of numpy's and PyTorch's generators, with room for the environments' own."""


@dataclass(frozen=True)
class RlSettings:
    """Train an agent on the environment; a run that was stopped goes on where it was."""

    output: Path
    """Folder for the checkpoint, the model, its normalisation and the logs."""
    algo: Literal["ppo", "sac", "td3"] = "ppo"
    """Algorithm of stable-baselines3."""
    env: str = "GraspForce-v0"
    """Registered environment."""
    env_kwargs: tuple[str, ...] = ()
    """Arguments of the environment as key:value, such as push:3.0."""
    evaluation_kwargs: tuple[str, ...] = ("split:test",)
    """Arguments that are others where agents are evaluated: the objects that are held out."""
    policy: Literal["scratch", "preloads", "residual", "residual_reactive", "residual_forces"] = (
        "scratch"
    )
    """What an action is: forces; a preload of each contact that a solver answers; a change of the
    load that it answers, and of its preload; the same beside the reactive policy's; or a change of
    the solver's forces."""
    solver: str = "dual_newton"
    """Solver behind preloads and residual policies."""
    steps: int = 100_000
    """Steps of the environment, those of a stopped run included."""
    seed: int = 0
    """Fixes first weights, episodes and exploration."""
    envs: int = 4
    """Environments that are stepped together."""
    vector: Literal["dummy", "subproc"] = "dummy"
    """Whether they live in this process or each in its own."""
    evaluate_every: int = 10_000
    """Steps between evaluations on the held-out objects."""
    evaluation_episodes: int = 50
    """Episodes of each evaluation, the same ones every time."""
    checkpoint_every: int = 10_000
    """Steps between checkpoints."""
    hyperparams: tuple[str, ...] = ()
    """Hyperparameters as key:value, in place of those of training/rl/<algo>.yaml."""

    def check(self) -> None:
        """See that every value can be met.

        Raises:
            TrainingError: if one cannot.
        """
        for name in ("steps", "envs", "evaluate_every", "evaluation_episodes", "checkpoint_every"):
            expect_whole(name, getattr(self, name), least=1)
        expect_whole("envs", self.envs, most=_MOST_ENVS)
        expect_whole("seed", self.seed, most=_LARGEST_SEED)
        for pairs in (self.env_kwargs, self.evaluation_kwargs, self.hyperparams):
            key_values(pairs)

    def identity(self) -> dict[str, Any]:
        """What must not change between the parts of a run: not where it lies, nor how long it is.

        The number of processes is no part of it either: every environment has its own seed.
        """
        values = dataclasses.asdict(self)
        for name in ("output", "steps", "vector"):
            del values[name]
        return {k: list(v) if isinstance(v, tuple) else v for k, v in values.items()}

    def command(self) -> str:
        """The command line that makes this run."""
        words = ["python", "scripts/train_rl.py"]
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if value != field.default:
                several = value if isinstance(value, tuple) else (value,)
                words += [f"--{field.name.replace('_', '-')}", *map(str, several)]
        return shlex.join(words)

    def save(self) -> None:
        """Write the settings into the output folder, less the folder itself."""
        values = self.identity() | {"steps": self.steps, "vector": self.vector}
        write_json(self.output / SETTINGS, values)

    @classmethod
    def load(cls, folder: Path) -> "RlSettings":
        """The settings of the run in a folder.

        Raises:
            TrainingError: if the folder holds no run of reinforcement learning, or its settings are
                damaged.
        """
        path = folder / SETTINGS
        try:
            return CONVERTER.structure(read_json(path) | {"output": folder}, RlSettings)
        except FileNotFoundError as error:
            raise TrainingError(
                f"{folder} holds no run of reinforcement learning; make one with "
                f"scripts/train_rl.py --output {folder}"
            ) from error
        except (UnreadableFileError, BaseValidationError, TypeError, ValueError) as error:
            raise TrainingError(
                f"{path} does not hold the settings of a run; delete it, and the command that "
                "began the run writes it again"
            ) from error


def key_values(pairs: Sequence[str]) -> dict[str, Any]:
    """The dictionary that pairs key:value spell; values are read as YAML.

    Raises:
        TrainingError: for a pair without a colon, or a value that is no YAML.
    """
    result = {}
    for pair in pairs:
        key, colon, value = pair.partition(":")
        if not key or not colon:
            raise TrainingError(f"{pair!r} is not of the form key:value")
        try:
            result[key] = yaml.safe_load(value)
        except yaml.YAMLError as error:
            raise TrainingError(f"the value of {pair!r} cannot be read") from error
    return result
