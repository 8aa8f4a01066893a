"""Tables of the comparison: rows in, numbers out."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from solvers.arrays import Array
from training.reports.intervals import Interval

from .run import REFERENCE, Row

Owners = NDArray[np.str_]

_LEAST = 1e-3
"""N: q_lrw per N of effort below which contacts have no force closure to speak of."""


@dataclass(frozen=True, eq=False)
class MethodResults:
    """What one method did on the problems of one set, at one budget and price, in their order.

    Args:
        lower: (k,) N, lower ends of the intervals of q_lrw; 0 where the forces are not feasible.
        upper: (k,) N.
        worth: (k,) N; -inf where the forces are not feasible.
        effort: (k,) over that of the least-norm forces.
        feasible: (k,).
        bound: (k,) N, that no forces exceed; infinite from others than the reference.
        owners: (k,) objects.
        scale: (k,) N, effort of the least-norm forces.
    """

    lower: Array
    upper: Array
    worth: Array
    effort: Array
    feasible: NDArray[np.bool_]
    bound: Array
    owners: Owners
    scale: Array


@dataclass(frozen=True, eq=False)
class Results:
    """All rows of a study."""

    rows: list[Row]

    def answers(self, number: int, method: str, times: float, price: float = 0.0) -> MethodResults:
        """Those of one set, method, budget and price."""
        key = number, method, times, price
        rows = [
            row
            for row in self.rows
            if (row["set"], row["method"], row["times"], row["price"]) == key
        ]
        rows.sort(key=lambda row: row["problem"])
        feasible = np.array([row["feasible"] for row in rows], dtype=np.bool_)

        def column(name: str, missing: float) -> Array:
            return np.array([missing if row[name] is None else row[name] for row in rows])

        return MethodResults(
            lower=np.where(feasible, column("lower", 0.0), 0.0),
            upper=column("upper", 0.0),
            worth=np.where(feasible, column("worth", -np.inf), -np.inf),
            effort=column("effort", 0.0),
            feasible=feasible,
            bound=column("bound", np.inf),
            owners=np.array([row["object"] for row in rows]),
            scale=column("least_effort", np.nan),
        )

    def compared(self, number: int, times: float) -> NDArray[np.bool_]:
        """(k,) problems whose reference has any quality: their contacts close the grasp."""
        reference = self.answers(number, REFERENCE, times)
        return np.asarray(reference.lower > _LEAST * times * reference.scale)

    def shares(self, number: int, method: str, times: float) -> tuple[Array, Owners]:
        """(m,) q_lrw over the reference's, lower ends both, and the objects."""
        kept = self.compared(number, times)
        answers = self.answers(number, method, times)
        reference = self.answers(number, REFERENCE, times)
        return answers.lower[kept] / reference.lower[kept], answers.owners[kept]

    def gains(self, number: int, method: str, other: str, times: float) -> tuple[Array, Owners]:
        """(m,) q_lrw over that of another method, less one, and the objects."""
        kept = self.compared(number, times)
        first, second = (self.answers(number, name, times) for name in (method, other))
        kept = kept & (second.lower > 0.0)
        return first.lower[kept] / second.lower[kept] - 1.0, first.owners[kept]


def median(values: Array, owners: Owners) -> Interval:
    """The median of values, with its interval over their objects."""
    return Interval.of(values, owners, np.median)


def tenth(values: Array) -> float:
    """The 10th percentile."""
    return float(np.quantile(values, 0.1))
