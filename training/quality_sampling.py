"""Random problems of quality: those of `training.sampling`, with budgets and prices of effort."""

import numpy as np

from gfo_env.grasps import GraspTable
from solvers import GraspForceProblem
from solvers.compiled.batch import solve_batch
from solvers.compiled.newton import SOLVED
from solvers.preload import effort
from solvers.problem import MAX_QUALITY

from .quality_settings import QualitySamplingSettings
from .sampling import log_uniform, sample_problems


def sample_quality_problems(
    grasps: GraspTable,
    rng: np.random.Generator,
    settings: QualitySamplingSettings | None = None,
) -> GraspForceProblem:
    """One random flat `max_quality` problem for each grasp whose load can be carried at all.

    Args:
        grasps: table of grasps; fewer problems come back.
        rng: the only source of randomness.
        settings: ranges.
    """
    settings = settings or QualitySamplingSettings()
    convex = sample_problems(grasps, rng, settings.constraints).flat()
    answer = solve_batch(convex)
    least = effort(answer.forces)
    times = log_uniform(rng, settings.budget, len(grasps))
    price = log_uniform(rng, settings.price, len(grasps))
    price = np.where(rng.random(len(grasps)) < settings.priced, price, 0.0)
    problem = convex.constraints(MAX_QUALITY).derived(
        effort_budget=times * np.maximum(least, 1e-3),
        characteristic_length=np.array(grasps.object_radius, dtype=np.float64),
        effort_weight=price,
    )
    return problem[np.flatnonzero((answer.code == SOLVED) & (least > 0.0))]
