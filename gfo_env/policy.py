"""Any force solver as a policy: `SolverPolicy("clarabel").predict(observation)`, as in SB3."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gfo_env.conditions import FRICTION_FACTOR
from gfo_env.contacts import can_balance
from gfo_env.mdp.observation import unpack
from solvers import GraspForceProblem, Solver, Status, make_solver
from solvers.arrays import Array

Action = NDArray[np.float32]
State = tuple[NDArray[Any], ...] | None


class ObservationPolicy(ABC):
    """What acts on observations of the environment by itself, without any training.

    It has the `predict` of Stable-Baselines3 policies, so that what evaluates those evaluates this.
    """

    def predict(
        self,
        observation: Mapping[str, Any],
        state: State = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[Action, State]:
        """The action for one observation.

        Args:
            observation: of the environment.
            state: what the last call of the episode returned; None at its beginning.
            episode_start: a new episode, whatever the state.
            deterministic: ignored: nothing is drawn at random.

        Returns:
            (3n,) float32 in [-1, 1], and the state.
        """
        started = episode_start is not None and bool(np.any(episode_start))
        return self.act(observation, None if started else state)

    @abstractmethod
    def act(self, observation: Mapping[str, Any], state: State) -> tuple[Action, State]:
        """The action, (3n,) float32 in [-1, 1], and the state, None as it is at the beginning."""


class SolverPolicy(ObservationPolicy):
    """Answers every observation of `GraspForce-v0` with the forces that a solver finds.

    `predict` takes a batch of observations along the first dimension, too.

    Where no forces exist with this share of the friction, it plans with all of it. Where the solver
    has no forces then, because the contacts cannot balance every load, no force exists or it gave
    up without one, all contacts press along their normals, halfway between preload and cap: a firm
    grip that knows nothing of the load. Forces that the solver could not make feasible are used as
    they are; those of the naive solvers never are.

    Args:
        solver: a name of `solvers.available_solvers()`, or any `Solver`.
        max_force: N, what an action of 1 commands in the environment.
        friction_factor: the solver plans with this share of the observed friction.

    Raises:
        UnknownSolverError, MissingDependencyError: as `solvers.make_solver`.
    """

    def __init__(
        self,
        solver: str | Solver,
        *,
        max_force: float = 20.0,
        friction_factor: float = FRICTION_FACTOR,
    ) -> None:
        self.solver = make_solver(solver) if isinstance(solver, str) else solver
        self.max_force = max_force
        self.friction_factor = friction_factor

    def act(self, observation: Mapping[str, Any], state: State) -> tuple[Action, State]:
        """The action, (3n,) or (batch, 3n), and the state as it is: this policy has none."""
        fields = unpack(observation)
        single = fields["friction"].ndim == 1
        if single:
            fields = {name: values[None] for name, values in fields.items()}
        forces = self._forces(fields)
        actions = np.clip(forces / self.max_force, -1.0, 1.0).astype(np.float32)
        return (actions[0] if single else actions), state

    def _forces(self, fields: dict[str, Any]) -> Array:
        """(batch, 3n) N."""
        grip = np.zeros((*fields["friction"].shape, 3))
        grip[..., 2] = fields["contact_mask"] * (fields["normal_min"] + fields["normal_max"]) / 2.0
        forces = grip.reshape(len(grip), -1)
        unanswered = np.flatnonzero(can_balance(fields["grasp_map"]))
        for factor in (self.friction_factor, 1.0):
            if len(unanswered):
                chosen = {name: values[unanswered] for name, values in fields.items()}
                chosen["friction"] = factor * chosen["friction"]
                solution = self.solver.solve(GraspForceProblem(**chosen))
                answered = np.isfinite(solution.forces).all(axis=-1)
                answered &= solution.status != Status.INFEASIBLE.value
                forces[unanswered[answered]] = solution.forces[answered]
                unanswered = unanswered[~answered]
        return forces
