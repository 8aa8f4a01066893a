"""Actions that a solver makes feasible: a preload of each contact, from which forces follow."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from gfo_env.mdp.observation import Observation, unpack
from solvers.arrays import Array
from solvers.quality.directions import weakest_support

from .actions import ObservingWrapper, added_force
from .planning import Planner, moment_arm

FEATURES = 18
"""Numbers that `contact_features` has of each contact."""

_FORCE = 10.0
"""N, that forces are divided by."""

_ANCHOR = 2.0
"""N, least normal force for which the weakest directions are sought."""

_DIRECTIONS = 8


class PreloadActions(ObservingWrapper):
    """One number a contact in [-1, 1] becomes a preload, and a solver adds what the load asks for.

    The preload of the problem is raised by `actions.added_force`: by nothing at -1, by 1.25 N at 0
    and by 10 N at 1, and up to the cap at most. The solver's forces for it are commanded, which
    balance the load, lie in the planned cones and keep the torque limits; `Planner` says what
    becomes of preloads for which there are no such forces. With -1 throughout, the forces are those
    of the solver, to the bit.

    Observations have one more key, `contact_features`, (n * FEATURES,), of `contact_features`.

    Args:
        env: the environment, with its own observations and actions.
        solver: a name of `solvers.available_solvers()`.
    """

    def __init__(
        self, env: gymnasium.Env[Observation, NDArray[np.float32]], solver: str = "dual_newton"
    ) -> None:
        super().__init__(env)
        self.planner = Planner(solver)
        assert isinstance(env.observation_space, spaces.Dict)
        contacts = env.observation_space["contact_mask"].shape
        assert contacts is not None
        self.action_space = spaces.Box(-1.0, 1.0, contacts, np.float32)
        features = spaces.Box(-np.inf, np.inf, (contacts[0] * FEATURES,), np.float32)
        self._extend_space(contact_features=features)
        self._features = np.zeros(features.shape, np.float32)

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """As the environment, with the solver's forces for the preloads of the action."""
        forces = self.forces(self.checked(action))
        self._observation, reward, terminated, truncated, info = self.env.step(forces)
        # nobody acts on what follows a termination
        seen = self._kept() if terminated else self._extended()
        return seen, float(reward), terminated, truncated, info

    def forces(self, action: Array) -> NDArray[np.float32]:
        """(3n,) the environment's action for the last observation and an action (n,)."""
        preload = added_force(np.clip(action, -1.0, 1.0)) * self._observation["contact_mask"]
        return self.planner.action(self._observation, np.zeros(6), preload)

    def _extended(self) -> Observation:
        seen = self._observation
        forces = self.max_force * self.planner.policy.act(seen, None)[0]
        features = contact_features(seen, forces.astype(np.float64))
        self._features = features.astype(np.float32).reshape(-1)
        return self._kept()

    def _kept(self) -> Observation:
        return self._observation | {"contact_features": self._features}


def contact_features(observation: Observation, forces: Array) -> Array:
    """(n, FEATURES) what quality hangs on; 0 at padding.

    Along a direction of the wrench space, q_lrw asks how far the contact that reaches farthest
    reaches. So of each contact there are the normal and the tangential force that the load takes,
    over 10 N, and the eight weakest directions that are found, weakest first: how far the contact
    reaches along each with 1 N, and, the same for all contacts, how far the farthest one does as
    the reward counts it, r / (r + load). The directions are those of the forces that the load takes
    or of 2 N, whichever is more; torques are over the moment arm of the contacts.

    Args:
        observation: of the environment.
        forces: (3n,) N, the solver's.
    """
    fields = unpack(observation)
    mask: Array = fields["contact_mask"]
    friction, arm = fields["friction"], moment_arm(observation)
    each = forces.reshape(-1, 3)
    normal = np.maximum(each[:, 2], _ANCHOR) * mask
    _, weakest = weakest_support(fields["grasp_map"], friction, normal, arm)
    scaled = fields["grasp_map"] / np.repeat([1.0, arm], 3)[:, None]
    along = (weakest @ scaled).reshape(_DIRECTIONS, len(mask), 3)
    reach = along[..., 2] + friction * np.linalg.norm(along[..., :2], axis=-1)
    farthest = np.max(reach * normal, axis=1, initial=0.0)
    order = np.argsort(farthest, kind="stable")
    counted = farthest / (farthest + np.linalg.norm(fields["external_wrench"][:3]) + 1e-9)
    own = np.stack([each[:, 2], np.linalg.norm(each[:, :2], axis=1)], 1) / _FORCE
    shared = np.broadcast_to(counted[order], (len(mask), _DIRECTIONS))
    return np.concatenate([own, reach[order].T, shared], axis=1) * mask[:, None]
