"""A hand-made policy that feels the load: what learned reactions have to beat."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from gfo_env.conditions import STANDARD_GRAVITY
from gfo_env.mdp.arguments import number, require
from gfo_env.mdp.episode import CONTROL_PERIOD
from gfo_env.policy import State
from solvers import Solver
from solvers.arrays import Array

from .planning import PreloadPolicy, measured_wrench, moment_arm

_START = np.zeros(6)


class ReactivePolicy(PreloadPolicy):
    """A solver's forces for the load that the hand feels, in place of the one it was told of.

    The contacts push the object with G f; what accelerates it otherwise is the load: m a - G f. The
    estimate is smoothed over commands, and two parts are added to it, as if the object hung in its
    first pose from springs and dampers: one for how far its velocity has carried it, one for the
    velocity itself. Where observations hold no contact forces, the load is the announced one.

    Args:
        solver: that answers the changed problem.
        preload: N >= 0, added to the observed preload.
        smoothing: share of the last estimate that is kept, in [0, 1).
        stiffness: N/m, of the spring; its torque is that of a force at the moment arm.
        damping: N per m/s, likewise.
        largest: N, longest change of the load.

    Raises:
        EnvironmentSettingsError: an argument is no such number.
    """

    def __init__(
        self,
        solver: str | Solver = "dual_newton",
        *,
        preload: float = 0.0,
        smoothing: float = 0.5,
        stiffness: float = 100.0,
        damping: float = 10.0,
        largest: float = 6.0,
    ) -> None:
        super().__init__(solver, preload)
        self.smoothing = number("smoothing", smoothing, zero=True)
        require(smoothing < 1.0, "smoothing must be below 1", smoothing)
        self.stiffness = number("stiffness", stiffness, zero=True)
        self.damping = number("damping", damping, zero=True)
        self.largest = number("largest", largest, zero=True)

    def change(self, observation: Mapping[str, Any], state: State) -> tuple[Array, State]:
        """What is added to the load, (6,) N, N·m, and the state; see `predict`."""
        if "contact_forces" not in observation:
            return _START, None
        velocity = np.asarray(observation["object_velocity"], dtype=np.float64)
        if state is None:
            # the contact forces are still those of the closing hand
            return _START, (_START, velocity, _START)
        felt, before, drift = state
        felt = self.smoothing * felt + (1.0 - self.smoothing) * _felt(
            observation, (velocity - before) / CONTROL_PERIOD
        )
        drift = drift + CONTROL_PERIOD * velocity
        lengths = np.repeat([1.0, moment_arm(observation)], 3)
        change = felt + (self.stiffness * drift + self.damping * velocity) * lengths**2
        size = float(np.linalg.norm(change / lengths))
        change *= min(1.0, self.largest / size) if size > 0 else 1.0
        return change, (felt, velocity, drift)


def _felt(observation: Mapping[str, Any], acceleration: Array) -> Array:
    """(6,) N, N·m: the load beyond the announced weight that measured forces tell of."""
    announced = np.asarray(observation["external_wrench"], dtype=np.float64)
    mass = float(np.linalg.norm(announced[:3])) / STANDARD_GRAVITY
    felt = -measured_wrench(observation) - announced
    felt[:3] += mass * acceleration[:3]
    return felt
