"""What a residual agent needs to know of an observation: a few vectors instead of matrices."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from gfo_env.mdp.episode import CONTROL_PERIOD
from gfo_env.mdp.observation import Observation

from .planning import measured_wrench, moment_arm

Features = dict[str, NDArray[np.float32]]
Action = NDArray[np.float32]


class LoadFeatures(gymnasium.Wrapper[Any, Action, Any, Action]):
    """Observations of `ResidualWrench` as vectors and scalars, in N, m and s.

    `vectors`, (k, 6), are in the object frame like the correction, torques over the moment arm:
    announced load, last correction, wrench commanded last and, where the environment tells of them,
    wrench of the measured contact forces, what it lacks for balancing the announced load, velocity
    of the object, how far that has carried it since the reset.

    `scalars`, (m,): friction, number of contacts, preload, last correction of the preload; where
    the environment tells of them, least and mean measured normal force, velocities of the joints.
    """

    def __init__(self, env: gymnasium.Env[Any, Action]) -> None:
        super().__init__(env)
        inner = env.observation_space
        assert isinstance(inner, spaces.Dict)
        self._drift = np.zeros(6)
        blank = {name: np.zeros_like(box.sample()) for name, box in inner.spaces.items()}
        self.observation_space = spaces.Dict(
            {
                name: spaces.Box(-np.inf, np.inf, array.shape, np.float32)
                for name, array in self._features(blank).items()
            }
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Features, dict[str, Any]]:
        """As the environment."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._drift = np.zeros(6)
        return self._features(observation), info

    def step(self, action: Action) -> tuple[Features, float, bool, bool, dict[str, Any]]:
        """As the environment."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        if "object_velocity" in observation:
            self._drift = self._drift + CONTROL_PERIOD * observation["object_velocity"]
        return self._features(observation), float(reward), terminated, truncated, info

    def _features(self, seen: Observation) -> Features:
        lengths = np.repeat([1.0, moment_arm(seen)], 3)
        mask = seen["contact_mask"] > 0
        announced = seen["external_wrench"] / lengths
        vectors: list[Any] = [announced, seen["correction"][:6], seen["commanded_wrench"] / lengths]
        scalars: list[Any] = [
            [_mean(seen["friction"][mask]), mask.sum(), _mean(seen["normal_min"][mask])],
            seen["correction"][6:],
        ]
        if "contact_forces" in seen:
            measured = measured_wrench(seen) / lengths
            normal = seen["contact_forces"][2::3][mask]
            vectors += [measured, -measured - announced]
            scalars.append([normal.min(initial=20.0), _mean(normal)])
        if "object_velocity" in seen:
            vectors += [seen["object_velocity"] * lengths, self._drift * lengths]
        if "joint_velocities" in seen:
            scalars.append(seen["joint_velocities"])
        return {
            "vectors": np.array(vectors, dtype=np.float32),
            "scalars": np.concatenate(scalars).astype(np.float32),
        }


def _mean(values: NDArray[Any]) -> float:
    return float(values.mean()) if len(values) else 0.0
