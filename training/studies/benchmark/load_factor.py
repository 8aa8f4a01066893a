"""The largest and the least multiple of a load that a grasp can carry, with proofs for both ends.

Along a fixed wrench w the loads alpha w that forces can balance are an interval. Its ends are two
conic programs: alpha is one more variable.
"""

from dataclasses import dataclass

import numpy as np

from solvers import GraspForceProblem
from solvers.arrays import Array
from solvers.conic import POSITIVE, SECOND_ORDER, ZERO, solve
from solvers.duality import contact_duals
from solvers.problem import Multipliers, tangential_size

from .conic import EQUALITIES, ConicBatch, conic_batches, scatter

ACCURACY = 1e-9
"""Largest relative distance between the load that is carried and the one proven too large."""

_TOLERANCE = 1e-12


@dataclass(frozen=True, eq=False)
class LoadFactors:
    """The interval of multiples of its load that each problem can carry.

    Args:
        least: (B,) smallest multiple; NaN where it was not found.
        largest: (B,) largest multiple; NaN where it was not found to `ACCURACY`.
        bound: (B,) a multiple above which infeasibility is proven; NaN like `largest`.
    """

    least: Array
    largest: Array
    bound: Array


def load_factors(problem: GraspForceProblem) -> LoadFactors:
    """The load factors of a batch of numpy problems with finite torque limits."""
    parts = conic_batches(problem)
    least, largest = np.full((2, len(problem)), np.nan)
    answers = []
    for part in parts:
        solved = [_extreme(part, problem_, +1.0) for problem_ in range(len(part))]
        largest[part.index] = [alpha for alpha, _, _ in solved]
        answers.append((np.array([x for _, x, _ in solved]), np.array([z for _, _, z in solved])))
        least[part.index] = [_extreme(part, problem_, -1.0)[0] for problem_ in range(len(part))]
    _, multipliers = scatter(problem, parts, answers)
    bound = proven_factor(problem, multipliers)
    close = np.abs(bound - largest) <= ACCURACY * np.abs(largest)
    known = np.isfinite(largest) & np.isfinite(least) & close & (largest > 0)
    return LoadFactors(
        np.where(known, least, np.nan),
        np.where(known, largest, np.nan),
        np.where(known, bound, np.nan),
    )


def proven_factor(problem: GraspForceProblem, multipliers: Multipliers) -> Array:
    """(B,) a multiple of the load above which (nu, lambda) prove that no forces exist.

    The Farkas value of the problem with load alpha w grows linearly in alpha: its zero is the
    bound. Infinite where the multipliers prove nothing.
    """
    prices = contact_duals(problem, multipliers)
    slope = prices[..., 2] - problem.friction * tangential_size(problem.xp, prices)
    slope = np.where(problem.contact_mask, slope, 0.0)
    # rounding makes the price of a contact without cap slightly negative
    free = ~np.isfinite(problem.normal_max)
    tiny = 1e-10 * np.max(np.linalg.norm(prices, axis=-1), axis=-1, keepdims=True)
    slope = np.where(free & (slope < 0) & (slope > -tiny), 0.0, slope)
    cap = np.where(slope < 0, problem.normal_max, problem.normal_min)
    price = multipliers.torque
    room = np.where(
        price > 0,
        problem.external_torque - problem.torque_max,
        problem.external_torque - problem.torque_min,
    )
    # what has no limit has no price: zero times infinity is zero here
    with np.errstate(invalid="ignore"):
        terms = np.where(slope == 0, 0.0, slope * cap).sum(axis=-1)
        constant = terms + np.where(price == 0, 0.0, price * room).sum(axis=-1)
    gain = np.sum(multipliers.equilibrium * problem.external_wrench, axis=-1)
    usable = (gain > 0) & np.isfinite(constant)
    return np.where(usable, -constant / np.where(usable, gain, 1.0), np.inf)


def _extreme(part: ConicBatch, problem: int, sign: float) -> tuple[float, Array, Array]:
    """The largest (sign 1) or least (sign -1) multiple, its x and dual (m,); NaN if unsolved."""
    rows = part.rows_of(problem)
    matrix, bound = part.matrix[problem, rows], part.bound[problem, rows].copy()
    # A_eq x = alpha b_eq instead of b_eq: the load becomes a column
    column = np.zeros((len(matrix), 1))
    column[:EQUALITIES, 0] = -bound[:EQUALITIES]
    bound[:EQUALITIES] = 0.0
    size = part.n_variables
    outcome = solve(
        None,
        np.append(np.zeros(size), -sign),
        np.hstack([matrix, column]),
        bound,
        [
            ZERO(EQUALITIES),
            POSITIVE(len(matrix) - EQUALITIES - size),
            *[SECOND_ORDER(3)] * part.n_contacts,
        ],
        tolerance=_TOLERANCE,
    )
    dual = np.zeros(len(rows))
    dual[rows] = outcome.dual
    x = outcome.x
    # the proof of the other end decides whether an answer of less accuracy is good enough
    if not (outcome.solved or outcome.status == "InsufficientProgress"):
        return np.nan, np.full(size, np.nan), np.full(len(rows), np.nan)
    return float(x[-1]), x[:-1], dual
