"""Any force solver as a policy: `SolverPolicy("clarabel").predict(observation)`, as in SB3."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gfo_env.checks import is_number
from gfo_env.conditions import FRICTION_FACTOR
from gfo_env.contacts import can_balance
from gfo_env.exceptions import ObservationError
from gfo_env.mdp.actions import action_of
from gfo_env.mdp.arguments import require
from gfo_env.mdp.observation import checked_batch, unpack
from solvers import GraspForceProblem, Solver, Status, make_solver
from solvers.arrays import Array

Action = NDArray[np.float32]
State = tuple[Any, ...] | None
"""What a policy knows of an episode from the steps before; of a batch, one for each observation."""


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
        """The action for one observation, or those for a batch of them, as vectors give them.

        Args:
            observation: of the environment; a batch has one more dimension in front.
            state: what the last call of the episode returned; None at its beginning.
            episode_start: a new episode, whatever the state; (batch,) for a batch.
            deterministic: ignored: nothing is drawn at random.

        Returns:
            (3n,) or (batch, 3n) float32 in [-1, 1], and the state.

        Raises:
            ObservationError: keys, shapes or numbers that no observation of the environment has,
                or a state or starts of another number of them.
        """
        batch = checked_batch(observation)
        if batch is None:
            started = episode_start is not None and bool(np.any(episode_start))
            return self.act(observation, None if started else state)
        states = (None,) * batch if state is None else state
        starts = np.zeros(batch) if episode_start is None else np.asarray(episode_start)
        if not len(states) == batch == starts.size:
            raise ObservationError(
                f"A batch of {batch} observations has as many states and starts, not "
                f"{len(states)} and {starts.size}."
            )
        known = [
            None if start else one for one, start in zip(states, starts.reshape(-1), strict=True)
        ]
        actions, states = self.act_on_batch(observation, known)
        return actions, None if all(one is None for one in states) else states

    @abstractmethod
    def act(self, observation: Mapping[str, Any], state: State) -> tuple[Action, State]:
        """The action, (3n,) float32 in [-1, 1], and the state, None as it is at the beginning.

        For loops that have the observation from the environment: nothing is checked.
        """

    def act_on_batch(
        self, observation: Mapping[str, Any], states: Sequence[State]
    ) -> tuple[Action, tuple[State, ...]]:
        """`act` for each of a batch: (batch, 3n), and a state of each."""
        actions = np.zeros((len(states), 3 * np.shape(observation["friction"])[-1]), np.float32)
        after: list[State] = []
        for index, state in enumerate(states):
            one = {name: values[index] for name, values in observation.items()}
            actions[index], then = self.act(one, state)
            after.append(then)
        return actions, tuple(after)


class SolverPolicy(ObservationPolicy):
    """Answers every observation of `GraspForce-v0` with the forces that a solver finds.

    What an action of 1 commands, the environment's `max_force`, is read in the observation: it is
    the cap of every contact. A batch is solved at once.

    Where no forces exist with this share of the friction, it plans with all of it. Where the solver
    has no forces then, because the contacts cannot balance every load, no force exists or it gave
    up without one, all contacts press along their normals, halfway between preload and cap: a firm
    grip that knows nothing of the load. Forces that the solver could not make feasible are used as
    they are; those of the naive solvers never are.

    Args:
        solver: a name of `solvers.available_solvers()`, or any `Solver`.
        friction_factor: the solver plans with this share of the observed friction, above 0 and at
            most 1.

    Raises:
        UnknownSolverError, MissingDependencyError: as `solvers.make_solver`.
        EnvironmentSettingsError: an argument is something else.
    """

    def __init__(self, solver: str | Solver, *, friction_factor: float = FRICTION_FACTOR) -> None:
        fits = isinstance(solver, str) or callable(getattr(solver, "solve", None))
        require(fits, "solver must be the name of one, or have a method solve(problem)", solver)
        require(
            is_number(friction_factor) and 0.0 < friction_factor <= 1.0,
            "friction_factor must be a number above 0 and at most 1",
            friction_factor,
        )
        self.solver = make_solver(solver) if isinstance(solver, str) else solver
        self.friction_factor = float(friction_factor)

    def act(self, observation: Mapping[str, Any], state: State) -> tuple[Action, State]:
        """The action, (3n,), and the state as it is: this policy has none."""
        fields = {name: values[None] for name, values in unpack(observation).items()}
        return self._actions(fields)[0], state

    def act_on_batch(
        self, observation: Mapping[str, Any], states: Sequence[State]
    ) -> tuple[Action, tuple[State, ...]]:
        """(batch, 3n) the actions, and the states as they are."""
        return self._actions(unpack(observation)), tuple(states)

    def _actions(self, fields: dict[str, Any]) -> Action:
        """(batch, 3n)."""
        return action_of(self._forces(fields), fields["normal_max"])

    def _forces(self, fields: dict[str, Any]) -> Array:
        """(batch, 3n) N."""
        batch, contacts = fields["friction"].shape
        grip = np.zeros((batch, contacts, 3))
        grip[..., 2] = fields["contact_mask"] * (fields["normal_min"] + fields["normal_max"]) / 2.0
        forces = grip.reshape(batch, 3 * contacts)
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
