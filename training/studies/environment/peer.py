"""panda-gym's PandaPickAndPlace-v3 beside this environment: the same clock, its own interpreter."""

import json
import subprocess
from dataclasses import dataclass
from pathlib import Path

from .plan import EnvSpeedError

PEER = "PandaPickAndPlace-v3"

# It runs where this project is not installed. Actions are drawn beforehand.
_SCRIPT = """
import json, sys, time
import gymnasium, numpy, panda_gym

seconds, seed = float(sys.argv[1]), int(sys.argv[2])
env = gymnasium.make("PandaPickAndPlace-v3").unwrapped
env.action_space.seed(seed)
actions = [env.action_space.sample() for _ in range(500)]
env.reset(seed=seed)
steps, spent, resets = 0, 0.0, []
while spent < seconds or steps == 0:
    begin = time.perf_counter()
    env.reset()
    loaded = time.perf_counter()
    resets.append(loaded - begin)
    for k in range(50):
        env.step(actions[(steps + k) % 500])
    spent += time.perf_counter() - loaded
    steps += 50

bullet, physics = env.sim.physics_client, 0.0
for k in range(200):
    env.robot.set_action(actions[k])
    begin = time.perf_counter()
    for _ in range(env.sim.n_substeps):
        bullet.stepSimulation()
    physics += time.perf_counter() - begin
print(json.dumps({
    "steps_per_second": steps / spent,
    "physics_steps_per_second": 200 / physics,
    "reset_ms": 1e3 * sorted(resets)[len(resets) // 2],
    "substeps": env.sim.n_substeps,
    "time_step": env.sim.timestep,
    "version": panda_gym.__version__,
    "numpy": numpy.__version__,
}))
"""


@dataclass(frozen=True)
class PeerTimes:
    """What panda-gym does.

    Args:
        steps_per_second: of control, resets left out.
        physics_steps_per_second: of control with the physics alone.
        reset_ms: median.
        substeps: simulation steps of a control step.
        time_step: s, of the simulation.
        version: of panda-gym.
        numpy: its version.
    """

    steps_per_second: float
    physics_steps_per_second: float
    reset_ms: float
    substeps: int
    time_step: float
    version: str
    numpy: str


def check_peer(python: Path) -> None:
    """Find out before the work whether an interpreter has panda-gym.

    Raises:
        EnvSpeedError: it has not, or there is no such interpreter.
    """
    _run(python, "import panda_gym")


def measure_peer(python: Path, seconds: float, seed: int) -> PeerTimes:
    """Let panda-gym play for some seconds.

    Raises:
        EnvSpeedError: it failed.
    """
    return PeerTimes(**json.loads(_run(python, _SCRIPT, str(seconds), str(seed))))


def _run(python: Path, code: str, *arguments: str) -> str:
    """The last line that some code prints, empty if there is none."""
    try:
        done = subprocess.run(
            [str(python), "-c", code, *arguments], capture_output=True, text=True, check=False
        )
    except OSError as error:
        raise EnvSpeedError(f"{python} is no Python to run panda-gym with: {error}") from error
    if done.returncode:
        reason = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise EnvSpeedError(f"panda-gym does not run with {python}: {reason}")
    return (done.stdout.strip().splitlines() or [""])[-1]
