"""Forces of high quality as a policy: of several efforts, the one that the reward asks for."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from gfo_env.conditions import FRICTION_FACTOR
from gfo_env.contacts import can_balance
from gfo_env.mdp.actions import action_of, largest_force
from gfo_env.mdp.observation import unpack
from gfo_env.mdp.reward import RewardWeights, relative_effort, saturate
from gfo_env.policy import Action, ObservationPolicy, SolverPolicy, State
from solvers import GraspForceProblem, Solver
from solvers.arrays import Array
from solvers.exact.dual_newton import solve_flat
from solvers.max_quality.preload import effort
from solvers.problem import MAX_QUALITY
from solvers.quality.directions import weakest_directions

PRELOADS = (0.0, 0.5, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
"""N: the efforts tried are those of least-norm forces with these preloads of all contacts."""

_MORE = 1.0 + 1e-9


class QualityPolicy(ObservationPolicy):
    """A solver of `max_quality` for several budgets, and of its answers what the reward pays most.

    The rewards of q_lrw and effort are known before acting, but for the object's radius: the
    farthest contact from the centre of mass stands for it. Forces keep a share of the friction, as
    with `SolverPolicy`, which answers where there are none.

    Args:
        solver: of the objective `max_quality`.
        weights: of the reward.
    """

    def __init__(self, solver: Solver, weights: RewardWeights) -> None:
        self.solver, self.weights = solver, weights
        self._otherwise = SolverPolicy("dual_newton")

    def act(self, observation: Mapping[str, Any], state: State) -> tuple[Action, State]:
        """The action, (3n,), and the state as it is: this policy has none."""
        fields = unpack(observation)
        forces = self._best(fields) if can_balance(fields["grasp_map"]) else None
        if forces is None:
            return self._otherwise.act(observation, state)
        return action_of(forces, fields["normal_max"]), state

    def _best(self, fields: dict[str, Any]) -> Array | None:
        """(3n,) N that the reward pays most for; None if there are no forces."""
        mask = fields["contact_mask"] > 0
        convex = GraspForceProblem(
            **fields
            | {
                "friction": FRICTION_FACTOR * fields["friction"],
                "contact_mask": mask,
            }
        )
        several = GraspForceProblem.stack([convex] * len(PRELOADS)).flat()
        raised = several.normal_min + np.array(PRELOADS)[:, None] * mask
        pressed = several.derived(normal_min=np.minimum(raised, several.normal_max))
        answer = solve_flat(pressed)
        rows = np.flatnonzero(answer.solved)
        if not len(rows):
            return None
        budgets = effort(answer.forces)[rows]
        problem = (
            several[rows]
            .constraints(MAX_QUALITY)
            .derived(
                effort_budget=_MORE * budgets,
                characteristic_length=np.full(len(rows), farthest_contact(fields["grasp_map"])),
                effort_weight=np.zeros(len(rows)),
            )
        )
        forces = self.solver.propose(problem).forces
        true = problem.derived(friction=np.tile(fields["friction"], (len(rows), 1)))
        most = float(largest_force(fields["normal_max"])[0])
        return forces[np.argmax(self._rewards(true, forces, most))]

    def _rewards(self, problem: GraspForceProblem, forces: Array, max_force: float) -> Array:
        """(B,) what q_lrw brings less what effort costs; -inf without forces."""
        found = np.isfinite(forces).all(axis=1)
        quality, _ = weakest_directions(problem, np.nan_to_num(forces[:, 2::3]))
        load = np.linalg.norm(problem.external_wrench[:, :3], axis=1)
        brings = [saturate(max(q, 0.0), w) for q, w in zip(quality, load, strict=True)]
        # all rows are of one grasp
        count = 3 * int(problem.contact_mask[0].sum())
        sizes = np.linalg.norm(np.nan_to_num(forces), axis=1)
        costs = relative_effort(sizes, count, max_force)
        rewards = self.weights.q_lrw * np.array(brings) - self.weights.effort * costs
        return np.where(found, rewards, -np.inf)


def farthest_contact(grasp_map: Array) -> float:
    """m: the largest distance of a contact from the centre of mass, of G (6, 3n) alone.

    The moments of a contact's three unit forces have the squared size 2 |p|^2 together.
    """
    moments = grasp_map[3:].reshape(3, -1, 3)
    return float(np.sqrt(0.5 * np.sum(moments**2, axis=(0, 2))).max())
