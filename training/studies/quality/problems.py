"""The problems that the comparison poses."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gfo_env.grasps import GraspTable
from solvers import GraspForceProblem
from training.problems.quality_sampling import QualitySamplingSettings, sample_quality_problems
from training.problems.sampling import SamplingSettings

from .plan import QualityStudyError

SAMPLING = QualitySamplingSettings(
    budget=(1.0, 1.0),
    priced=0.0,
    constraints=SamplingSettings(preload=0.0, push=3.0, torque=0.05, torque_scale=(0.3, 1.0)),
)
"""Weight, pushes and torques; friction, torque limits and caps vary; no preload."""


@dataclass(frozen=True, eq=False)
class StudyProblems:
    """Problems of one set.

    Args:
        problem: flat; the budget is the effort of the least-norm forces.
        owners: (B,) their objects.
    """

    problem: GraspForceProblem
    owners: NDArray[np.str_]

    def budget(self, times: float) -> GraspForceProblem:
        """The problems with `times` the budget."""
        return self.problem.derived(effort_budget=times * self.problem.effort_budget)


def study_problems(table: GraspTable, seed: int) -> StudyProblems:
    """One problem for each grasp that can carry its load, in the order of the table.

    The grasps are taken one by one, so that each knows its object.
    """
    problems, owners = [], []
    for index in range(len(table)):
        rng = np.random.default_rng([seed, int(table.attempt[index])])
        problem = sample_quality_problems(table[index : index + 1], rng, SAMPLING)
        if len(problem):
            problems.append(problem[0])
            owners.append(str(table.object_id[index]))
    if not problems:
        raise QualityStudyError("no grasp can carry its load: ask for more grasps")
    return StudyProblems(GraspForceProblem.stack(problems).flat(), np.array(owners))
