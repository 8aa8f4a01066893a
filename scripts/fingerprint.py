"""Print a fingerprint of what the project computes, a line for each part of it.

Two versions of the code that print the same lines give the same answers to the bit: run it before
and after a refactoring, on one machine, and compare with `diff`. Everything is made anew, in about
ten minutes: answers of every solver to random problems, a collection of grasps, episodes of every
registered environment, and short trainings of both networks and of an agent.

Example: python scripts/fingerprint.py > before.txt
"""

import dataclasses
import hashlib
import os
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scripts._cli import run_cli, write_json

if TYPE_CHECKING:
    import numpy as np

    from gfo_env.grasps import GraspTable

GRASPS = 200
EPISODES = 5

SLOW = ("lmi", "kkt_ode", "instance_network", "quality_search")
"""Solvers that take seconds a problem."""


@dataclass(frozen=True)
class FingerprintSettings:
    """Print a hash of the answers of every solver, of grasps, episodes and short trainings."""

    seed: int = 0
    """Seed of grasps, problems, episodes and trainings."""
    json: Path | None = None
    """Write the hashes by name here."""


def main(settings: FingerprintSettings) -> None:
    """Compute, and print each line as soon as it is known."""
    hashes = {}
    with tempfile.TemporaryDirectory() as folder:
        # grasps of another version of the code must not be taken for this one's
        os.environ["XDG_CACHE_HOME"] = folder
        for name, arrays in fingerprints(Path(folder), settings.seed):
            hashes[name] = digest(arrays)
            print(f"{hashes[name]}  {name}", flush=True)
    write_json(settings.json, hashes)


def digest(arrays: "Iterable[np.ndarray]") -> str:
    """Sixteen hexadecimal digits of shapes, types and bytes."""
    import numpy as np

    state = hashlib.sha256()
    for array in arrays:
        state.update(f"{array.shape} {array.dtype.str}".encode())
        state.update(np.ascontiguousarray(array).tobytes())
    return state.hexdigest()[:16]


def fingerprints(folder: Path, seed: int) -> "Iterator[tuple[str, Iterable[np.ndarray]]]":
    """Names of what is computed, and its arrays."""
    from gfo_env.grasps.collection import CollectionPlan, collect
    from gfo_env.objects import ObjectSet

    path = folder / "grasps.npz"
    plan = CollectionPlan(ObjectSet("random_urdfs", "train"), GRASPS, seed=seed)
    grasps, _ = collect(plan, workers=os.cpu_count() or 1, output=path)
    yield "grasps", arrays_of(grasps)
    yield from _answers(grasps, seed)
    yield from _episodes(seed)
    yield from _trainings(path, folder, seed)


def arrays_of(value: Any) -> "Iterator[np.ndarray]":
    """Everything in a dataclass or dictionary that is a number, a text, or an array of them."""
    import numpy as np

    if dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            yield from arrays_of(getattr(value, field.name))
    elif isinstance(value, dict):
        for key in sorted(value):
            yield from arrays_of(value[key])
    elif isinstance(value, tuple | list):
        for item in value:
            yield from arrays_of(item)
    elif value is not None:
        yield np.asarray(value)


# -- solvers ---------------------------------------------------------------------------------------


def _answers(grasps: "GraspTable", seed: int) -> "Iterator[tuple[str, Iterable[np.ndarray]]]":
    import numpy as np

    from solvers import available_solvers, make_solver
    from solvers.problem import MAX_QUALITY, OBJECTIVES
    from training.problems.quality_sampling import sample_quality_problems
    from training.problems.sampling import SamplingSettings, sample_problems

    rng = np.random.default_rng(seed)
    convex = sample_problems(grasps, rng, SamplingSettings(hard=0.5))
    quality = sample_quality_problems(grasps, rng)
    for name in available_solvers():
        solver = make_solver(name)
        for objective in (*OBJECTIVES, MAX_QUALITY):
            if objective not in solver.objectives:
                continue
            problem = quality if objective == MAX_QUALITY else convex.constraints(objective)
            solution = solver.solve(problem[:4] if name in SLOW else problem)
            answer = [
                solution.forces,
                solution.status,
                solution.objective,
                solution.dual_bound,
                solution.gap,
                solution.equilibrium_dual,
                solution.torque_dual,
            ]
            yield f"{name}, {objective}", answer


# -- the world -------------------------------------------------------------------------------------


def _episodes(seed: int) -> "Iterator[tuple[str, Iterable[np.ndarray]]]":
    import gymnasium

    names = [name for name in gymnasium.registry if name.startswith("GraspForce")]
    for name in sorted(names):
        yield f"{EPISODES} episodes of {name}", _transitions(name, seed)


def _transitions(name: str, seed: int) -> "Iterator[np.ndarray]":
    """What random actions give."""
    import gymnasium

    env = gymnasium.make(name)
    env.action_space.seed(seed)
    for episode in range(EPISODES):
        yield from arrays_of(list(env.reset(seed=seed + episode)))
        over = False
        while not over:
            *seen, terminated, truncated, info = env.step(env.action_space.sample())
            over = terminated or truncated
            yield from arrays_of([*seen, terminated, truncated, info])
    env.close()


# -- learning --------------------------------------------------------------------------------------


def _trainings(
    grasps: Path, folder: Path, seed: int
) -> "Iterator[tuple[str, Iterable[np.ndarray]]]":
    from safetensors.numpy import load_file
    from stable_baselines3 import PPO

    from training.networks.conditioned import train
    from training.networks.quality import train_quality
    from training.networks.quality_settings import QualityTrainingSettings
    from training.networks.settings import TrainingSettings
    from training.rl.settings import RlSettings
    from training.rl.trainer import train_rl

    short: Any = {"grasps": grasps, "seed": seed, "batch": 64, "warmup": 2, "validate_every": 10}
    conditioned = train(TrainingSettings(output=folder / "conditioned", steps=20, **short))
    yield "training of the conditioned network", arrays_of(load_file(conditioned.weights))
    quality = train_quality(QualityTrainingSettings(output=folder / "quality", steps=10, **short))
    yield "training of the network for quality", arrays_of(load_file(quality.weights))
    agent = train_rl(
        RlSettings(
            output=folder / "agent",
            env="GraspForceStatic-v0",
            env_kwargs=(f"grasps:{grasps}",),
            evaluation_kwargs=(f"grasps:{grasps}",),
            seed=seed,
            steps=256,
            envs=2,
            evaluate_every=128,
            evaluation_episodes=4,
            hyperparams=("n_steps:64", "batch_size:32", "n_epochs:2"),
        )
    )
    weights = PPO.load(agent.model).policy.state_dict()
    yield "training of an agent", arrays_of({key: weights[key].numpy() for key in weights})


if __name__ == "__main__":
    run_cli(FingerprintSettings, main)
