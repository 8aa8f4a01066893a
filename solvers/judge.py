"""The independent judge: float64 verdicts on any answer to a problem, whoever gave it."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from . import residuals
from .certificates import Multipliers, dual_bound, farkas_value
from .problem import GraspForceProblem
from .scaling import force_scale

FEASIBILITY_TOLERANCE = 1e-8
"""Largest violation of a constraint, relative to the size of the forces, in a feasible answer."""

GAP_TOLERANCE = 1e-6
"""Largest relative gap between objective and dual bound in an optimal answer."""

FARKAS_TOLERANCE = 1e-9
"""Least relative Farkas value that counts as a proof: far above float64 rounding."""

LARGEST_NUMBER = 1e100
"""N and so on: nothing physical is larger, and its square must not overflow."""


class Status(StrEnum):
    """What is known about an answer."""

    OPTIMAL = "optimal"
    """All constraints hold and the dual bound proves the objective best, within tolerances."""
    FEASIBLE = "feasible"
    """All constraints hold; the gap says how far from the best the objective can be."""
    INFEASIBLE = "infeasible"
    """No forces satisfy the constraints; the multipliers are a Farkas certificate of that. Where a
    contact has no cap: no forces below `certificates.FORCE_HORIZON` times the problem's scale."""
    FAILED = "failed"
    """Neither feasible forces nor a proof that there are none; the message says why."""


@dataclass(frozen=True, eq=False)
class Verdict:
    """The judge's measurements of one answer or of a batch of them, float64; all arrays are (...,).

    Args:
        status: strings, the values of `Status`.
        equilibrium_residual: N, see `solvers.residuals`.
        friction_violation: N.
        normal_violation: N.
        torque_violation: N·m.
        objective: objective at the forces; NaN unless they are feasible.
        dual_bound: lower bound on the optimum from the multipliers.
        gap: (objective - dual_bound) / |objective|; NaN unless the forces are feasible. Slightly
            negative where they use the tolerance of the constraints; far below zero is not optimal.
        farkas_value: > `FARKAS_TOLERANCE` proves infeasibility.
    """

    status: np.ndarray
    equilibrium_residual: np.ndarray
    friction_violation: np.ndarray
    normal_violation: np.ndarray
    torque_violation: np.ndarray
    objective: np.ndarray
    dual_bound: np.ndarray
    gap: np.ndarray
    farkas_value: np.ndarray


def judge(problem: GraspForceProblem, forces: np.ndarray, multipliers: Multipliers) -> Verdict:
    """Measure forces and multipliers against the problem, trusting nothing that a solver said.

    Violations of torque limits count relative to the largest torque that a force of the problem's
    size causes through its Jacobian. Forces or multipliers that are NaN or beyond `LARGEST_NUMBER`
    are no answer and prove nothing; forces at padding contacts count as zero.

    Args:
        problem: numpy float64 problem(s).
        forces: (..., 3n) N.
        multipliers: nu and lambda, as in `solvers.certificates`.
    """
    answered = _bounded(forces)
    active = answered[..., None] & np.repeat(problem.contact_mask, 3, axis=-1)
    usable_forces = np.where(active, forces, 0.0)
    priced = _bounded(multipliers.equilibrium) & _bounded(multipliers.torque)
    prices = Multipliers(
        np.where(priced[..., None], multipliers.equilibrium, 0.0),
        np.where(priced[..., None], multipliers.torque, 0.0),
    )
    equilibrium = residuals.equilibrium_residual(problem, usable_forces)
    friction = residuals.friction_violation(problem, usable_forces)
    normal = residuals.normal_violation(problem, usable_forces)
    torque = residuals.torque_violation(problem, usable_forces)
    objective = residuals.objective_value(problem, usable_forces)
    bound = dual_bound(problem, prices)
    farkas = np.where(priced, farkas_value(problem, prices), 0.0)

    size = np.maximum(force_scale(problem), np.linalg.norm(usable_forces, axis=-1))
    allowed = FEASIBILITY_TOLERANCE * size
    lever = np.max(np.linalg.norm(problem.hand_jacobian, axis=-2), axis=-1, initial=0.0)
    # external torques far larger than what the forces cause are only known to rounding
    own = np.max(np.abs(problem.external_torque), axis=-1, initial=0.0)
    allowed_torque = allowed * lever + 8 * np.finfo(np.float64).eps * own
    feasible = answered & (equilibrium <= allowed) & (friction <= allowed)
    feasible &= (normal <= allowed) & (torque <= allowed_torque)
    # forces within the tolerance of zero, where no load asks for any, have no size to compare with
    least = 0.5 * allowed**2 if problem.objective == "min_norm" else allowed
    gap = np.where(feasible, (objective - bound) / np.maximum(np.abs(objective), least), np.nan)
    infeasible = ~feasible & (farkas > FARKAS_TOLERANCE)
    status = np.select(
        [feasible & (np.abs(gap) <= GAP_TOLERANCE), feasible, infeasible],
        [Status.OPTIMAL.value, Status.FEASIBLE.value, Status.INFEASIBLE.value],
        default=Status.FAILED.value,
    )

    def if_answered(values: np.ndarray) -> np.ndarray:
        return np.where(answered, values, np.nan)

    return Verdict(
        status=status,
        equilibrium_residual=if_answered(equilibrium),
        friction_violation=if_answered(friction),
        normal_violation=if_answered(normal),
        torque_violation=if_answered(torque),
        objective=np.where(feasible, objective, np.nan),
        dual_bound=bound,
        gap=gap,
        farkas_value=farkas,
    )


def _bounded(vectors: np.ndarray) -> np.ndarray:
    """(...,) True where a vector holds neither NaN nor absurdly large numbers."""
    return np.asarray(np.all(np.abs(vectors) <= LARGEST_NUMBER, axis=-1))
