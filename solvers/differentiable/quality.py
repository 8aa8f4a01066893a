"""q_lrw of normal forces as a differentiable function, in torch, for batches on any device.

q_lrw is the least, over unit wrench directions d, of the reach max_i a_i h_i(d) of the contacts
with normal forces a, h_i(d) the support function of the wrenches that contact i can apply per
newton. The directions of least reach are sought from many sides (a Sobol sequence on the sphere,
and the normals of facets where they are known) by descent of a smoothed reach; the value along the
best one found bounds q_lrw from above, and by the envelope theorem has its gradient wherever it
is exact. A lower bound takes the convex hull: `solvers.quality.verdict.quality_bounds` has both.
"""

from functools import cache

import torch
from torch import Tensor

from solvers.arguments import check_shape
from solvers.exceptions import ProblemError, SolverError
from solvers.problem import MAX_QUALITY, GraspForceProblem, as_problem
from solvers.quality.directions import spread_directions, unit_wrenches

_STARTS = 256
_KEPT = 16
_ROUNDS = 40
_STEP, _STEP_DECAY = 0.25, 0.93
_SOFTNESS, _LEAST_SOFTNESS = 0.15, 0.002
_REGULAR = 1e-9
_NO_REACH = -1e9

_SHARP_CONTACTS, _SHARP_DIRECTIONS = 0.01, 0.02
_LEAST_SCALE = 0.01


def quality_estimates(
    problem: GraspForceProblem, normal: Tensor, directions: Tensor | None = None
) -> Tensor:
    """(...,) N: q_lrw of normal forces, bounded from above; differentiable.

    Gradients reach the normal forces, the grasp map, the friction and the characteristic length.

    Args:
        problem: `max_quality` problem(s) of torch tensors.
        normal: (..., n) N >= 0.
        directions: (..., k, 6) unit wrench directions to begin the search with besides those of a
            Sobol sequence: normals of facets, or what was found for similar forces.

    Raises:
        ProblemError: for normal forces or directions of other shapes.
        SolverError: for numpy arrays, or another objective.
    """
    if as_problem(problem).objective != MAX_QUALITY or not isinstance(problem.grasp_map, Tensor):
        raise SolverError("quality is that of a max_quality problem of torch tensors")
    batch = problem.batch_shape
    check_shape("normal", normal, (*batch, problem.n_contacts))
    if directions is not None:
        check_shape("directions", directions, (*batch, *directions.shape[-2:-1], 6))
    flat = problem.reshape(-1)
    forces = torch.where(flat.contact_mask, normal.reshape(flat.friction.shape), 0.0)
    wrenches = unit_wrenches(flat)
    starts = directions
    if directions is not None:
        starts = directions.reshape(len(flat), directions.shape[-2], 6)
    with torch.no_grad():
        weakest = least_directions(wrenches, flat.friction, forces, starts)
    support, _ = contact_supports(wrenches, flat.friction, weakest, forces)
    support = support.amax(dim=-1)
    least: Tensor = support.amin(dim=-1).clamp_min(0.0)
    return least.reshape(problem.batch_shape)


def soft_least_support(
    wrenches: Tensor, friction: Tensor, directions: Tensor, normal: Tensor
) -> Tensor:
    """(B,) N: the least reach along given directions, smoothed in its gradient.

    The gradient is shared among contacts and directions within a few per cent of the weakest, which
    is what makes ascent steady; the value is their mean.

    Args:
        wrenches: (B, n, 6, 3) of unit forces, torques over the characteristic length.
        friction: (B, n).
        directions: (B, k, 6).
        normal: (B, n) N; contacts without any are left out.

    Raises:
        ProblemError: for tensors of other shapes.
    """
    support, _ = contact_supports(wrenches, friction, directions, normal)
    now = support.detach()
    best = now.amax(dim=-1)
    least = best.amin(dim=-1)
    scale = torch.maximum(least, _LEAST_SCALE * now.amax(dim=(1, 2))).clamp_min(1e-9)
    covering = torch.softmax((now - best[..., None]) / (_SHARP_CONTACTS * scale)[:, None, None], -1)
    weak = torch.softmax((least[:, None] - best) / (_SHARP_DIRECTIONS * scale)[:, None], dim=-1)
    return (weak[..., None] * covering * support).sum(dim=(1, 2))


