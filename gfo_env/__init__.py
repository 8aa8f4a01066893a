"""The simulated world: objects, a hand, grasps, their quality, and the environment `GraspForce-v0`.

Importing this package registers the environment and starts no simulator: PyBullet comes with
`gymnasium.make("GraspForce-v0")`.
"""

try:
    from gymnasium.envs.registration import register
except ModuleNotFoundError as error:
    # A training node has no Gymnasium and needs none: it reads modules of this package that work
    # without it, and there is nothing to register the environment with.
    if error.name != "gymnasium":
        raise
else:
    # no max_episode_steps: the environment knows its horizon, and says at its end who succeeded
    register(id="GraspForce-v0", entry_point="gfo_env.env:GraspForceEnv")
