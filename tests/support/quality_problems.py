"""Problems of quality for tests."""

from typing import Any

import numpy as np

from solvers import GraspForceProblem, solve
from solvers.problem import MAX_QUALITY
from tests.support.problems import random_problem

LENGTH = 0.04


def quality_problem(
    rng: np.random.Generator, contacts: int = 4, *, times: float = 2.0, **overrides: Any
) -> GraspForceProblem:
    """A random problem whose budget is `times` the least effort; feasible."""
    while True:
        convex = random_problem(rng, contacts, objective="sum_normal", **overrides)
        least = solve(convex)
        if least.status in ("optimal", "feasible") and least.objective > 0:
            return convex.constraints(MAX_QUALITY).replace(
                effort_budget=times * least.objective, characteristic_length=LENGTH
            )


def quality_batch(rng: np.random.Generator, *contacts: int, **overrides: Any) -> GraspForceProblem:
    """One problem for each number of contacts, padded to the largest."""
    return GraspForceProblem.stack([quality_problem(rng, n, **overrides) for n in contacts])
