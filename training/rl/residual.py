"""Residual policies: a solver's forces for the observed problem, and an agent that corrects them.

A correction of zero is the solver, to the bit.
"""

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from gfo_env.mdp.observation import Observation, unpack
from gfo_env.policy import SolverPolicy
from solvers.arrays import Array

from .actions import ObservingWrapper
from .planning import Planner, moment_arm
from .reactive import ReactivePolicy

Environment = gymnasium.Env[Observation, NDArray[np.float32]]
Step = tuple[Observation, float, bool, bool, dict[str, Any]]

CORRECTION_FORCE = 3.0
"""N: the load changes by this for each 1 of an action, and forces by it."""

CORRECTION_PRELOAD = 4.0
"""N: the preload rises by this for 1."""


class _Residual(ObservingWrapper):
    """Corrects the forces of a solver, and adds keys to the observation."""

    def step(self, action: NDArray[np.float32]) -> Step:
        """As the environment, with the corrected forces."""
        correction = np.clip(self.checked(action), -1.0, 1.0)
        forces = self.corrected(correction)
        grasp_map = unpack(self._observation)["grasp_map"]
        commanded = self.max_force * grasp_map @ forces.astype(np.float64)
        self._observation, reward, terminated, truncated, info = self.env.step(forces)
        return self._extended((correction, commanded)), float(reward), terminated, truncated, info

    def corrected(self, correction: Array) -> NDArray[np.float32]:
        """(3n,) the environment's action."""
        raise NotImplementedError

    def _extended(self, last: tuple[Array, Array] | None = None) -> Observation:
        """The observation with what the wrapper adds.

        Args:
            last: correction and commanded wrench of the step before; None after a reset.
        """
        raise NotImplementedError


class ResidualWrench(_Residual):
    """An action of seven numbers: a change of the load that the solver answers, and more preload.

    | Num | Action                            | Min | Max | Unit                              |
    | --- | --------------------------------- | --- | --- | --------------------------------- |
    | 0-2 | force added to the load           | -1  | 1   | `CORRECTION_FORCE` [N]            |
    | 3-5 | torque added to the load          | -1  | 1   | the same times the moment arm     |
    | 6   | preload added, if positive        | -1  | 1   | `CORRECTION_PRELOAD` [N]          |

    Whatever the action, the forces balance a load, lie in the cones and keep the torque limits, as
    long as such forces exist; otherwise the change is shortened. It may be added to that of a
    `ReactivePolicy`, whose forces are then those of a zero action. Observations have two more keys:
    `correction`, the last action, and `commanded_wrench`, (6,) N, N·m: G f of the last command.

    Args:
        env: the environment, perhaps wrapped, with its own observations and actions.
        solver: a name of `solvers.available_solvers()`.
        reactive: add the change to that of a reactive policy with this solver.
    """

    def __init__(
        self, env: Environment, solver: str = "dual_newton", *, reactive: bool = False
    ) -> None:
        super().__init__(env)
        self.planner = Planner(solver)
        self._reactive = ReactivePolicy(solver) if reactive else None
        self._felt: tuple[tuple[NDArray[Any], ...] | None, Array] = (None, np.zeros(6))
        self.action_space = spaces.Box(-1.0, 1.0, (7,), np.float32)
        self._extend_space(
            correction=spaces.Box(-1.0, 1.0, (7,), np.float32),
            commanded_wrench=spaces.Box(-np.inf, np.inf, (6,), np.float32),
        )

    def corrected(self, correction: Array) -> NDArray[np.float32]:
        """(3n,) the environment's action for a correction, (7,)."""
        lengths = np.repeat([1.0, moment_arm(self._observation)], 3)
        wrench = CORRECTION_FORCE * lengths * correction[:6] + self._felt[1]
        preload = CORRECTION_PRELOAD * max(0.0, float(correction[6]))
        return self.planner.action(self._observation, wrench, preload)

    def _extended(self, last: tuple[Array, Array] | None = None) -> Observation:
        if self._reactive is not None:
            state = None if last is None else self._felt[0]
            change, state = self._reactive.change(self._observation, state)
            self._felt = state, change
        correction, commanded = last or (np.zeros(7), np.zeros(6))
        return self._observation | {
            "correction": correction.astype(np.float32),
            "commanded_wrench": commanded.astype(np.float32),
        }


class ResidualForces(_Residual):
    """An action of three numbers a contact: added to the solver's forces, in `CORRECTION_FORCE`.

    Nothing keeps these forces balanced or in the cones. Observations have one more key:
    `solver_action`, the environment's action that the solver would take.

    Args:
        env: the environment, perhaps wrapped, with its own observations and actions.
        solver: a name of `solvers.available_solvers()`.
    """

    def __init__(self, env: Environment, solver: str = "dual_newton") -> None:
        super().__init__(env)
        self.policy = SolverPolicy(solver)
        assert env.action_space.shape is not None
        self.action_space = spaces.Box(-1.0, 1.0, env.action_space.shape, np.float32)
        self._extend_space(solver_action=spaces.Box(-1.0, 1.0, env.action_space.shape, np.float32))
        self._base = np.zeros(env.action_space.shape, np.float32)

    def corrected(self, correction: Array) -> NDArray[np.float32]:
        """(3n,) the environment's action for a correction, (3n,)."""
        mask = np.repeat(self._observation["contact_mask"], 3)
        added = CORRECTION_FORCE / self.max_force * correction * mask
        return np.clip(self._base + added, -1.0, 1.0).astype(np.float32)

    def _extended(self, last: tuple[Array, Array] | None = None) -> Observation:
        self._base = self.policy.act(self._observation, None)[0]
        return self._observation | {"solver_action": self._base}
