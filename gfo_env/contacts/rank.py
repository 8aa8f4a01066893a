"""Whether contacts can balance every load at all: the rank of their grasp map."""

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from gfo_env.checks import checked_array
from solvers.arrays import Array
from solvers.problem import balance_rows

RANK_TOLERANCE = 1e-4
"""A grasp map whose singular values (torque rows over their moment arm) fall below this ratio of
the largest cannot balance every load: some would take forces ten thousand times their size."""


def can_balance(grasp_map: ArrayLike) -> NDArray[np.bool_]:
    """(...,) whether forces at the contacts, friction ignored, can balance every load.

    Args:
        grasp_map: (..., 6, 3n), padding included or not.

    Raises:
        GeometryError: the grasp map has another shape or is not finite.
    """
    maps = checked_array("grasp_map", grasp_map, (6, "3n"), batched=True)
    if maps.shape[-1] < 6:
        return np.zeros(maps.shape[:-2], dtype=np.bool_)
    # by a power of two, which rounds nothing, so that squares neither overflow nor vanish
    _, exponent = np.frexp(np.abs(maps).max(axis=(-2, -1), keepdims=True))
    singular = np.linalg.svd(balance_rows(np, np.ldexp(maps, -exponent)), compute_uv=False)
    return singular[..., -1] > RANK_TOLERANCE * singular[..., 0]


@njit(cache=True)
def balances(grasp_map: Array) -> bool:
    """`can_balance` of one grasp map for compiled code, by the squares of its singular values."""
    rows = grasp_map.copy()
    force, torque = _square_sum(rows[:3]), _square_sum(rows[3:])
    if force > 0.0 and torque > 0.0:
        rows[3:] /= np.sqrt(torque / force)
    squares = np.zeros((6, 6))
    for i in range(6):
        for j in range(i + 1):
            for k in range(rows.shape[1]):
                squares[i, j] += rows[i, k] * rows[j, k]
            squares[j, i] = squares[i, j]
    # their sum is at least the largest of them
    if _all_above(squares, RANK_TOLERANCE * RANK_TOLERANCE * np.trace(squares)):
        return True
    values = np.linalg.eigvalsh(squares)
    return bool(values[0] > RANK_TOLERANCE * RANK_TOLERANCE * values[-1])


@njit(cache=True)
def _square_sum(matrix: Array) -> float:
    total = 0.0
    for row in range(matrix.shape[0]):
        for column in range(matrix.shape[1]):
            total += matrix[row, column] * matrix[row, column]
    return total


@njit(cache=True)
def _all_above(matrix: Array, value: float) -> bool:
    """Whether all eigenvalues of a symmetric matrix are larger, by its factor less the value."""
    size = len(matrix)
    factor = matrix.copy()
    for c in range(size):
        factor[c, c] -= value
        for k in range(c):
            factor[c, c] -= factor[c, k] * factor[c, k]
        if not factor[c, c] > 0.0:
            return False
        factor[c, c] = np.sqrt(factor[c, c])
        for r in range(c + 1, size):
            for k in range(c):
                factor[r, c] -= factor[r, k] * factor[c, k]
            factor[r, c] /= factor[c, c]
    return True
