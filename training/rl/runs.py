"""A finished run: its agent as a policy, its settings, its learning curve."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize
from tensorboard.backend.event_processing.event_file_loader import EventFileLoader

from solvers.exceptions import UnreadableFileError
from training.networks.settings import TrainingError

from .callbacks import TENSORBOARD, read_evaluations
from .environments import wrap
from .hyperparameters import Hyperparameters
from .settings import RlSettings
from .state import SpacesOnly, load_model, load_spaces
from .trainer import new_model


@dataclass(frozen=True, eq=False)
class Agent:
    """The last model of a run, with the normalisation that it was trained with.

    The last one and not the best: which one is best was measured on the held-out objects.
    """

    settings: RlSettings
    parameters: Hyperparameters
    model: BaseAlgorithm
    normalization: VecNormalize

    def wrap(self, env: gymnasium.Env[Any, Any]) -> gymnasium.Env[Any, Any]:
        """The environment as this agent sees it.

        Raises:
            TrainingError: if it is not one that the agent was trained for.
        """
        wrapped = wrap(env, self.settings, self.parameters)
        if _layout(wrapped.observation_space) != _layout(self.model.observation_space):
            raise TrainingError(
                f"the run in {self.settings.output} was trained on other observations: "
                f"{self.settings.env} {' '.join(self.settings.env_kwargs)}".strip()
            )
        return wrapped

    def predict(
        self,
        observation: Any,
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[Any], tuple[NDArray[Any], ...] | None]:
        """As in stable-baselines3, for observations that are not normalised yet."""
        seen: Any = self.normalization.normalize_obs(observation)
        return self.model.predict(seen, state, episode_start, deterministic)


@cache
def load_agent(folder: Path) -> Agent:
    """The agent of a finished run; nothing in the folder is unpickled.

    Raises:
        TrainingError: if there is none in the folder, or it is damaged.
    """
    settings, parameters = RlSettings.load(folder), Hyperparameters.load(folder)
    settings.check()
    try:
        seen, done = load_spaces(folder)
        # as many as it was trained with: their number is a part of the algorithm's arguments
        envs = DummyVecEnv([lambda: SpacesOnly(seen, done)] * settings.envs)
        model = new_model(settings, parameters, envs)
        load_model(folder, model)
    except UnreadableFileError as error:
        raise TrainingError(f"the agent in {folder} is damaged: {error}; train it again") from error
    except FileNotFoundError as error:
        raise TrainingError(
            f"the run in {folder} is not finished; the command that began it goes on with it"
        ) from error
    assert isinstance(model.env, VecNormalize)
    return Agent(settings, parameters, model, model.env)


def run_groups(runs: Sequence[Path]) -> dict[str, list[Path]]:
    """Runs that differ in nothing but the seed, by a name, in the order of first appearance.

    Names tell the arguments of the environment that not all runs in it have.
    """
    groups: dict[str, list[Path]] = {}
    names: dict[str, str] = {}
    loaded = {folder: RlSettings.load(folder) for folder in runs}
    for folder, settings in loaded.items():
        others = [other.env_kwargs for other in loaded.values() if other.env == settings.env]
        own = [one for one in settings.env_kwargs if not all(one in other for other in others)]
        same = {**settings.identity(), "steps": settings.steps, "seed": None}
        key = json.dumps(same, sort_keys=True)
        if key not in names:
            kind = settings.policy.replace("_", " ")
            name = " ".join([settings.algo.upper(), kind, *settings.hyperparams, *own])
            taken = sum(other == name or other.startswith(f"{name} (") for other in groups)
            names[key] = f"{name} ({taken + 1})" if taken else name
        groups.setdefault(names[key], []).append(folder)
    return groups


def learning_curve(folder: Path) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Steps (k,) and mean return on held-out objects (k,) of each evaluation of a run.

    Raises:
        TrainingError: if its evaluations are missing or damaged.
    """
    saved = read_evaluations(folder)
    return saved["timesteps"], saved["results"].mean(axis=1)


def training_minutes(folder: Path) -> float:
    """How long a run took, evaluations included; what a kill cost is counted, pauses are not."""
    seconds = 0.0
    for path in (folder / TENSORBOARD).glob("events.*"):
        times = [event.wall_time for event in EventFileLoader(str(path)).Load()]
        seconds += max(times) - min(times)
    return seconds / 60.0


def _layout(space: spaces.Space[Any]) -> dict[str, Any]:
    """Shapes of what an observation consists of; bounds follow from the loads and may differ."""
    if isinstance(space, spaces.Dict):
        return {name: box.shape for name, box in space.spaces.items()}
    return {"": space.shape}
