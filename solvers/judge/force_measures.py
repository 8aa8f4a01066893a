"""How commanded forces do on a problem: the residuals that a reward is made of."""

from typing import NamedTuple

import numpy as np

from solvers.problem import GraspForceProblem


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
    """
    from solvers.compiled.judge.force_measures import measure_forces

    return ForceResiduals(*measure_forces(tuple(map(_plain, problem.arrays())), _plain(forces)))


def _plain(array: np.ndarray) -> np.ndarray:
    """The array in the one layout of memory that the code is compiled for."""
    flags = array.flags
    return array if flags.c_contiguous and flags.writeable else np.array(array, order="C")
