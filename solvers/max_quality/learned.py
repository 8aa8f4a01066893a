"""The solver `quality`: a network's steps towards the most q_lrw, every one answered exactly.

The network (`solvers.max_quality.network`) names shares of the preload;
`solvers.max_quality.preload` makes them forces that satisfy every constraint and use the effort
that is allowed. Of all steps, the even preload that they begin with included, the forces that are
worth most along all the directions found are the answer. How much better any others could be is
what `quality_search` proves.

The shipped weights were made by

    python scripts/train_quality.py --grasps train.npz --output runs/quality --seed 0

on grasps from `python scripts/collect.py --grasps 10000 --output train.npz`; the file's metadata
says the rest.
"""

from pathlib import Path

import numpy as np
import torch

from solvers.arrays import Array
from solvers.base import Solver
from solvers.learned.files import load_network, weights_path
from solvers.problem import MAX_QUALITY, GraspForceProblem, Multipliers
from solvers.quality.directions import spread_directions, weakest_directions
from solvers.solution import Candidate

from .flow import QualityPoint, better_point, even_shares, farthest, quality_point, utility
from .network import QualityFeatures, QualityNetwork
from .preload import LeastForces, effort, least_forces, without_padding

DEFAULT_QUALITY_WEIGHTS = Path(__file__).parents[1] / "weights" / "quality.safetensors"

_CHUNK = 1024
_FINALISTS = 4
_STARTS = 128
_NONE = "no forces within the budget"


class QualitySolver(Solver):
    """Forces of nearly the highest quality, in two milliseconds; exactly feasible.

    Written in other units, tangents or order, or solved in another batch, a problem gets answers of
    the same quality but for about one per cent: rounding decides between wrench directions that are
    nearly as weak as each other, and steps then part ways.

    Args:
        weights: file of `scripts/train_quality.py`, or a network; the shipped weights by default.

    Raises:
        SolverError: for unusable weights.
    """

    objectives = (MAX_QUALITY,)

    def __init__(self, weights: str | Path | QualityNetwork | None = None) -> None:
        if isinstance(weights, QualityNetwork):
            self._network = weights.eval()
        else:
            path = weights_path(weights, DEFAULT_QUALITY_WEIGHTS)
            self._network = load_network(path, QualityNetwork)

    def propose(self, problem: GraspForceProblem) -> Candidate:
        """The best forces of all steps, NaN where there are none."""
        parts = [
            self._propose(problem[start : start + _CHUNK])
            for start in range(0, max(len(problem), 1), _CHUNK)
        ]
        forces = np.concatenate([forces for forces, _ in parts])
        multipliers = Multipliers(
            np.concatenate([least.multipliers.equilibrium for _, least in parts]),
            np.concatenate([least.multipliers.torque for _, least in parts]),
        )
        found = np.concatenate([least.found for _, least in parts])
        forces = without_padding(problem, forces)
        return Candidate(forces, multipliers, np.where(found, "", _NONE))

    def _propose(self, problem: GraspForceProblem) -> tuple[Array, LeastForces]:
        problem = problem.flat()
        least = least_forces(problem)
        points = quality_steps(self._network, problem, least)
        return best_points(problem, least, points)[0], least


def best_points(
    problem: GraspForceProblem, least: LeastForces, points: list[QualityPoint]
) -> tuple[Array, Array]:
    """(B, 3n) N, the forces that are worth most, and (len(points) + 1, B) N, what all are worth.

    The least forces are the first of them. An estimate from above is only as good as its
    directions: all are measured along those found for any, and the best few then along those of a
    search from more sides.
    """
    choices = np.stack([least.forces, *(point.forces.forces for point in points)])
    directions = np.concatenate([point.directions for point in points], axis=1)
    values = np.stack([_utility(problem, directions, forces) for forces in choices])
    rows = np.arange(len(problem))
    best = np.argsort(-values, axis=0)[:_FINALISTS]
    starts = spread_directions(_STARTS)
    found = [
        weakest_directions(problem, np.nan_to_num(choices[one, rows][:, 2::3]), starts)[1]
        for one in best
    ]
    more = np.concatenate(found, axis=1)
    values = np.minimum(values, np.stack([_utility(problem, more, forces) for forces in choices]))
    return choices[np.argmax(values, axis=0), rows], values


@torch.inference_mode()
def quality_steps(
    network: QualityNetwork, problem: GraspForceProblem, least: LeastForces
) -> list[QualityPoint]:
    """The even preload and all that the network proposes from there.

    Args:
        network: on the CPU.
        problem: flat `max_quality` problems.
        least: of these.
    """
    here = quality_point(problem, least, even_shares(problem), problem.effort_budget)
    points = [here]
    features = QualityFeatures.of(problem, least, here)
    memory = network.encode(features)
    spare = np.maximum(problem.effort_budget - least.effort, 0.0)
    for step in range(network.config.steps):
        proposals, spend, memory = network(features, memory, here, step)
        limit = least.effort + spend.double().numpy() * spare
        new = [
            quality_point(problem, least, shares.double().numpy(), limit, here)
            for shares in proposals
        ]
        here = better_point(problem, new)
        points += new
    return points


def _utility(problem: GraspForceProblem, directions: Array, forces: Array) -> Array:
    """(B,) N; -inf without forces."""
    normal = np.nan_to_num(forces[:, 2::3])
    quality = np.maximum(farthest(problem, directions, normal).min(axis=1), 0.0)
    return utility(problem, quality, effort(forces))
