"""How far forces are from satisfying a problem.

Solutions, evaluation, benchmark and test oracle call these; the judge measures the same apart
(`solvers.compiled.judge.measure`), and tests compare the two. They accept numpy or torch, batched
or single, and ignore padding contacts. Forces are (..., 3n) N; a `ProblemError` says so where they
have another shape.
"""

from types import ModuleType
from typing import Any

from solvers.arguments import check_vectors

from .definition import GraspForceProblem, as_problem
from .scaling import least_force


def per_contact(vectors: Any) -> Any:
    """(..., 3n) stacked contact vectors as (..., n, 3), components (t1, t2, n)."""
    return vectors.reshape((*vectors.shape[:-1], vectors.shape[-1] // 3, 3))


def apply(matrix: Any, vector: Any) -> Any:
    """Matrix times vector over leading batch dimensions."""
    return (matrix @ vector[..., None])[..., 0]


def apply_transposed(matrix: Any, vector: Any) -> Any:
    """Transposed matrix times vector over leading batch dimensions."""
    return (vector[..., None, :] @ matrix)[..., 0, :]


def contact_wrench(problem: GraspForceProblem, forces: Any) -> Any:
    """(..., 6) G f: what the contacts apply to the object, N and N·m about the centre of mass."""
    _check_forces(problem, forces)
    return apply(problem.grasp_map, forces)


def joint_torques(problem: GraspForceProblem, forces: Any) -> Any:
    """(..., n_tau) J_h' f + tau_ext: what the joints must supply, N·m."""
    _check_forces(problem, forces)
    return apply_transposed(problem.hand_jacobian, forces) + problem.external_torque


def equilibrium_residual(problem: GraspForceProblem, forces: Any) -> Any:
    """(...,) N: size of the smallest change of the forces that would make G f = -w hold.

    Measuring the wrench error by the forces that cancel it keeps N and N·m apart, and makes the
    number independent of the object frame and of the unit of length.
    """
    error = contact_wrench(problem, forces) + problem.external_wrench
    return problem.xp.linalg.vector_norm(least_force(problem, error), axis=-1)


def friction_violation(problem: GraspForceProblem, forces: Any) -> Any:
    """(...,) N: largest excess of a tangential force over mu times its normal force; 0 inside."""
    _check_forces(problem, forces)
    xp = problem.xp
    force = per_contact(forces)
    excess = tangential_size(xp, force) - problem.friction * force[..., 2]
    return _worst(problem, excess, problem.contact_mask)


def normal_violation(problem: GraspForceProblem, forces: Any) -> Any:
    """(...,) N: largest shortfall from the preload or excess over the cap; 0 inside."""
    _check_forces(problem, forces)
    normal = per_contact(forces)[..., 2]
    xp = problem.xp
    excess = xp.maximum(problem.normal_min - normal, normal - problem.normal_max)
    return _worst(problem, excess, problem.contact_mask)


def torque_violation(problem: GraspForceProblem, forces: Any) -> Any:
    """(...,) N·m: largest excess of a joint torque over its limits; 0 inside."""
    xp = problem.xp
    torque = joint_torques(problem, forces)
    if problem.n_joints == 0:
        return xp.zeros_like(forces[..., 0])
    excess = xp.maximum(torque - problem.torque_max, problem.torque_min - torque)
    return _worst(problem, excess, None)


def objective_value(problem: GraspForceProblem, forces: Any) -> Any:
    """(...,) the objective at `forces`: N^2 for `min_norm`, N for the two linear ones."""
    _check_forces(problem, forces)
    xp = problem.xp
    force = per_contact(forces)
    if problem.objective == "min_max_normal":
        lowest = xp.full_like(force[..., 2], -xp.inf)
        return xp.max(xp.where(problem.contact_mask, force[..., 2], lowest), axis=-1)
    force = xp.where(problem.contact_mask[..., None], force, xp.zeros_like(force))
    if problem.objective == "min_norm":
        return 0.5 * xp.sum(force**2, axis=(-2, -1))
    return xp.sum(force[..., 2], axis=-1)


def needs_no_force(problem: GraspForceProblem) -> Any:
    """(...,) bool: zero forces hold, without any tolerance, and are optimal for every objective."""
    xp = problem.xp
    torque = problem.external_torque
    within = xp.all((problem.torque_min <= torque) & (torque <= problem.torque_max), axis=-1)
    load = xp.any(problem.external_wrench != 0.0, axis=-1)
    preload = xp.any((problem.normal_min > 0.0) & problem.contact_mask, axis=-1)
    return within & ~load & ~preload


def tangential_size(xp: ModuleType, vectors: Any) -> Any:
    """(...) length of the first two components of (..., 3), with gradient zero where it is zero.

    The square root alone has no gradient there, and every padding contact is there.
    """
    square = vectors[..., 0] ** 2 + vectors[..., 1] ** 2
    positive = square > 0
    root = xp.sqrt(xp.where(positive, square, xp.ones_like(square)))
    return xp.where(positive, root, xp.zeros_like(root))


def _check_forces(problem: GraspForceProblem, forces: Any) -> None:
    count = 3 * as_problem(problem).n_contacts
    check_vectors("forces", forces, problem.batch_shape, (count,))


def _worst(problem: GraspForceProblem, excess: Any, mask: Any) -> Any:
    xp = problem.xp
    if mask is not None:
        excess = xp.where(mask, excess, xp.zeros_like(excess))
    worst = xp.max(excess, axis=-1)
    return xp.where(worst > 0, worst, xp.zeros_like(worst))
