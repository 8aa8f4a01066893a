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
"""

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
