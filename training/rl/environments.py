"""The environment as an agent sees it: made by name, wrapped for its kind of policy, in vectors."""

from collections.abc import Callable
from typing import Any, cast

import gymnasium
from gymnasium.wrappers import FrameStackObservation
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv

import gfo_env
from training.networks.settings import TrainingError

from .actions import ConeActions, grasp_force_env
from .features import LoadFeatures
from .hyperparameters import Hyperparameters, hyperparameters
from .preloads import PreloadActions
from .residual import ResidualForces, ResidualWrench
from .settings import RlSettings, key_values

HISTORY = 3
"""Steps that a residual agent sees at once."""


def make_environment(name: str, arguments: dict[str, Any]) -> gymnasium.Env[Any, Any]:
    """The environment registered under a name.

    Raises:
        TrainingError: if there is none of that name, it is not of this project, or it does not take
            these arguments.
        GraspForceError: for a value that it does not take.
    """
    assert gfo_env, "imported for what it registers"
    try:
        env = gymnasium.make(name, disable_env_checker=True, **arguments)
    except gymnasium.error.Error as error:
        raise TrainingError(f"there is no environment {name!r}: {error}") from error
    except TypeError as error:
        raise TrainingError(f"{name} does not take these arguments: {error}") from error
    try:
        grasp_force_env(env)
    except TrainingError as error:
        raise TrainingError(f"{name} is not an environment of gfo_env") from error
    return env


def training_arguments(settings: RlSettings) -> dict[str, Any]:
    """Arguments of the environment in which the agent is trained."""
    return key_values(settings.env_kwargs)


def held_out_arguments(settings: RlSettings) -> dict[str, Any]:
    """Arguments of the environment in which the agent is evaluated.

    An environment of named objects has no others: agents are judged on those they were trained on.
    """
    arguments = key_values(settings.env_kwargs)
    return (
        arguments
        if "object_ids" in arguments
        else arguments | key_values(settings.evaluation_kwargs)
    )


def situation(settings: RlSettings, env: gymnasium.Env[Any, Any]) -> str:
    """Section of the hyperparameters: residual, residual_forces, preloads, static or dynamic."""
    if settings.policy != "scratch":
        return settings.policy.replace("residual_reactive", "residual")
    return grasp_force_env(env).mode


def run_hyperparameters(settings: RlSettings) -> Hyperparameters:
    """The hyperparameters of a run.

    Raises:
        TrainingError: as `make_environment` and `hyperparameters`.
    """
    env = make_environment(settings.env, training_arguments(settings))
    section = situation(settings, env)
    env.close()
    return hyperparameters(settings.algo, section, key_values(settings.hyperparams))


def wrap(
    env: gymnasium.Env[Any, Any], settings: RlSettings, parameters: Hyperparameters
) -> gymnasium.Env[Any, Any]:
    """The environment as the agents of these settings see it."""
    if settings.policy in ("residual", "residual_reactive"):
        reactive = settings.policy == "residual_reactive"
        features = LoadFeatures(ResidualWrench(env, settings.solver, reactive=reactive))
        return FrameStackObservation(features, HISTORY)
    if settings.policy == "residual_forces":
        return ResidualForces(env, settings.solver)
    if settings.policy == "preloads":
        return PreloadActions(env, settings.solver)
    return ConeActions(env) if parameters.actions == "cone" else env


def make_vector(
    settings: RlSettings, parameters: Hyperparameters, arguments: dict[str, Any], count: int
) -> VecEnv:
    """Environments that are stepped together; each records its episodes."""

    def make() -> gymnasium.Env[Any, Any]:
        env = make_environment(settings.env, arguments)
        return Monitor(wrap(env, settings, parameters))

    makers = cast(list[Callable[[], gymnasium.Env[Any, Any]]], [make] * count)
    if settings.vector == "subproc" and count > 1:
        return SubprocVecEnv(makers)
    return DummyVecEnv(makers)
