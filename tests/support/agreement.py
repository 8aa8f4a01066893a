"""What every exact solver must do: find Clarabel's optimum, inside the constraints, or a proof."""

from typing import Any

import numpy as np

from solvers import GraspForceProblem, GraspForceSolution, Multipliers, solve
from solvers.duality import farkas_value
from solvers.exact.clarabel_ import ClarabelSolver
from solvers.judge import EQUILIBRIUM_TOLERANCE, FARKAS_TOLERANCE
from solvers.problem import objective_value

CLARABEL_ACCURACY = 3e-7
"""Relative error of the optima that Clarabel proposes; two of 50,000 had 3.1e-7 and 1.6e-6.

How close the solver itself came to the optimum, the gap says."""


def agrees_with_clarabel(batch: GraspForceProblem, solver: str) -> GraspForceSolution:
    """The solver's answers; asserts that their optimum is Clarabel's, and that proofs hold.

    Clarabel's forces are taken as it proposes them, before they are moved inside the constraints.
    """
    solution = solve(batch, solver)
    exact = objective_value(batch, ClarabelSolver().propose(batch.flat()).forces)
    assert set(solution.status) <= {"optimal", "infeasible"}
    feasible = solution.status == "optimal"
    assert feasible.any()
    found, exact = solution.objective[feasible], exact[feasible]
    assert np.count_nonzero(np.abs(found - exact) > CLARABEL_ACCURACY * exact) <= 1
    np.testing.assert_allclose(found, exact, rtol=1e-5, atol=0.0)
    # of 2,500 problems with weak joints one had a gap of 2.7e-7, the next 1.9e-8
    assert np.count_nonzero(np.abs(solution.gap[feasible]) > 1e-7) <= 1
    assert np.all(proven(batch, solution)[~feasible])
    assert strict(solution, feasible)
    return solution


def strict(solution: GraspForceSolution, feasible: Any = True, rounding: float = 0.0) -> bool:
    """Every inequality holds exactly, and equilibrium to rounding, where feasible.

    Inequalities may be missed by `rounding` of the sizes of their terms, in N and m.
    """
    verdict = solution.verdict
    size = np.linalg.norm(solution.forces, axis=-1)
    own = np.abs(solution.problem.external_torque).sum(axis=-1)
    exact = (
        (verdict.friction_violation <= rounding * size)
        & (verdict.normal_violation <= rounding * size)
        & (verdict.torque_violation <= rounding * (size + own))
        & (verdict.equilibrium_residual <= EQUILIBRIUM_TOLERANCE * size)
    )
    return bool(np.all(exact | ~np.asarray(feasible)))


def proven(problem: GraspForceProblem, solution: GraspForceSolution) -> np.ndarray:
    """(...,) whether the multipliers prove that there are no forces."""
    proofs = Multipliers(solution.equilibrium_dual, solution.torque_dual)
    return np.asarray(farkas_value(problem, proofs) > FARKAS_TOLERANCE)