def least_directions(
    wrenches: Tensor, friction: Tensor, normal: Tensor, starts: Tensor | None = None
) -> Tensor:
    """(B, 16, 6) unit directions of locally least reach, weakest first.

    As `solvers.compiled.quality.support`, on tensors: descent of log-sum-exp in coordinates in
    which the contacts have no preferred side, with falling softness and step.

    Args:
        wrenches: (B, n, 6, 3) of unit forces, torques over the characteristic length.
        friction: (B, n).
        normal: (B, n) N.
        starts: (B, k, 6) besides those of a Sobol sequence.

    Raises:
        ProblemError: for tensors of other shapes.
    """
    _check(wrenches, friction, normal, starts)
    scaled = wrenches * normal[..., None, None]
    scaled = torch.cat([scaled[..., :2] * friction[..., None, None], scaled[..., 2:]], dim=-1)
    columns = scaled.transpose(1, 2).flatten(2)
    metric = columns @ columns.mT
    trace = metric.diagonal(dim1=-2, dim2=-1).sum(dim=-1).clamp_min(1e-30)
    eye = torch.eye(6, dtype=metric.dtype, device=metric.device)
    factor = torch.linalg.cholesky(metric + _REGULAR * trace[:, None, None] * eye)
    inverse = torch.linalg.solve_triangular(factor, eye.expand_as(factor), upper=False)
    discs = torch.einsum("bxy,bnyk->bnxk", inverse, scaled)
    bend = inverse @ inverse.mT
    places = _sobol(_STARTS).to(metric).expand(len(normal), -1, -1)
    if starts is not None:
        given = torch.einsum("bkx,bxy->bky", starts, factor)
        places = torch.cat([places, given], dim=1)
    places = torch.nn.functional.normalize(places, dim=-1)
    pressing = normal[:, None] > 0.0
    best_value = torch.full(places.shape[:2], torch.inf).to(metric)
    best = places
    step, softness = _STEP, _SOFTNESS
    for _ in range(_ROUNDS):
        along = torch.einsum("bky,bnyx->bknx", places, discs)
        size = torch.sqrt(torch.sum(along[..., :2] ** 2, dim=-1) + 1e-30)
        load = torch.where(pressing, along[..., 2] + size, -torch.inf)
        turned = places @ bend
        square = torch.sum(turned * places, dim=-1)
        farthest = load.amax(dim=-1)
        value = farthest / torch.sqrt(square)
        better = value < best_value
        best_value = torch.where(better, value, best_value)
        best = torch.where(better[..., None], places, best)
        scale = farthest.abs().clamp_min(1e-12)
        weight = torch.softmax((load - farthest[..., None]) / (softness * scale[..., None]), dim=-1)
        pull = torch.cat(
            [along[..., :2] / size[..., None], torch.ones_like(along[..., 2:])], dim=-1
        )
        slope = torch.einsum("bkn,bnyx,bknx->bky", weight, discs, pull)
        slope = slope / scale[..., None] - turned / square[..., None]
        slope = slope - torch.sum(slope * places, dim=-1, keepdim=True) * places
        slope = torch.nn.functional.normalize(slope, dim=-1)
        places = torch.nn.functional.normalize(places - step * slope, dim=-1)
        step *= _STEP_DECAY
        softness = max(_LEAST_SOFTNESS, softness * _STEP_DECAY)
    order = torch.argsort(best_value, dim=-1)[:, :_KEPT]
    chosen = torch.take_along_dim(best, order[..., None], dim=1)
    return torch.nn.functional.normalize(chosen @ inverse, dim=-1)


def contact_supports(
    wrenches: Tensor, friction: Tensor, directions: Tensor, normal: Tensor
) -> tuple[Tensor, Tensor]:
    """How far contacts reach, (B, k, n) N, and the normal's part of it per newton, (B, k, n).

    Args:
        wrenches: (B, n, 6, 3) of unit forces, torques over the characteristic length.
        friction: (B, n).
        directions: (B, k, 6).
        normal: (B, n) N; the reach of contacts without any is a very negative number.

    Raises:
        ProblemError: for tensors of other shapes.
    """
    _check(wrenches, friction, normal, directions)
    along = torch.einsum("bkd,bndx->bknx", directions, wrenches)
    size = torch.sqrt(torch.sum(along[..., :2] ** 2, dim=-1) + 1e-30)
    support = normal[:, None] * (along[..., 2] + friction[:, None] * size)
    return torch.where(normal[:, None] > 0.0, support, _NO_REACH), along[..., 2]


def _check(wrenches: Tensor, friction: Tensor, normal: Tensor, directions: Tensor | None) -> None:
    """Refuse tensors that are not those of one batch of contacts."""
    batch = tuple(friction.shape)
    if len(batch) != 2:
        raise ProblemError(f"friction has shape {batch} but must have (B, n)")
    check_shape("normal", normal, batch)
    check_shape("wrenches", wrenches, (*batch, 6, 3))
    if directions is not None:
        check_shape("directions", directions, (batch[0], *directions.shape[1:2], 6))


@cache
def _sobol(count: int) -> Tensor:
    return torch.as_tensor(spread_directions(count))
