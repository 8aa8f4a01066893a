"""Lagrange multipliers of a problem: of equilibrium (nu) and of the torque limits (lambda)."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from solvers.arguments import check_vectors
from solvers.exceptions import ProblemError

from .fields import WRENCH_SIZE, ProblemFields


@dataclass(frozen=True, eq=False)
class Multipliers:
    """Lagrange multipliers of equilibrium and of the torque limits.

    Args:
        equilibrium: (..., 6) nu; for `min_norm` in N per unit of the rows of G.
        torque: (..., n_tau) lambda; positive parts price the upper limits, negative parts the
            lower.
    """

    equilibrium: Any
    torque: Any

    def map(self, change: Callable[[Any], Any]) -> "Multipliers":
        """Both parts, changed alike."""
        return Multipliers(change(self.equilibrium), change(self.torque))

    def __getitem__(self, index: Any) -> "Multipliers":
        """Those at `index` of the batch dimensions."""
        return self.map(lambda part: part[index])


def check_multipliers(problem: ProblemFields, multipliers: Multipliers) -> None:
    """Refuse what are no multipliers of the problem(s).

    Raises:
        ProblemError: with the shapes that are wanted; leading dimensions need only broadcast.
    """
    as_multipliers(multipliers)
    batch = problem.batch_shape
    check_vectors("multipliers.equilibrium", multipliers.equilibrium, batch, (WRENCH_SIZE,))
    check_vectors("multipliers.torque", multipliers.torque, batch, (problem.n_joints,))


def as_multipliers(value: Any) -> Multipliers:
    """The value, if it is a pair of multipliers.

    Raises:
        ProblemError: otherwise.
    """
    if isinstance(value, Multipliers):
        return value
    raise ProblemError(
        f"multipliers must be given as Multipliers(equilibrium, torque), not {type(value).__name__}"
    )
