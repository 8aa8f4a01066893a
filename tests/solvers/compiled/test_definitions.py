"""What kernels, judge and array code each define for themselves is the same.

The judge shares no code with the kernels that it judges, and kernels of eight lanes none with
numpy: the projection on the friction cones stands three times, the Farkas value four times.
"""

from typing import Any

import numpy as np
import pytest
from numba import njit

from solvers import GraspForceProblem
from solvers.arrays import Array
from solvers.compiled import constants
from solvers.compiled.arrays import ProblemArrays
from solvers.compiled.interior.check import farkas
from solvers.compiled.interior.form import new_form, scale_problem
from solvers.compiled.newton.layout import layout
from solvers.compiled.newton.projection import project
from solvers.compiled.newton.proofs import proves_infeasible
from solvers.compiled.newton.setup import gather, prepare
from solvers.duality import FORCE_HORIZON, farkas_value, project_cones, projection_jacobian
from solvers.exact.dual_newton import solve_flat
from solvers.judge import judge
from solvers.problem import ARRAY_FIELDS, OBJECTIVES, Multipliers, canonical
from tests.support.problems import random_batch
from tests.support.seeds import seeded


@njit
def _project(points: Array, cones: Array) -> tuple[float, Array, Array]:
    n = len(points)
    at = layout(n, 0)
    ws = np.zeros(at.length)
    ws[at.prices : at.prices + 3 * n] = -points.ravel()
    ws[at.inner_cone : at.inner_cone + 4 * n] = cones.ravel()
    value = project(ws, at, at.prices, at.inner_cone, 0.0)
    return value, ws[at.forces : at.curvature], ws[at.curvature : at.limit]


@njit
def _newton_proves(arrays: Any, nu: Array, torque: Array) -> bool:
    """Whether the Newton kernel takes multipliers of a problem in canonical form for a proof."""
    problem = ProblemArrays(*arrays)
    at = layout(len(problem.friction), len(problem.torque_min))
    ws = np.zeros(at.length)
    gather(ws, at, 0, 1, problem)
    prepare(ws, at, 0.0)
    ws[at.trial_prices : at.trial_price] = problem.grasp_map.T @ nu + problem.hand_jacobian @ torque
    ws[at.trial_price : at.candidate] = torque
    ws[at.error : at.error + 6] = nu
    return proves_infeasible(ws, at, at.trial_prices, at.error, at.trial_price, 0.0)


@njit
def _interior_farkas(arrays: Any, nu: Array, torque: Array) -> float:
    """The interior point's value of multipliers of a problem in canonical form."""
    problem = ProblemArrays(*arrays)
    form = new_form(len(problem.friction), len(torque))
    scale_problem(form, problem)
    return farkas(form, np.concatenate((nu, torque)))


def test_constants_are_those_of_the_array_code() -> None:
    assert constants.FORCE_HORIZON == FORCE_HORIZON
    assert ProblemArrays._fields == ARRAY_FIELDS
    numbers = (constants.MIN_NORM, constants.SUM_NORMAL, constants.MIN_MAX_NORMAL)
    assert [OBJECTIVES[number] for number in numbers] == list(OBJECTIVES)


def _free_duals(rng: np.random.Generator, points: Array) -> GraspForceProblem:
    """A problem with a joint for each force component: its price is that component's dual."""
    width = points.size
    preload = rng.choice([0.0, 0.5, 2.0], len(points))
    return GraspForceProblem(
        grasp_map=random_batch(rng, 1, contacts=len(points)).grasp_map[0],
        hand_jacobian=np.eye(width),
        friction=rng.choice([0.0, 0.3, 1.0, 3.0], len(points)),
        torque_min=np.zeros(width),
        torque_max=np.zeros(width),
        external_wrench=np.zeros(6),
        normal_min=preload,
        normal_max=preload + rng.choice([0.0, 1.0, np.inf], len(points)),
    )


@pytest.mark.parametrize("seed", range(60))
def test_three_projections_on_the_friction_cones_are_one(seed: int) -> None:
    """Points inside, outside and opposite of cones, on their axes, at their tips and edges."""
    rng = seeded([35, seed])
    points = rng.standard_normal((6, 3)) * rng.choice([0.0, 1e-9, 1.0, 1e3], (6, 3))
    problem = _free_duals(rng, points)
    mu = problem.friction
    cones = np.stack([mu, 1.0 / (1.0 + mu**2), problem.normal_min, problem.normal_max])
    value, forces, curvature = _project(points, cones)
    expected = project_cones(problem, points)
    np.testing.assert_allclose(forces.reshape(-1, 3), expected, rtol=1e-12, atol=1e-15)
    upper = curvature.reshape(-1, 6)
    whole = upper[:, [0, 1, 3, 1, 2, 4, 3, 4, 5]].reshape(-1, 3, 3)
    np.testing.assert_allclose(whole, projection_jacobian(problem, points), rtol=1e-9, atol=1e-12)
    terms = 0.5 * expected**2 - points * expected
    size = np.abs(terms).sum()
    np.testing.assert_allclose(value, terms.sum(), rtol=0, atol=1e-12 * size)
    # the judge keeps its projection to itself, but for the value that it makes a bound of
    verdict = judge(problem, np.zeros(points.size), Multipliers(np.zeros(6), -points.ravel()))
    np.testing.assert_allclose(verdict.dual_bound, terms.sum(), rtol=0, atol=1e-12 * size)


@pytest.mark.parametrize(("cap", "tolerance"), [(20.0, 1e-12), (np.inf, 1e-9)])
@pytest.mark.parametrize("seed", range(10))
def test_four_farkas_values_are_one(seed: int, cap: float, tolerance: float) -> None:
    """Of proofs that the kernel found, and of multipliers farther and farther from them.

    In canonical form, where all four add the same terms up, by which the value is divided. Where
    there is no cap, the horizon multiplies what rounding leaves of a slope of zero.
    """
    rng = seeded([36, seed])
    weak = {"torque_min": -0.05, "torque_max": 0.05}
    drawn = random_batch(rng, 6, contacts=4, normal_max=cap, **weak)
    batch = canonical(drawn).problem.flat()
    answer = solve_flat(batch)
    assert answer.infeasible.any()
    nu, torque = answer.equilibrium_dual, answer.torque_dual
    for share in (0.0, 1e-9, 1e-3, 0.1, 0.5, 2.0):
        size = np.linalg.norm(nu, axis=-1, keepdims=True)
        moved = Multipliers(nu + share * size * rng.standard_normal(nu.shape), torque)
        value = farkas_value(batch, moved)
        verdict = judge(batch, np.full((6, 12), np.nan), moved)
        np.testing.assert_allclose(verdict.farkas_value, value, rtol=0, atol=tolerance)
        for b in range(6):
            arrays, multipliers = batch[b].arrays(), (moved.equilibrium[b], torque[b])
            inner = _interior_farkas(arrays, *multipliers)
            np.testing.assert_allclose(inner, value[b], rtol=0, atol=tolerance)
            if abs(value[b] - 1e-8) > tolerance:
                assert _newton_proves(arrays, *multipliers) == (value[b] > 1e-8)
