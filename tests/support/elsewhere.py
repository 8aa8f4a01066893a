"""Answers to compare between processors: of solvers, judge, simulator and a short training.

`python -m tests.support.elsewhere` writes those of this machine beside the tests, for other
machines to be compared with. The stored ones were made with the oldest kernels that the libraries
have, so that they differ from any processor of today:

    NUMBA_CPU_NAME=generic OPENBLAS_CORETYPE=Prescott ATEN_CPU_CAPABILITY=default \
        NPY_DISABLE_CPU_FEATURES="X86_V3 X86_V4" python -m tests.support.elsewhere
"""

import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from gfo_env.contacts import lowest_resisted_wrench
from gfo_env.grasps.acquisition import attempt
from gfo_env.objects import ObjectSet
from gfo_env.simulation import Simulation
from solvers import GraspForceProblem, solve
from solvers.learned.config import NetworkConfig
from solvers.problem import OBJECTIVES
from tests.support.grasp_tables import random_table
from tests.support.kernels import kernels
from tests.support.problems import VARIANTS, random_problem
from tests.support.quality_problems import quality_batch
from training.networks.conditioned import train
from training.networks.loop import HISTORY
from training.networks.settings import TrainingSettings

STORED = Path(__file__).parent / "elsewhere.json"

SOLVERS = {
    "dual_newton": OBJECTIVES,
    "interior_point": OBJECTIVES,
    "clarabel": OBJECTIVES,
    "conditioned": ("min_norm",),
    "dual_newton_torch": ("min_norm",),
}
QUALITY_SOLVERS = ("uniform_preload", "quality", "quality_search")

ATTEMPTS = 30


def answers() -> dict[str, Any]:
    """Everything that is compared; numbers as text, to be short in a file."""
    return {
        "kernels": kernels(),
        "convex": {
            f"{solver}, {objective}": _solved(_problems(objective), solver)
            for solver, objectives in SOLVERS.items()
            for objective in objectives
        },
        "max_quality": {
            solver: _solved(quality_batch(np.random.default_rng(0), 3, 4, 5), solver)
            for solver in QUALITY_SOLVERS
        },
        "q_lrw": [_interval(np.random.default_rng(seed), seed) for seed in range(3, 9)],
        "training": _trained(),
        "attempts": _attempts(),
    }


def _problems(objective: str) -> GraspForceProblem:
    """One of every variant."""
    rng = np.random.default_rng(0)
    return GraspForceProblem.stack(
        [
            random_problem(rng, **{"contacts": 4, **overrides}, objective=objective)
            for overrides in VARIANTS.values()
        ]
    )


def _solved(batch: GraspForceProblem, solver: str) -> dict[str, Any]:
    solution = solve(batch, solver)
    return {"status": " ".join(solution.status), "objective": _short(solution.objective)}


def _interval(rng: np.random.Generator, count: int) -> str:
    outward = rng.normal(size=(count, 3))
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    interval = lowest_resisted_wrench(
        0.04 * outward, -outward, np.full(count, 0.8), length=0.04, relative_width=0.01
    )
    return _short(np.array([interval.lower, interval.upper]))


def _trained() -> str:
    """Losses of forty steps of a small network."""
    with tempfile.TemporaryDirectory() as folder:
        grasps, output = Path(folder) / "grasps.npz", Path(folder) / "run"
        random_table(np.random.default_rng(0), 100).save(grasps)
        network = NetworkConfig(steps=2, width=16, vectors=4, memory=4, joint_width=8)
        train(
            TrainingSettings(
                grasps=grasps,
                output=output,
                steps=40,
                batch=64,
                warmup=5,
                validate_every=20,
                network=network,
            )
        )
        history = json.loads((output / HISTORY).read_text(encoding="utf-8"))
    return _short(np.array([row["loss"] for row in history]))


def _attempts() -> dict[str, Any]:
    """Outcomes of attempts at grasps, and of each the sum of the contacts' coordinates."""
    objects, simulation = ObjectSet("random_urdfs", "test"), Simulation()
    tried = [
        attempt(objects[object_id], simulation, np.random.default_rng([0, number]))
        for number, object_id in enumerate(objects.object_ids[:ATTEMPTS])
    ]
    simulation.close()
    sums = [np.nan if one.grasp is None else one.grasp.contacts.positions.sum() for one in tried]
    return {"outcome": " ".join(one.outcome.value for one in tried), "sum": _short(np.array(sums))}


def _short(numbers: np.ndarray) -> str:
    """Ten digits of each."""
    return " ".join(f"{number:.10g}" for number in numbers.tolist())


if __name__ == "__main__":
    STORED.write_text(json.dumps(answers(), indent=1) + "\n", encoding="utf-8")
