"""What the conditioned network knows of a problem: invariant numbers and turning vectors.

Every quantity of a contact is either a scalar that no choice of coordinates changes, or a contact
vector (t1, t2, n) whose tangential part turns with the tangents. Tangential parts are only ever
combined as complex numbers, so a network built on them cannot tell one choice of tangents from
another.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from solvers.problem import CanonicalProblem, GraspForceProblem, Multipliers, apply

CONTACT_SCALARS = 7
CONTACT_VECTORS = 3
JOINT_SCALARS = 2


@dataclass(frozen=True, eq=False)
class Features:
    """Static features of a batch of B canonical problems with n contacts and n_tau joints.

    Args:
        contact_scalars: (B, n, CONTACT_SCALARS).
        contact_vectors: (B, n, 3, CONTACT_VECTORS), components (t1, t2, n).
        joint_scalars: (B, n_tau, JOINT_SCALARS).
        contact_mask: (B, n, 1) one at contacts, zero at padding.
        step: (B, 1) 1 / L, L the Lipschitz constant of the dual's gradient.
    """

    contact_scalars: Tensor
    contact_vectors: Tensor
    joint_scalars: Tensor
    contact_mask: Tensor
    step: Tensor


def turned(tangents: Tensor) -> Tensor:
    """Tangential vectors (..., 2, C) multiplied by the imaginary unit: turned by 90 degrees."""
    return torch.stack([-tangents[..., 1, :], tangents[..., 0, :]], dim=-2)


def squashed(values: Tensor) -> Tensor:
    """x / (1 + |x|), with +-1 at infinity."""
    return torch.where(values.isinf(), values.sign(), values / (1.0 + values.abs()))


def to_range(basis: Tensor, vectors: Tensor) -> Tensor:
    """P x for contact vectors (B, n, 3, C), basis (B, 6, 3n) = Q'."""
    flat = vectors.reshape(*basis.shape[:-2], basis.shape[-1], -1)
    return (basis.mT @ (basis @ flat)).reshape(vectors.shape)


def features(problem: GraspForceProblem) -> Features:
    """The static features of a batch of torch problems, canonical or in raw coordinates."""
    batch, n = problem.friction.shape
    mask = problem.contact_mask[..., None].to(problem.friction.dtype)
    blocks = problem.grasp_map.reshape(batch, 6, n, 3).permute(0, 2, 3, 1)  # (B, n, 3, 6)
    gram = blocks @ blocks.mT  # (B, n, 3, 3) diagonal blocks of P
    load = -(problem.grasp_map.mT @ problem.external_wrench[..., None]).reshape(batch, n, 3)
    coupling = gram[..., :2, 2]
    # the traceless part of the tangential block turns twice as fast: apply it to the load
    stretch = (gram[..., :2, :2] @ load[..., :2, None])[..., 0]
    zero = torch.zeros_like(mask)
    vectors = torch.stack(
        [
            load,
            torch.cat([coupling, zero], dim=-1),
            torch.cat([stretch, zero], dim=-1),
        ],
        dim=-1,
    )
    scalars = torch.stack(
        [
            gram[..., 2, 2],
            gram[..., 0, 0] + gram[..., 1, 1],
            torch.linalg.det(gram[..., :2, :2]),
            problem.friction,
            1.0 / (1.0 + 5.0 * problem.friction),
            squashed(problem.normal_min),
            squashed(problem.normal_max),
        ],
        dim=-1,
    )
    joints = torch.stack([squashed(problem.torque_min), squashed(problem.torque_max)], dim=-1)
    rows = torch.cat([problem.grasp_map, problem.hand_jacobian.mT], dim=-2)
    lipschitz = torch.linalg.eigvalsh((rows @ rows.mT).double())[..., -1:]
    return Features(
        contact_scalars=scalars * mask,
        contact_vectors=vectors * mask[..., None],
        joint_scalars=joints,
        contact_mask=mask,
        step=(1.0 / lipschitz).to(mask.dtype),
    )


def to_raw(form: CanonicalProblem, point: Multipliers) -> tuple[GraspForceProblem, Multipliers]:
    """Canonical problems and multipliers in newtons, metres and the object's frame.

    What the network sees where its configuration asks for raw coordinates; joint torques of other
    causes stay in the limits.
    """
    problem, scale, columns, factor, rows = _tensors(form)
    unit = columns * scale
    raw = problem.derived(
        grasp_map=factor.mT @ problem.grasp_map / rows[..., None],
        hand_jacobian=problem.hand_jacobian * columns[..., None, :],
        torque_min=problem.torque_min * unit,
        torque_max=problem.torque_max * unit,
        external_wrench=scale * apply(factor.mT, problem.external_wrench) / rows,
        normal_min=problem.normal_min * scale,
        normal_max=problem.normal_max * scale,
    )
    nu = scale * rows * torch.linalg.solve(factor, point.equilibrium)
    return raw, Multipliers(nu, scale * point.torque / columns)


def from_raw(form: CanonicalProblem, points: Multipliers) -> Multipliers:
    """The way back, for multipliers (..., B, 6) and (..., B, n_tau)."""
    _, scale, columns, factor, rows = _tensors(form)
    nu = apply(factor, points.equilibrium / (scale * rows))
    return Multipliers(nu, points.torque * columns / scale)


def _tensors(form: CanonicalProblem) -> tuple[GraspForceProblem, Tensor, Tensor, Tensor, Tensor]:
    """The problem, s (B, 1), c (B, n_tau), R (B, 6, 6) and the row scale (B, 6), as its tensors."""
    like = form.problem.friction

    def tensor(values: Tensor) -> Tensor:
        return torch.as_tensor(values, dtype=like.dtype, device=like.device)

    scale = tensor(form.scale)[..., None]
    return (
        form.problem,
        scale,
        tensor(form.joint_scale),
        tensor(form.factor),
        tensor(form.row_scale),
    )
