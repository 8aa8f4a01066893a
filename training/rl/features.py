"""What a residual agent needs to know of an observation: a short vector instead of matrices."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from gfo_env.episode import CONTROL_PERIOD
from gfo_env.observation import Observation

from .planning import measured_wrench, moment_arm

Array = NDArray[np.float64]
Vector = NDArray[np.float32]
Action = NDArray[np.float32]


class LoadFeatures(gymnasium.Wrapper[Any, Action, Any, Action]):
    """Observations of `ResidualWrench` as one vector, in N, m and s; torques over the moment arm.

    Always: announced load (6), friction, number of contacts, preload, last correction (7), wrench
    commanded last (6). Where the environment tells of them: wrench of the measured contact forces
    (6) and what it lacks for balancing the announced load (6), least and mean measured normal force
    (2), velocity of the object (6), how far that has carried it since the reset (6), velocities of
    the joints (n_tau). Vectors are in the object frame, like the correction.
    """

    def __init__(self, env: gymnasium.Env[Any, Action]) -> None:
        super().__init__(env)
        inner = env.observation_space
        assert isinstance(inner, spaces.Dict)
        self._drift = np.zeros(6)
        blank = {name: np.zeros_like(box.sample()) for name, box in inner.spaces.items()}
        size = len(self._vector(blank))
        self.observation_space = spaces.Box(-np.inf, np.inf, (size,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Vector, dict[str, Any]]:
        """As the environment."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._drift = np.zeros(6)
        return self._vector(observation), info

    def step(self, action: Action) -> tuple[Vector, float, bool, bool, dict[str, Any]]:
        """As the environment."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        if "object_velocity" in observation:
            self._drift = self._drift + CONTROL_PERIOD * observation["object_velocity"]
        return self._vector(observation), float(reward), terminated, truncated, info

    def _vector(self, seen: Observation) -> Vector:
        arm = moment_arm(seen)
        over_arm = 1.0 / np.repeat([1.0, arm], 3)
        mask = seen["contact_mask"] > 0
        announced = seen["external_wrench"] * over_arm
        parts: list[Any] = [
            announced,
            [_mean(seen["friction"][mask]), mask.sum(), _mean(seen["normal_min"][mask])],
            seen["correction"],
            seen["commanded_wrench"] * over_arm,
        ]
        if "contact_forces" in seen:
            measured = measured_wrench(seen) * over_arm
            normal = seen["contact_forces"][2::3][mask]
            parts += [measured, -measured - announced, [normal.min(initial=20.0), _mean(normal)]]
        if "object_velocity" in seen:
            parts += [seen["object_velocity"] / over_arm, self._drift / over_arm]
        if "joint_velocities" in seen:
            parts.append(seen["joint_velocities"])
        return np.concatenate(parts).astype(np.float32)


def _mean(values: NDArray[Any]) -> float:
    return float(values.mean()) if len(values) else 0.0
