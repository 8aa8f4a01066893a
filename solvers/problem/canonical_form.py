"""The canonical form of a problem: force space, free of units, object frame and length."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from .definition import GraspForceProblem, as_problem
from .multipliers import Multipliers
from .scaling import balanced_grasp_map, balanced_wrench, force_scale, moment_arm

_SMALLEST_COLUMN = 1e-3
"""Joints that no contact moves keep a finite scale: this share of the largest column of J_h."""


@dataclass(frozen=True, eq=False)
class CanonicalProblem:
    """A problem in force space, and the way back.

    With G' = Q R (thin QR; torque rows first divided by the moment arm), s the force scale and c_j
    the norm of column j of J_h, the problem in the forces f / s has the grasp map Q', the Jacobian
    columns J_j / c_j, the torque limits (limit - tau_ext) / (c_j s) and no external torque. It
    depends on the object's frame only through the choice of Q, an orthogonal matrix on the right,
    which cancels in everything that is made of Q Q' = P.

    Args:
        problem: the scaled problem; its external wrench is -Q' f_p with f_p = -G^+ w / s.
        scale: (...,) s in N, see `solvers.problem.force_scale`.
        joint_scale: (..., n_tau) c_j in m.
        factor: (..., 6, 6) R.
        row_scale: (..., 6) what the rows of G were multiplied by: 1, and 1 / moment arm.
    """

    problem: GraspForceProblem
    scale: Any
    joint_scale: Any
    factor: Any
    row_scale: Any

    def __getitem__(self, index: Any) -> "CanonicalProblem":
        """The problems at `index` of the batch dimensions."""
        return CanonicalProblem(*(part[index] for part in vars(self).values()))

    def multipliers(self, scaled: Multipliers) -> Multipliers:
        """nu and lambda in the original problem's units from those of the scaled problem."""
        xp = self.problem.xp
        rows = xp.linalg.solve(self.factor, scaled.equilibrium[..., None])[..., 0]
        return Multipliers(
            self.scale[..., None] * self.row_scale * rows,
            self.scale[..., None] * scaled.torque / self.joint_scale,
        )

    def scaled(self, multipliers: Multipliers) -> Multipliers:
        """Those of the scaled problem from multipliers in the original problem's units."""
        scale = self.scale[..., None]
        rows = multipliers.equilibrium / (scale * self.row_scale)
        return Multipliers(
            (self.factor @ rows[..., None])[..., 0],
            multipliers.torque * self.joint_scale / scale,
        )


def canonical(
    problem: GraspForceProblem, qr: Callable[[Any], tuple[Any, Any]] | None = None
) -> CanonicalProblem:
    """The canonical form of `min_norm` problem(s), numpy or torch, batched or single.

    Args:
        problem: the problem(s).
        qr: thin QR factorisation of (..., 3n, 6); that of the array's library by default.
    """
    xp = as_problem(problem).xp
    scale = force_scale(problem)
    arm = moment_arm(problem)[..., None]
    row_scale = xp.concat([xp.ones_like(arm)] * 3 + [1.0 / arm] * 3, axis=-1)
    transposed = xp.linalg.matrix_transpose(balanced_grasp_map(problem))
    basis, factor = (qr or xp.linalg.qr)(transposed)
    wrench = balanced_wrench(problem, problem.external_wrench) / scale[..., None]
    wrench = xp.linalg.solve(xp.linalg.matrix_transpose(factor), wrench[..., None])[..., 0]

    if problem.n_joints:
        columns = xp.sqrt(xp.sum(problem.hand_jacobian**2, axis=-2))
        least = _SMALLEST_COLUMN * xp.max(columns, axis=-1, keepdims=True)
        joint_scale = xp.where(columns > least, columns, least)
        joint_scale = xp.where(joint_scale > 0, joint_scale, xp.ones_like(joint_scale))
    else:
        joint_scale = xp.ones_like(problem.torque_min)
    unit = joint_scale * scale[..., None]
    arrays = {
        "grasp_map": xp.linalg.matrix_transpose(basis),
        "hand_jacobian": problem.hand_jacobian / joint_scale[..., None, :],
        "friction": problem.friction,
        "torque_min": (problem.torque_min - problem.external_torque) / unit,
        "torque_max": (problem.torque_max - problem.external_torque) / unit,
        "external_wrench": wrench,
        "external_torque": xp.zeros_like(problem.external_torque),
        "normal_min": problem.normal_min / scale[..., None],
        "normal_max": problem.normal_max / scale[..., None],
        "contact_mask": problem.contact_mask,
    }
    return CanonicalProblem(problem.derived(**arrays), scale, joint_scale, factor, row_scale)
