"""A solver's forces for the observed problem with its load changed and its preload raised."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gfo_env.contacts import can_balance
from gfo_env.mdp.actions import action_of
from gfo_env.mdp.arguments import number
from gfo_env.mdp.observation import unpack
from gfo_env.policy import Action, ObservationPolicy, SolverPolicy, State
from solvers import GraspForceProblem, Solver, Status
from solvers.arrays import Array
from solvers.problem import CORE_NDIM

_SHARES = np.array([1.0, 0.5, 0.25])
"""Of a change, tried in turn until forces exist."""


class Planner:
    """Forces for a load that is not the observed one, balanced and in the cones all the same.

    Args:
        solver: a name of `solvers.available_solvers()`, or any `Solver`.
    """

    def __init__(self, solver: str | Solver) -> None:
        self.policy = SolverPolicy(solver)

    def action(
        self, observation: Mapping[str, Any], wrench: Array, preload: float | Array
    ) -> NDArray[np.float32]:
        """The action for the observed problem after a change.

        No change is the answer of `SolverPolicy`, to the bit. A change for which no forces exist is
        halved, twice at most, and then left out.

        Args:
            observation: of the environment.
            wrench: (6,) N, N·m, object frame: added to the load.
            preload: N >= 0, added to that of every contact; (n,) if each has its own, 0 at padding.

        Returns:
            (3n,) in [-1, 1].
        """
        fields = unpack(observation)
        if (wrench.any() or np.any(preload > 0)) and can_balance(fields["grasp_map"]):
            forces = self._changed(fields, wrench, preload)
            if forces is not None:
                return action_of(forces, fields["normal_max"])
        return self.policy.act(observation, None)[0]

    def _changed(
        self, fields: dict[str, Any], wrench: Array, preload: float | Array
    ) -> Array | None:
        """(3n,) N for the largest share of the change for which the solver finds forces."""
        raised = fields["normal_min"] + preload * _SHARES[:, None] * fields["contact_mask"]
        changed = fields | {
            "friction": self.policy.friction_factor * fields["friction"],
            "external_wrench": fields["external_wrench"] + _SHARES[:, None] * wrench,
            "normal_min": np.minimum(raised, fields["normal_max"]),
            "contact_mask": fields["contact_mask"] > 0,
        }
        # an environment's observations are valid: checking them again and again would take longer
        # than solving
        whole = {
            name: np.broadcast_to(values, (len(_SHARES), *values.shape[-CORE_NDIM[name] :]))
            for name, values in changed.items()
        }
        solution = self.policy.solver.solve(GraspForceProblem.unchecked(whole))
        answered = np.isfinite(solution.forces).all(axis=-1)
        answered &= solution.status != Status.INFEASIBLE.value
        forces: Array = solution.forces
        return forces[np.argmax(answered)] if answered.any() else None


class PreloadPolicy(ObservationPolicy):
    """A solver's forces with the preload raised: what more effort alone is worth.

    Args:
        solver: that answers the changed problem.
        preload: N >= 0, added to the observed preload.

    Raises:
        EnvironmentSettingsError: the preload is no such number.
    """

    def __init__(self, solver: str | Solver, preload: float) -> None:
        self.planner = Planner(solver)
        self.preload = number("preload", preload, zero=True)

    def act(self, observation: Mapping[str, Any], state: State) -> tuple[Action, State]:
        """The action for the changed problem, and the state of `change`."""
        change, state = self.change(observation, state)
        return self.planner.action(observation, change, self.preload), state

    def change(self, observation: Mapping[str, Any], state: State) -> tuple[Array, State]:
        """What is added to the load, (6,) N, N·m, and the state; see `predict`."""
        return np.zeros(6), state


def measured_wrench(observation: Mapping[str, Any]) -> Array:
    """(6,) N, N·m, object frame: what the measured contact forces do to the object."""
    grasp_map = unpack(observation)["grasp_map"]
    return np.asarray(grasp_map @ np.asarray(observation["contact_forces"], dtype=np.float64))


def moment_arm(observation: Mapping[str, Any]) -> float:
    """m: root mean square moment arm of the contacts; 1 without any."""
    grasp_map = unpack(observation)["grasp_map"]
    force, torque = np.linalg.norm(grasp_map[:3]), np.linalg.norm(grasp_map[3:])
    return float(torque / force) if torque > 0 else 1.0
