"""Friction cones cut at preload and cap: projection, its Jacobian, least slope.

Numpy or torch, batched or single. The kernels project for themselves, in the lanes of
`solvers.compiled.newton.projection`, and the judge in `solvers.compiled.judge.measure`.
"""

from typing import Any

from array_api_compat import array_namespace

from solvers.arguments import check_vectors
from solvers.problem import GraspForceProblem, tangential_size


def project_cones(problem: GraspForceProblem, points: Any) -> Any:
    """(..., n, 3) Euclidean projection on the friction cones cut at preload and cap.

    Closed form: given the normal force b, the best tangential size is min(a, mu b); what remains is
    convex in b alone, so the unconstrained best b is clipped. Padding contacts project to zero.
    """
    _check_per_contact(problem, "points", points)
    xp = problem.xp
    mu = problem.friction
    size = tangential_size(xp, points)
    normal = points[..., 2]
    on_cone = (normal + mu * size) / (1.0 + mu**2)
    best = xp.where(size <= mu * normal, normal, on_cone)
    best = xp.minimum(xp.maximum(best, problem.normal_min), problem.normal_max)
    best = xp.where(problem.contact_mask, best, xp.zeros_like(best))
    room = mu * best
    inside = size <= room
    ratio = xp.where(inside, xp.ones_like(size), room / xp.where(inside, xp.ones_like(size), size))
    masked = xp.astype(problem.contact_mask, points.dtype)
    return xp.concat([points[..., :2] * (ratio * masked)[..., None], best[..., None]], axis=-1)


def projection_jacobian(problem: GraspForceProblem, points: Any) -> Any:
    """(..., n, 3, 3) symmetric Jacobian of `project_cones`; at a kink, that of one of its sides.

    Inside the cone the identity; on it, with u the tangential direction and b the projected normal
    force, the tangential part keeps (mu b / |t|) (I - u u') and moves with b along u.
    """
    _check_per_contact(problem, "points", points)
    xp = problem.xp
    mu, normal = problem.friction, points[..., 2]
    size = tangential_size(xp, points)
    zero, one = xp.zeros_like(size), xp.ones_like(size)
    safe = xp.where(size > 0, size, one)
    best = xp.where(size <= mu * normal, normal, (normal + mu * size) / (1.0 + mu**2))
    clipped = xp.minimum(xp.maximum(best, problem.normal_min), problem.normal_max)
    free = (clipped == best) & problem.contact_mask
    inside = (size <= mu * clipped) & problem.contact_mask
    sliding = problem.contact_mask & ~inside
    # on the cone f = (mu b u, b), and b moves along (mu u, 1) / (1 + mu^2) unless it is clipped
    gain = xp.where(free & sliding, one / (1.0 + mu**2), zero)
    across = xp.where(inside, one, xp.where(sliding, mu * clipped / safe, zero))
    along = xp.where(inside, one, gain * mu**2)
    stretch = along - across
    coupling = gain * mu
    u1, u2 = points[..., 0] / safe, points[..., 1] / safe
    entries = [
        across + stretch * u1**2,
        stretch * u1 * u2,
        coupling * u1,
        stretch * u1 * u2,
        across + stretch * u2**2,
        coupling * u2,
        coupling * u1,
        coupling * u2,
        xp.where(inside & free, one, gain),
    ]
    return xp.reshape(xp.stack(entries, axis=-1), (*size.shape, 3, 3))


def in_metric(rows: Any, blocks: Any) -> Any:
    """(..., k, 3n) rows (..., k, 3n) times the block-diagonal matrix of `blocks` (..., n, 3, 3)."""
    *batch, k, width = rows.shape
    xp = array_namespace(rows)
    per_contact_rows = xp.moveaxis(xp.reshape(rows, (*batch, k, width // 3, 3)), -2, -3)
    return xp.reshape(xp.moveaxis(per_contact_rows @ blocks, -3, -2), (*batch, k, width))


def cone_slope(problem: GraspForceProblem, prices: Any) -> Any:
    """(..., n) least value of q_i' f over the cone's slice with f_n = 1."""
    _check_per_contact(problem, "prices", prices)
    return prices[..., 2] - problem.friction * tangential_size(problem.xp, prices)


def _check_per_contact(problem: GraspForceProblem, name: str, vectors: Any) -> None:
    check_vectors(name, vectors, problem.batch_shape, (problem.n_contacts, 3))
