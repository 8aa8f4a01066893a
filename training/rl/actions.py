"""Actions that are easier to explore than raw forces: every one of them lies in the cones."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from gfo_env.conditions import FRICTION_FACTOR
from gfo_env.env import GraspForceEnv
from gfo_env.mdp.actions import checked_action
from gfo_env.mdp.observation import Observation
from training.networks.settings import TrainingError

REACH = 10.0
"""N, how far above its preload a contact can press; in many grasps no optimum asks for more."""


class ObservingWrapper(gymnasium.Wrapper[Observation, NDArray[np.float32], Observation, Any]):
    """Remembers the observation that the next action is about."""

    def __init__(self, env: gymnasium.Env[Observation, NDArray[np.float32]]) -> None:
        super().__init__(env)
        self.max_force = grasp_force_env(env).settings.max_force
        self._observation: Observation = {}

    def checked(self, action: NDArray[np.float32]) -> NDArray[np.float64]:
        """The action about the last observation, of the shape that this wrapper takes.

        Raises:
            EnvironmentSettingsError: it has another shape, or holds what is no number.
            ResetNeeded: there is no observation yet.
        """
        if not self._observation:
            raise ResetNeeded("There is no observation to act on yet: call reset() first.")
        assert self.action_space.shape is not None
        return checked_action(action, *self.action_space.shape)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """As the environment."""
        self._observation, info = self.env.reset(seed=seed, options=options)
        return self._extended(), info

    def _extended(self) -> Observation:
        """The observation with what the wrapper adds after a reset."""
        return self._observation

    def _extend_space(self, **added: spaces.Space[Any]) -> None:
        inner = self.env.observation_space
        assert isinstance(inner, spaces.Dict)
        self.observation_space = spaces.Dict({**inner.spaces, **added})


class ConeActions(ObservingWrapper):
    """Three numbers a contact in [-1, 1] become a force in its friction cone.

    With (a, b, c) of a contact: it presses with preload + REACH ((c + 1) / 2)^3, and pulls along
    its tangents with (a, b), shortened to length one at most, times what planned friction allows.
    Zero is a squeeze of the preload and 1.25 N.

    Raw forces are hard to explore: of 24 numbers up to 20 N nearly all lie outside every cone.
    """

    def __init__(self, env: gymnasium.Env[Observation, NDArray[np.float32]]) -> None:
        super().__init__(env)
        self.action_space = spaces.Box(-1.0, 1.0, env.action_space.shape, np.float32)

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """As the environment, with the forces that the action stands for."""
        forces = self.forces(self.checked(action)) / self.max_force
        self._observation, reward, terminated, truncated, info = self.env.step(
            np.clip(forces, -1.0, 1.0).astype(np.float32)
        )
        return self._observation, float(reward), terminated, truncated, info

    def forces(self, action: NDArray[np.float64]) -> NDArray[np.float64]:
        """(3n,) N in the contact frames of the last observation."""
        seen = self._observation
        parts = np.clip(action, -1.0, 1.0).reshape(-1, 3)
        normal = seen["normal_min"] + added_force(parts[:, 2])
        normal = np.minimum(normal, seen["normal_max"]) * seen["contact_mask"]
        length = np.linalg.norm(parts[:, :2], axis=1, keepdims=True)
        slope = FRICTION_FACTOR * seen["friction"][:, None] * parts[:, :2] / np.maximum(length, 1.0)
        return np.column_stack([slope * normal[:, None], normal]).reshape(-1)


def added_force(action: NDArray[np.float64]) -> NDArray[np.float64]:
    """N: from 0 to `REACH`, finely at the lower end: what numbers in [-1, 1] add to a preload."""
    return REACH * ((action + 1.0) / 2.0) ** 3


def grasp_force_env(env: gymnasium.Env[Any, Any]) -> GraspForceEnv:
    """The environment inside all wrappers.

    Raises:
        TrainingError: if it is another one.
    """
    inner = env.unwrapped
    if not isinstance(inner, GraspForceEnv):
        raise TrainingError(f"the environment is a {type(inner).__name__}, not one of gfo_env")
    return inner
