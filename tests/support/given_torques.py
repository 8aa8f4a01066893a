"""Problems with joint torques that are given: joints without motors, and what depends on them."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from solvers import GraspForceProblem
from solvers.arrays import Array, Mask
from solvers.conic import ConicProgram
from solvers.conic import solve as solve_conic
from solvers.problem import objective_value
from tests.support.problems import N_JOINTS, forces_in_cones, random_problem

KINDS = (
    "torques of known forces",
    "torques of zero",
    "any torques",
    "all torques",
    "one contact alone turns the joint",
    "two joints alike",
    "two joints nearly alike",
    "a torque that the load decides",
    "a torque that the load all but decides",
    "normal forces are given, too",
    "limits all but coincide",
)
NEARLY = ("two joints nearly alike", "a torque that the load all but decides")
"""Equations that all but depend on others: what these allow is beyond Clarabel's tolerances."""


@dataclass(frozen=True)
class Settled:
    """What Clarabel says at tolerances of 1e-10.

    Args:
        status: `optimal`, `infeasible`, or empty where it cannot tell.
        objective: of its forces; NaN unless they are optimal.
    """

    status: str
    objective: float


def settled(problem: GraspForceProblem) -> Settled:
    """Clarabel's own word on one problem: nothing is moved inside, nothing judged."""
    program = ConicProgram(problem)
    outcome = solve_conic(*program.data(), tolerance=1e-10, infeasible=1e-10)
    if outcome.status == "Solved":
        value = float(objective_value(problem, program.forces(outcome.x)))
        return Settled("optimal", value)
    return Settled("infeasible" if outcome.status == "PrimalInfeasible" else "", np.nan)


def given_torques(
    rng: np.random.Generator, kind: str, objective: str = "min_norm"
) -> GraspForceProblem:
    """A problem of one of `KINDS`, with 3 to 7 contacts.

    Forces that satisfy all of it are known, but where torques are zero or any, with which there may
    be none.
    """
    contacts = int(rng.integers(3, 8))
    drawn: dict[str, Any] = {"objective": objective}
    if rng.random() < 0.5:
        drawn["normal_max"] = np.inf
    if rng.random() < 0.3:
        drawn["normal_min"] = 0.0
    problem = random_problem(rng, contacts, **drawn)
    forces = forces_in_cones(rng, problem)
    jacobian = _jacobian(rng, kind, problem)
    external = problem.external_torque.copy()
    given = _given(rng, kind)
    if kind == "torques of zero":
        external[given] = 0.0
    torque = jacobian.T @ forces + external
    low = torque - rng.uniform(0.01, 0.5, N_JOINTS)
    high = torque + rng.uniform(0.01, 0.5, N_JOINTS)
    target = torque
    if kind == "torques of zero":
        target = np.zeros(N_JOINTS)
    elif kind == "any torques":
        target = torque + 0.05 * rng.standard_normal(N_JOINTS)
    width = np.zeros(N_JOINTS)
    if kind == "limits all but coincide":
        width = 10.0 ** rng.uniform(-17.0, -6.0, N_JOINTS)
    low[given], high[given] = (target - width)[given], (target + width)[given]
    fields: dict[str, Any] = {
        "hand_jacobian": jacobian,
        "torque_min": low,
        "torque_max": high,
        "external_torque": external,
    }
    if kind != "torques of zero":
        fields["external_wrench"] = -problem.grasp_map @ forces
    if kind == "normal forces are given, too":
        pinned = rng.random(contacts) < 0.4
        normal = np.maximum(forces[2::3], 0.0)
        fields["normal_min"] = np.where(pinned, normal, problem.normal_min)
        fields["normal_max"] = np.where(pinned, normal, problem.normal_max)
    return problem.replace(**fields)


def _jacobian(rng: np.random.Generator, kind: str, problem: GraspForceProblem) -> Array:
    jacobian = np.array(problem.hand_jacobian)
    size = len(jacobian)
    noise = 10.0 ** rng.uniform(-14.0, -4.0) * 0.05 * rng.standard_normal(size)
    if kind == "one contact alone turns the joint":
        contact = int(rng.integers(problem.n_contacts))
        jacobian[:, 0] = 0.0
        jacobian[3 * contact : 3 * contact + 3, 0] = 0.05 * rng.standard_normal(3)
    elif kind in ("two joints alike", "two joints nearly alike"):
        jacobian[:, 1] = rng.uniform(0.5, 2.0) * jacobian[:, 0]
        jacobian[:, 1] += noise if kind in NEARLY else 0.0
    elif kind in ("a torque that the load decides", "a torque that the load all but decides"):
        arm = np.array([0.03, 0.03, 0.03, 1.0, 1.0, 1.0])
        jacobian[:, 0] = problem.grasp_map.T @ (arm * rng.standard_normal(6))
        jacobian[:, 0] += noise if kind in NEARLY else 0.0
    return jacobian


def _given(rng: np.random.Generator, kind: str) -> Mask:
    given: Mask = np.zeros(N_JOINTS, dtype=np.bool_)
    given[0] = True
    if kind.startswith("two joints"):
        given[1] = True
    elif kind == "all torques":
        given[:] = True
    else:
        given |= rng.random(N_JOINTS) < 0.3
    return given
