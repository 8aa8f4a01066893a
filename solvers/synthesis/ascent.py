"""Moving contacts along the gradient that the duals of the force problem give."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog

from solvers.arguments import plain_array
from solvers.arrays import Array
from solvers.exceptions import ProblemError, SolverError
from solvers.registry import solve

from .facets import ContactFacets
from .rank_one import force_problems

_FIRST_STEP = 0.1
_SMALLEST_STEP = 1e-4
_LEAST_GAIN = 1e-4
_MAX_STEPS = 40

_RANK_TOLERANCE = 1e-7
"""Above what a grasp force problem asks for, whose moment arm may differ from the length."""


@dataclass(frozen=True, eq=False)
class ContactAscent:
    """Contact positions that gradient steps have led to.

    Args:
        positions: (n, 3) m, on the facets, object frame.
        reach: smallest reach over the loads at these positions.
        first_reach: the same where the ascent began.
        evaluations: force problems that were solved, loads times steps.
    """

    positions: Array
    reach: float
    first_reach: float
    evaluations: int


def reaches(facets: ContactFacets, positions: Array, loads: Array) -> tuple[Array, Array]:
    """How far the contacts reach along each load, and the derivative by the positions.

    V(d) = min sum f_n subject to G f = d inside the friction cones is the price of one newton of
    load; the reach 1 / V is the most load that one newton of total normal force carries, and its
    least value over all unit directions is q_lrw at unit normal forces. By the envelope theorem
    dV/dG = nu f', and G depends on position through the moment arm alone, so that
    dV/dx_i = (R_i f_i) x nu_torque.

    Args:
        facets: for friction and contact frames.
        positions: (n, 3) m.
        loads: (K, 6) d_k, torques over the facets' length.

    Returns:
        (K,) reaches, 0 where a load cannot be carried at all, and (K, n, 3) derivatives, 1/m. All
        are 0 where contacts lie on one line or are fewer than three: no force closure.
    """
    positions = plain_array("positions", positions, (len(facets), 3))
    loads = plain_array("loads", loads, (np.shape(loads)[0] if np.ndim(loads) else 0, 6))
    balanced = facets.grasp_map(positions) / np.repeat([1.0, facets.length], 3)[:, None]
    if np.linalg.matrix_rank(balanced, rtol=_RANK_TOLERANCE) < 6:
        return np.zeros(len(loads)), np.zeros((len(loads), len(facets), 3))
    answer = solve(force_problems(facets, positions, loads, "sum_normal"))
    carried = np.isin(answer.status, ("optimal", "feasible"))
    price = np.where(carried, answer.objective, np.inf)
    forces = np.where(carried[:, None], answer.forces, 0.0).reshape(len(loads), len(facets), 3)
    world = np.einsum("nij,knj->kni", facets.frames, forces)
    torque_price = np.where(carried[:, None], answer.equilibrium_dual[:, 3:], 0.0)
    price_slope = np.cross(world, torque_price[:, None])
    return 1.0 / price, -price_slope / price[:, None, None] ** 2


def ascend(facets: ContactFacets, loads: Array, positions: Array) -> ContactAscent:
    """Raise the smallest reach over the loads by moving contacts on their facets.

    Linear programs in a shrinking box: each maximises the smallest of the linearised reaches.

    Args:
        facets: one for each contact.
        loads: (K, 6) directions, torques over the facets' length.
        positions: (n, 3) m, where to start, on the facets.

    Raises:
        ProblemError: for positions or loads of other shapes.
        SolverError: if a load cannot be carried at the start: there is no gradient to follow.
    """
    if not isinstance(facets, ContactFacets):
        raise ProblemError(f"facets must be ContactFacets, not {type(facets).__name__}")
    positions = plain_array("positions", positions, (len(facets), 3))
    if np.ndim(loads) != 2 or not len(loads):
        raise ProblemError(f"loads must be one or more rows of 6, not of shape {np.shape(loads)}")
    local = facets.local(positions)
    values, slopes = reaches(facets, positions, loads)
    first = float(values.min())
    if first <= 0:
        raise SolverError("a load cannot be carried where the ascent starts: no gradient to follow")
    evaluations, box = len(loads), _FIRST_STEP * facets.length
    for _ in range(_MAX_STEPS):
        step, promised = _best_step(facets, local, values, slopes, box)
        if promised < _LEAST_GAIN * values.min():
            break
        trial = local + step
        new_values, new_slopes = reaches(facets, facets.positions(trial), loads)
        evaluations += len(loads)
        gain = float(new_values.min() - values.min())
        if gain > 0.1 * promised:
            local, values, slopes = trial, new_values, new_slopes
        box *= 2.0 if gain > 0.7 * promised else 1.0 if gain > 0.1 * promised else 0.3
        if box < _SMALLEST_STEP * facets.length:
            break
    return ContactAscent(facets.positions(local), float(values.min()), first, evaluations)


def _best_step(
    facets: ContactFacets, local: Array, values: Array, slopes: Array, box: float
) -> tuple[Array, float]:
    """(n, 2) step in local coordinates, at most `box` [m] along each axis, and the gain."""
    n = len(facets)
    tangents = facets.size[:, None, None] * facets.frames[:, :, :2]
    gradient = np.einsum("kni,nia->kna", slopes, tangents).reshape(len(values), 2 * n)
    rows = [np.column_stack([-gradient, np.ones(len(values))])]
    bounds = [values]
    for index, (sides, limit) in enumerate(facets.sides):
        block = np.zeros((len(sides), 2 * n + 1))
        block[:, 2 * index : 2 * index + 2] = sides
        rows.append(block)
        bounds.append(np.maximum(limit - sides @ local[index], 0.0))
    width = np.repeat(box / facets.size, 2)
    answer = linprog(
        np.append(np.zeros(2 * n), -1.0),
        A_ub=np.vstack(rows),
        b_ub=np.concatenate(bounds),
        bounds=[*zip(-width, width, strict=True), (None, None)],
        method="highs",
    )
    if answer.x is None:
        return np.zeros((n, 2)), 0.0
    return answer.x[:-1].reshape(n, 2), float(answer.x[-1] - values.min())
