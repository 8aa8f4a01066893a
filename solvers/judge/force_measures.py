"""How commanded forces do on a problem: the residuals that a reward is made of."""

from typing import NamedTuple

import numpy as np

from solvers.arguments import plain_array
from solvers.problem import GraspForceProblem, as_problem


class ForceResiduals(NamedTuple):
    """The residuals of `solvers.problem.residuals` of one set of forces.

    Args:
        equilibrium: N, size of the least change of the forces that balances the load.
        friction: N, worst excess over a friction cone.
        normal: N, worst shortfall from a preload or excess over a cap.
        torque: N·m, worst excess of a joint torque over its limit.
        force_scale: N, the size that the problem asks of forces, `solvers.problem.force_scale`.
    """

    equilibrium: float
    friction: float
    normal: float
    torque: float
    force_scale: float


def force_residuals(problem: GraspForceProblem, forces: np.ndarray) -> ForceResiduals:
    """Measure forces, (3n,) N, on a single problem of numpy arrays.

    The numbers are those of `solvers.problem.residuals` up to rounding, which tests hold; the code
    is the judge's, loaded and compiled at the first call.

    Raises:
        ProblemError: for a batch, tensors, or forces of another shape.
    """
    from solvers.compiled.judge.force_measures import measure_forces

    arrays = as_problem(problem).plain_arrays(0)
    forces = plain_array("forces", forces, (3 * problem.n_contacts,))
    return ForceResiduals(*measure_forces(arrays, forces))
