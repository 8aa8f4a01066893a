"""Lagrange multipliers of a problem: of equilibrium (nu) and of the torque limits (lambda)."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


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
