"""The simulated world: objects, a hand, grasps, their quality, and the environment `GraspForce-v0`.

Importing this package registers the environments and starts no simulator: PyBullet comes with
`gymnasium.make("GraspForce-v0")`. The variants are the same environment with other defaults:

| id                         | is                                                             |
| -------------------------- | -------------------------------------------------------------- |
| GraspForce-v0              | random objects, loads announced, physics simulated             |
| GraspForceUnannounced-v0   | the agent is not told of loads but feels its hand              |
| GraspForceStatic-v0        | one-step episodes judged by statics, without a simulator       |
| GraspForceFingertips-v0    | grasps that touch with fingertips alone                        |
| GraspForceFixedObject-v0   | grasps of one object                                           |

Modules that have moved to a room are still found where they were, with a `DeprecationWarning`.
"""

import sys
import warnings
from collections.abc import Sequence
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

_MOVED = {
    "gfo_env.acquisition": "gfo_env.grasps.acquisition",
    "gfo_env.closure": "gfo_env.contacts",
    "gfo_env.grasp_problem": "gfo_env.grasps.problem",
    "gfo_env.grasp_source": "gfo_env.grasps.source",
    "gfo_env.loads": "gfo_env.mdp.loads",
    "gfo_env.meshes": "gfo_env.objects.meshes",
    "gfo_env.observation": "gfo_env.mdp.observation",
    "gfo_env.patches": "gfo_env.objects",
    "gfo_env.posture": "gfo_env.hand.posture",
    "gfo_env.quality": "gfo_env.contacts",
    "gfo_env.rendering": "gfo_env.simulation.rendering",
    "gfo_env.reward": "gfo_env.mdp.reward",
    "gfo_env.surface": "gfo_env.contacts.surface",
}
"""Names before the rooms, and where what they held is now."""


class _Moved(MetaPathFinder, Loader):
    """Finds modules by the names that they had; each hands on to where it is now."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        return ModuleSpec(fullname, self) if fullname in _MOVED else None

    def exec_module(self, module: ModuleType) -> None:
        place = _MOVED[module.__name__]
        warnings.warn(f"{module.__name__} is now {place}", DeprecationWarning, stacklevel=2)
        module.__dict__["__getattr__"] = lambda name: getattr(import_module(place), name)


sys.meta_path.append(_Moved())

try:
    from gymnasium.envs.registration import register
except ModuleNotFoundError as error:
    # A training node has no Gymnasium and needs none: it reads modules of this package that work
    # without it, and there is nothing to register the environment with.
    if error.name != "gymnasium":
        raise
else:
    _VARIANTS: dict[str, dict[str, object]] = {
        "GraspForce-v0": {},
        "GraspForceUnannounced-v0": {"announced": False},
        "GraspForceStatic-v0": {"mode": "static"},
        "GraspForceFingertips-v0": {"contacts": "fingertips"},
        "GraspForceFixedObject-v0": {"split": "test", "object_ids": ("010",)},
    }
    for _name, _defaults in _VARIANTS.items():
        # no max_episode_steps: the environment knows its horizon, and says at its end who succeeded
        register(id=_name, entry_point="gfo_env.env:GraspForceEnv", kwargs=_defaults)
