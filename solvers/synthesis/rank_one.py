"""Where to press, and how hard: contact positions and forces together, by a sequence of SDPs."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from solvers.arguments import plain_array
from solvers.arrays import Array
from solvers.conic import POSITIVE, SECOND_ORDER, solve
from solvers.exceptions import SolverError
from solvers.judge import judge
from solvers.problem import GraspForceProblem, Multipliers

from .facets import ContactFacets
from .lifted import (
    GRASP_MATRIX_FLOOR,
    INTERIOR_FRICTION,
    INTERIOR_PRELOAD,
    LiftedPoint,
    LiftedSynthesis,
)

RANK_ONE = 1e-4
"""Second over first eigenvalue of every block of M below which M counts as of rank one."""

RESIDUAL = 1e-6
"""Largest violation, relative to the forces, that the judge may find in a solved synthesis."""

_TARGET_RATIO = 1e-9
_MAX_STEPS = 50
_FIRST_PENALTY = 0.005
_PENALTY_GROWTH = 1.2
_PROOF_MARGIN = 1e-7


class SynthesisStatus(StrEnum):
    """How a synthesis ended."""

    SOLVED = "solved"
    """Rank one, and every constraint holds, as the judge measured it."""
    INFEASIBLE = "infeasible"
    """No positions on these facets admit the internal forces, with the margins that
    `LiftedSynthesis` asks of them; `separating_wrench` proves it."""
    FAILED = "failed"
    """Neither; the message says why."""


@dataclass(frozen=True, eq=False)
class ContactSynthesis:
    """Contacts on facets, with the forces that hold the object there.

    Args:
        status: decided by the judge's residual and the rank, not by the solver's words.
        positions: (n, 3) m, object frame; NaN unless there is a point.
        forces: (1 + K, 3n) N per mean N of normal force, in the facets' frames; row 0 internal.
        reach: load along every d_k that one newton of total normal force carries.
        relaxation: upper bound on the reach over all positions on these facets that admit the
            internal forces, as accurate as Clarabel.
        eigenvalue_ratio: largest second over first eigenvalue of the blocks of M.
        residual: largest violation that the judge found, relative to the forces.
        steps: semidefinite programs that were solved.
        separating_wrench: (6,) proof of infeasibility, torques over the facets' length; else NaN.
        message: why it failed; else "".
    """

    status: SynthesisStatus
    positions: Array
    forces: Array
    reach: float
    relaxation: float
    eigenvalue_ratio: float
    residual: float
    steps: int
    separating_wrench: Array
    message: str


def synthesise(facets: ContactFacets, loads: Array) -> ContactSynthesis:
    """Contact positions on `facets` and forces that carry as much as they can of every load.

    First the relaxation without the rank; then a sequence of semidefinite programs, each of which
    pays for what M has beyond the point of the one before, ever more dearly (after Dai, Majumdar
    and Tedrake 2018, and Ibaraki and Tomizuka, "Rank minimization approach for solving BMI problems
    with random search", 2001). It is a local method; `relaxation` bounds what it may have missed.

    Args:
        facets: one for each contact.
        loads: (K, 6) directions d_k of the wrenches to balance, torques over the facets' length. An
            internal force strictly inside the cones is always part of the problem, and without
            loads all of it.

    Raises:
        ProblemError: from the loads.
    """
    program = LiftedSynthesis(facets, loads)
    loads = program.loads
    try:
        point = program.solve()
    except SolverError as error:
        return _without_point(facets, len(loads), str(error))
    relaxation, steps, penalty = point.reach, 1, _FIRST_PENALTY
    message = ""
    while point.eigenvalue_ratio > _TARGET_RATIO and steps <= _MAX_STEPS:
        try:
            point = program.solve(towards=point, penalty=penalty)
        except SolverError as error:
            message = str(error)
            break
        steps += 1
        penalty *= _PENALTY_GROWTH
    positions = facets.positions(point.local)
    ratio = point.eigenvalue_ratio
    residual = _judged(facets, point, loads)
    solved = ratio <= RANK_ONE and residual <= RESIDUAL
    if not solved and not message:
        message = f"eigenvalue ratio {ratio:.1e} and residual {residual:.1e} after {steps} steps"
    return ContactSynthesis(
        status=SynthesisStatus.SOLVED if solved else SynthesisStatus.FAILED,
        positions=positions,
        forces=point.forces.swapaxes(0, 1).reshape(1 + len(loads), -1),
        reach=point.reach if len(loads) else np.nan,
        relaxation=relaxation if len(loads) else np.nan,
        eigenvalue_ratio=ratio,
        residual=residual,
        steps=steps,
        separating_wrench=np.full(6, np.nan),
        message="" if solved else message,
    )


def separating_wrench(facets: ContactFacets) -> Array | None:
    """A proof that no positions on the facets admit strictly interior internal forces, or None.

    It is the direction (6,), torques over the facets' length, that makes `internal_work` least; it
    proves infeasibility if that is negative.
    """
    n = len(facets)
    rows, bounds, cones = [], [], []
    # variables: d (6), the reach a_i of each contact (n), the largest of them b, |d| <= 1
    for contact in range(n):
        weight = INTERIOR_FRICTION * facets.friction[contact]
        for corner in facets.corner_maps(contact):
            row = np.zeros((3, 7 + n))
            row[0, :6], row[0, 6 + contact] = corner[:, 2], -1.0
            row[1:, :6] = weight * corner[:, :2].T
            rows.append(row)
            bounds.append(np.zeros(3))
            cones.append(SECOND_ORDER(3))
    order = np.zeros((n, 7 + n))
    order[:, 6 : 6 + n] = np.eye(n)
    order[:, -1] = -1.0
    ball = np.zeros((7, 7 + n))
    ball[1:, :6] = np.eye(6)
    rows += [order, ball]
    bounds += [np.zeros(n), np.eye(7)[0]]
    cones += [POSITIVE(n), SECOND_ORDER(7)]
    cost = np.concatenate([np.zeros(6), np.full(n, INTERIOR_PRELOAD), [n * (1 - INTERIOR_PRELOAD)]])
    outcome = solve(None, cost, np.vstack(rows), np.concatenate(bounds), cones)
    # whatever Clarabel says: the direction is judged by the work itself
    direction = outcome.x[:6]
    size = np.linalg.norm(direction)
    if not np.isfinite(size) or size < 0.5:
        return None
    direction = direction / size
    return direction if internal_work(facets, direction) < -_PROOF_MARGIN else None


def internal_work(facets: ContactFacets, direction: Array) -> float:
    """The most that permitted internal forces can push along a wrench direction (6,).

    Over all positions on the facets, and all forces with a total normal force of n, at least 0.05
    at each contact, within 0.95 mu. If it is negative, no such forces cancel: force is linear in
    the position on a flat facet, so that its extremes are at the corners.
    """
    direction = plain_array("direction", direction, (6,))
    reach = []
    for contact in range(len(facets)):
        pushes = np.einsum("d,kdc->kc", direction, facets.corner_maps(contact))
        tangential = np.linalg.norm(pushes[:, :2], axis=1)
        share = INTERIOR_FRICTION * facets.friction[contact]
        reach.append(float((pushes[:, 2] + share * tangential).max()))
    rest = len(facets) * (1.0 - INTERIOR_PRELOAD)
    return INTERIOR_PRELOAD * sum(reach) + rest * max(reach)


def force_problems(
    facets: ContactFacets, positions: Array, wrenches: Array, objective: str = "min_norm"
) -> GraspForceProblem:
    """A batch of grasp force problems at given positions, without a hand: one for each wrench.

    Args:
        facets: for friction and contact frames.
        positions: (n, 3) m on the facets.
        wrenches: (K, 6) N, what the forces must produce: G f; torques over the facets' length.
        objective: of the problems.
    """
    wrenches = plain_array("wrenches", wrenches, (np.shape(wrenches)[0], 6))
    positions = plain_array("positions", positions, (len(facets), 3))
    n, count = len(facets), len(wrenches)
    units = np.repeat([1.0, facets.length], 3)
    return GraspForceProblem(
        grasp_map=facets.grasp_map(positions),
        hand_jacobian=np.zeros((3 * n, 0)),
        friction=facets.friction,
        torque_min=np.zeros((count, 0)),
        torque_max=np.zeros((count, 0)),
        external_wrench=-units * wrenches,
        objective=objective,
    )


def _judged(facets: ContactFacets, point: LiftedPoint, loads: Array) -> float:
    """Largest violation of any constraint, relative to the forces.

    The judge measures balance and friction; what else the synthesis asks for is measured here.
    """
    n, positions = len(facets), facets.positions(point.local)
    grasp_map = facets.grasp_map(positions) / np.repeat([1.0, facets.length], 3)[:, None]
    rank_shortfall = GRASP_MATRIX_FLOOR - float(np.linalg.eigvalsh(grasp_map @ grasp_map.T)[0])
    if rank_shortfall > RESIDUAL:  # and with too low a rank there is no problem to judge
        return rank_shortfall
    carried = n * point.reach * loads if len(loads) else loads
    wrenches = np.vstack([np.zeros(6), carried])
    problems = force_problems(facets, positions, wrenches)
    forces = point.forces.swapaxes(0, 1).reshape(len(wrenches), -1)
    none = Multipliers(np.full((len(wrenches), 6), np.nan), np.zeros((len(wrenches), 0)))
    verdict = judge(problems, forces, none)
    size = np.linalg.norm(forces, axis=1)
    worst = np.maximum(verdict.equilibrium_residual, verdict.friction_violation)
    worst = np.maximum(worst, verdict.normal_violation)
    off_facet = max(
        float((sides @ local - bounds).max())
        for (sides, bounds), local in zip(facets.sides, point.local, strict=True)
    )
    internal = point.forces[:, 0]
    shortfall = INTERIOR_PRELOAD - float(internal[:, 2].min())
    permitted = INTERIOR_FRICTION * facets.friction * internal[:, 2]
    slip = float((np.linalg.norm(internal[:, :2], axis=1) - permitted).max()) / size[0]
    return max(float((worst / size).max()), rank_shortfall, off_facet, shortfall, slip)


def _without_point(facets: ContactFacets, loads: int, message: str) -> ContactSynthesis:
    proof = separating_wrench(facets)
    n = len(facets)
    return ContactSynthesis(
        status=SynthesisStatus.FAILED if proof is None else SynthesisStatus.INFEASIBLE,
        positions=np.full((n, 3), np.nan),
        forces=np.full((1 + loads, 3 * n), np.nan),
        reach=np.nan,
        relaxation=np.nan,
        eigenvalue_ratio=np.nan,
        residual=np.nan,
        steps=1,
        separating_wrench=np.full(6, np.nan) if proof is None else proof,
        message=message if proof is None else "",
    )
