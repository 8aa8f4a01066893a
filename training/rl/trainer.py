"""Training an agent of stable-baselines3, from the first step or from the last checkpoint."""

import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback, ConvertCallback
from stable_baselines3.common.logger import configure
from stable_baselines3.common.noise import NormalActionNoise
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

from solvers.exceptions import UnreadableFileError
from solvers.files import make_folder, writing
from training.networks.settings import TrainingError

from .callbacks import (
    TENSORBOARD,
    Checkpoints,
    HeldOutEvaluation,
    begin_segment,
    last_checkpoint,
    read_evaluations,
    save_checkpoint,
)
from .environments import held_out_arguments, make_vector, run_hyperparameters, training_arguments
from .hyperparameters import Hyperparameters
from .network import CONTACT_POLICIES
from .reactions import REACTION_POLICIES
from .settings import SETTINGS, RlSettings
from .state import MODEL, load_state, save_model

ALGORITHMS: dict[str, type[BaseAlgorithm]] = {"ppo": PPO, "sac": SAC, "td3": TD3}


@dataclass(frozen=True)
class RlSummary:
    """What a run amounts to."""

    model: Path
    steps: int
    reward: float
    """Mean return of the last evaluation on held-out objects."""
    hold_rate: float
    """Share of its episodes that ended in success."""


def train_rl(
    settings: RlSettings,
    *,
    progress_bar: bool = False,
    on_step: Callable[[int], Any] | None = None,
) -> RlSummary:
    """Train, or go on with the last checkpoint in the output folder.

    On one machine the same settings give the same weights, stopped in between or not.

    Args:
        settings: of the run.
        progress_bar: whether to show one.
        on_step: called with the number of steps after each of them.

    Raises:
        TrainingError: if the folder holds a run with other settings or a damaged one, or the
            settings cannot be met.
        UnwritableFileError: if the system refuses to write; the last checkpoint is left.
        GraspForceError: from the environment.
    """
    settings.check()
    torch.set_num_threads(1)
    parameters = run_hyperparameters(settings)
    _claim(settings, parameters)
    envs = make_vector(settings, parameters, training_arguments(settings), settings.envs)
    held_out = make_vector(settings, parameters, held_out_arguments(settings), 1)
    try:
        model = new_model(settings, parameters, envs)
        checkpoint = last_checkpoint(settings.output)
        if checkpoint is not None:
            _take_up(checkpoint, model)
        with writing(settings.output):
            logs = configure(str(settings.output / TENSORBOARD), ["tensorboard"])
        model.set_logger(logs)
        evaluation = HeldOutEvaluation(
            _frozen(held_out, model.env),
            settings.output,
            settings.evaluate_every,
            settings.evaluation_episodes,
        )
        checkpoints = Checkpoints(settings.output, settings.checkpoint_every, settings.seed)
        callbacks: list[BaseCallback] = [checkpoints, evaluation]
        if on_step is not None:
            callbacks.append(ConvertCallback(lambda *_: on_step(model.num_timesteps) or True))
        if model.num_timesteps < settings.steps:
            begin_segment(model, settings.seed)
            with _logging(settings.output / TENSORBOARD):
                model.learn(
                    settings.steps - model.num_timesteps,
                    callbacks,
                    reset_num_timesteps=False,
                    progress_bar=progress_bar,
                )
                model.logger.close()
        # of a finished run, too: it may have been killed between these
        save_checkpoint(settings.output, model)
        save_model(settings.output, model)
    finally:
        envs.close()
        held_out.close()
    return _summary(settings.output, model.num_timesteps)


@contextmanager
def _logging(folder: Path) -> Iterator[None]:
    """Raise `UnwritableFileError` where the logs cannot be written, which a thread does."""
    refused: list[OSError] = []
    before = threading.excepthook

    def remember(ended: threading.ExceptHookArgs) -> None:
        if isinstance(ended.exc_value, OSError):
            refused.append(ended.exc_value)
        else:
            before(ended)

    threading.excepthook = remember
    try:
        yield
    except OSError:
        if not refused:
            raise
    finally:
        threading.excepthook = before
    if refused:
        with writing(folder):
            raise refused[0]


