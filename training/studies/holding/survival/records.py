"""What became of forces: the rows that everything else is made of."""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from solvers.arrays import Array

from .measures import MEASURES

AGAIN = 0.98
"""Factor on the friction coefficient in the second shake of the same forces."""

STIFF = 0.1
"""N·m of dry friction in every joint in the third shake, ten times as much as else: joints that
give way less."""


@dataclass(frozen=True, eq=False)
class Records:
    """Shakes, one a row: m forces of several methods for each of several grasps.

    Args:
        object_id: (m,) of the grasp.
        attempt: (m,) number of the grasp.
        method: (m,) names in `methods.LABELS`.
        level: (m,) N, see `methods`.
        phases_held: (m,) loads survived.
        held: (m,) whether all of them.
        held_again: (m,) likewise with `AGAIN` of the friction.
        held_stiff: (m,) likewise with joints of `STIFF` dry friction.
        measures: (m,) of each name in `MEASURES`.
    """

    object_id: NDArray[np.str_]
    attempt: NDArray[np.int64]
    method: NDArray[np.str_]
    level: Array
    phases_held: NDArray[np.int64]
    held: NDArray[np.bool_]
    held_again: NDArray[np.bool_]
    held_stiff: NDArray[np.bool_]
    measures: dict[str, Array]

    def __len__(self) -> int:
        return len(self.held)

    def __getitem__(self, rows: NDArray[Any]) -> Self:
        """The rows of a mask or of indices."""
        columns = {name: getattr(self, name)[rows] for name in COLUMNS}
        chosen = {name: values[rows] for name, values in self.measures.items()}
        return type(self)(**columns, measures=chosen)

    def score(self, name: str) -> Array:
        """(m,) a measure with the sign with which more is expected to hold better."""
        return MEASURES[name].sign * self.measures[name]


COLUMNS: dict[str, type[Any]] = {
    "object_id": str,
    "attempt": np.int64,
    "method": str,
    "level": np.float64,
    "phases_held": np.int64,
    "held": np.bool_,
    "held_again": np.bool_,
    "held_stiff": np.bool_,
}
"""Columns besides the measures, with their types."""
