"""Random problems of quality: those of `training.problems.sampling` with budgets and prices."""

from dataclasses import dataclass, field

import numpy as np

from gfo_env.grasps import GraspTable
from solvers import GraspForceProblem
from solvers.exact.dual_newton import solve_flat
from solvers.max_quality.preload import effort
from solvers.problem import MAX_QUALITY

from .sampling import SamplingSettings, check_ranges, log_uniform, sample_problems


@dataclass(frozen=True)
class QualitySamplingSettings:
    """Ranges that problems of quality are drawn from.

    Raises:
        SamplingError: if a range is empty, reaches below zero or to infinity.
    """

    budget: tuple[float, float] = (1.1, 6.0)
    """Times the effort of the least-norm forces, log-uniform."""
    priced: float = 0.4
    """Share of the problems in which effort has a price."""
    price: tuple[float, float] = (0.005, 0.1)
    """Newtons of q_lrw that a newton of effort is worth, log-uniform."""
    constraints: SamplingSettings = field(
        default_factory=lambda: SamplingSettings(preload=2.0, torque_scale=(0.2, 1.0))
    )
    """Loads, friction and limits."""

    def __post_init__(self) -> None:
        check_ranges(self, positive=("budget", "price"), shares=("priced",))


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
    answer = solve_flat(convex)
    least = effort(answer.forces)
    times = log_uniform(rng, settings.budget, len(grasps))
    price = log_uniform(rng, settings.price, len(grasps))
    price = np.where(rng.random(len(grasps)) < settings.priced, price, 0.0)
    problem = convex.constraints(MAX_QUALITY).derived(
        effort_budget=times * np.maximum(least, 1e-3),
        characteristic_length=np.array(grasps.object_radius, dtype=np.float64),
        effort_weight=price,
    )
    return problem[np.flatnonzero(answer.solved & (least > 0.0))]