def _claim(settings: RlSettings, parameters: Hyperparameters) -> None:
    """Make the folder this run's, or see that it is."""
    output = settings.output
    if (output / SETTINGS).exists():
        same = RlSettings.load(output).identity() == settings.identity()
        if not same or Hyperparameters.load(output) != parameters:
            raise TrainingError(
                f"{output} holds a run with other settings; choose another output folder, "
                "or delete it"
            )
    make_folder(output)
    parameters.save(output)
    settings.save()


def new_model(settings: RlSettings, parameters: Hyperparameters, envs: VecEnv) -> BaseAlgorithm:
    """An agent that has learned nothing yet, and what normalises its observations as its `env`.

    Raises:
        TrainingError: if the algorithm does not take the hyperparameters.
    """
    normalize = dict(parameters.normalize)
    if parameters.network == "contacts":
        normalize["norm_obs"] = False  # normalised numbers are no grasp map any more
    arguments: dict[str, Any] = dict(parameters.algorithm)
    if parameters.noise_std > 0:
        assert envs.action_space.shape is not None
        zero = np.zeros(envs.action_space.shape)
        noise = NormalActionNoise(zero, zero + parameters.noise_std)
        arguments["action_noise"] = noise
    policy = _policy(settings, parameters, envs)
    try:
        normalized = VecNormalize(envs, **normalize)
        return ALGORITHMS[settings.algo](
            policy, normalized, seed=settings.seed, device="cpu", **arguments
        )
    except (AssertionError, RuntimeError, TypeError, ValueError) as error:
        raise TrainingError(f"{settings.algo} cannot be set up: {error}") from error


def _take_up(checkpoint: Path, model: BaseAlgorithm) -> None:
    try:
        load_state(checkpoint, model)
    except (FileNotFoundError, UnreadableFileError) as error:
        raise TrainingError(
            f"the checkpoint {checkpoint} is damaged, or another version's ({error}); delete it to "
            "train from the beginning"
        ) from error


def _policy(
    settings: RlSettings, parameters: Hyperparameters, envs: VecEnv
) -> str | type[BasePolicy]:
    if parameters.network == "mlp":
        plain = isinstance(envs.observation_space, spaces.Box)
        return "MlpPolicy" if plain else "MultiInputPolicy"
    reacts = parameters.network == "reactions"
    policies = REACTION_POLICIES if reacts else CONTACT_POLICIES
    corrects = settings.policy in ("residual", "residual_reactive")
    if settings.algo not in policies or corrects != reacts:
        raise TrainingError(
            f"network {parameters.network} is not for {settings.algo} with policy "
            f"{settings.policy}; use --hyperparams network:mlp"
        )
    return policies[settings.algo]


def _frozen(envs: VecEnv, training: VecEnv | None) -> VecNormalize:
    """The held-out environment, with rewards as they are and the training's normalisation."""
    assert isinstance(training, VecNormalize)
    normalized = VecNormalize(
        envs,
        training=False,
        norm_obs=training.norm_obs,
        norm_reward=False,
        clip_obs=training.clip_obs,
        norm_obs_keys=training.norm_obs_keys,
    )
    return normalized


def _summary(output: Path, steps: int) -> RlSummary:
    saved = read_evaluations(output)
    reward = float(np.mean(saved["results"][-1]))
    held = float(np.mean(saved["successes"][-1])) if "successes" in saved else float("nan")
    return RlSummary(output / MODEL, steps, reward, held)


def as_json(summary: RlSummary) -> dict[str, Any]:
    """The summary as values of JSON."""
    text = json.dumps(vars(summary), default=str)
    return dict(json.loads(text))
