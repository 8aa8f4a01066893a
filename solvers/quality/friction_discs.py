"""The wrenches that contacts can apply, as discs, and how far their convex hull reaches."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from solvers.arrays import Array

# Reaches below this fraction of the largest wrench count as zero. Without it round-off (1e-14) or
# the perturbation below (2.5e-9) would decide on force closure where the hull passes exactly
# through the origin.
_ZERO = 1e-8

# The wrenches of one contact lie in one plane, so the facets of the hull are not simplices. Merging
# them costs Qhull half of its time, and on some inputs it fails ("topology error"). Every wrench is
# therefore moved by a fixed pseudo-random vector, each component below this fraction of the largest
# wrench; the lower bound gives away the largest distance that a wrench can have moved.
_PERTURBATION = 1e-9

_MAX_ROUNDS = 40
_FACETS_PER_ROUND = 4
_RIM_DIGITS = 6
_WEAKEST = 60


@dataclass(frozen=True)
class FrictionDiscs:
    """What contacts can apply at their given normal forces: {centre + span u : |u| <= 1} for each.

    centres: (n, 6) wrenches of the normal forces alone.
    spans: (n, 6, 2) wrenches of the largest friction along each tangent.
    """

    centres: Array
    spans: Array

    @classmethod
    def of_contacts(
        cls, positions: Array, normals: Array, friction: Array, forces: Array, length: float
    ) -> "FrictionDiscs":
        """Discs of `forces` (n,) at contacts as in `gfo_env.contacts.quality`; `length` > 0."""
        least_aligned = np.eye(3)[np.abs(normals).argmin(axis=1)]
        tangents = np.cross(normals, least_aligned)
        tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
        directions = np.stack([normals, tangents, np.cross(normals, tangents)], axis=2)
        torques = np.cross(positions[:, :, None], directions, axis=1) / length
        wrenches = np.concatenate([directions, torques], axis=1) * forces[:, None, None]
        return cls(wrenches[:, :, 0], wrenches[:, :, 1:] * friction[:, None, None])

    @classmethod
    def of_grasp_map(
        cls, grasp_map: Array, friction: Array, forces: Array, length: float
    ) -> "FrictionDiscs":
        """The same from G (6, 3n), whose tangents these are; torques are divided by `length`."""
        wrenches = grasp_map / np.repeat([1.0, length], 3)[:, None]
        wrenches = wrenches.reshape(6, -1, 3).transpose(1, 0, 2) * forces[:, None, None]
        return cls(wrenches[:, :, 2], wrenches[:, :, :2] * friction[:, None, None])

    def __getitem__(self, contacts: NDArray[np.bool_]) -> "FrictionDiscs":
        """The discs of some contacts."""
        return FrictionDiscs(self.centres[contacts], self.spans[contacts])

    def scaled(self, factors: Array) -> "FrictionDiscs":
        """The discs with those of contact i `factors[i]` times as large."""
        return FrictionDiscs(self.centres * factors[:, None], self.spans * factors[:, None, None])

    def pyramids(self, edges: int) -> tuple[Array, NDArray[np.int_]]:
        """Primitive wrenches (k, 6) of inscribed pyramids, and how many each contact has (n,)."""
        angles = 2 * np.pi * np.arange(edges) / edges
        rim = np.stack([np.cos(angles), np.sin(angles)])
        wrenches = self.centres[:, :, None] + self.spans @ rim
        frictionless = ~self.spans.any(axis=(1, 2))
        rims = wrenches[~frictionless].transpose(0, 2, 1).reshape(-1, 6)
        counts = np.where(frictionless, 1, edges)
        return np.concatenate([rims, self.centres[frictionless]]), counts

    def support(self, directions: Array) -> Array:
        """Support function of each disc (k, n) along `directions` (k, 6)."""
        along_spans = np.einsum("kd,ndt->knt", directions, self.spans)
        return directions @ self.centres.T + np.linalg.norm(along_spans, axis=2)

    def farthest_rim_point(self, direction: Array, contact: int) -> Array:
        """Where on its rim, u (2,), `contact` reaches farthest; it must have friction."""
        along_spans = direction @ self.spans[contact]
        return np.asarray(along_spans / np.linalg.norm(along_spans))


@dataclass(frozen=True)
class SupportBounds:
    """What is known about q_lrw.

    Args:
        lower: bound, of inscribed pyramids.
        upper: bound, the least reach of the true cones along the directions that were tried.
        edges: the most on a cone.
        directions: (k, 6) unit wrench directions along which the cones reach least far, weakest
            first; none where the wrenches do not span all six dimensions.
    """

    lower: float
    upper: float
    edges: int
    directions: Array


def support_bounds(
    discs: FrictionDiscs, edges: int, finished: Callable[[float, float], bool]
) -> SupportBounds:
    """Bounds of q_lrw, refined until `finished` says of lower and upper that they will do.

    Each round adds, at the facets of the hull that lie nearest to the origin, the wrench of the
    true cones that reaches farthest beyond the facet. That raises the lower bound where it is
    attained; doubling the edges of every cone would multiply the facets everywhere else too.
    """
    if len(discs.centres) == 0:
        return SupportBounds(0.0, 0.0, edges, np.zeros((0, 6)))
    wrenches, counts = discs.pyramids(edges)
    scale = float(np.linalg.norm(wrenches, axis=1).max())
    if not spans_all_wrenches(wrenches):
        return SupportBounds(0.0, 0.0, edges, np.zeros((0, 6)))
    zero = _ZERO * scale
    lower, upper = 0.0, np.inf
    for _ in range(_MAX_ROUNDS):
        facets, offsets = _hull_facets(wrenches, scale)
        offsets -= np.sqrt(6) * _PERTURBATION * scale
        lower = float(offsets[0])
        if lower <= zero:
            lower = 0.0
            # Facets through the origin touch cones that bulge beyond them; the mean of their
            # normals leans away from all cones, and so tells when even the true ones do not close.
            leaning = facets[offsets <= zero].mean(axis=0)
            facets = np.vstack([leaning / np.linalg.norm(leaning), facets])
            offsets = np.concatenate([[0.0], offsets])
        # No cone reaches less far along a facet's normal than the facet itself, so facets beyond a
        # known upper bound cannot improve it.
        upper = min(upper, float(discs.support(facets[:1]).max()))
        near = offsets <= max(upper, offsets[0])
        facets, offsets, support = facets[near], offsets[near], discs.support(facets[near])
        upper = min(upper, float(support.max(axis=1).min()))
        if upper <= zero:
            upper = 0.0
        if finished(lower, upper):
            break
        added: dict[tuple[int, bytes], Array] = {}
        for facet in np.flatnonzero(support.max(axis=1) > offsets + zero):
            contact = int(support[facet].argmax())
            rim_point = discs.farthest_rim_point(facets[facet], contact)
            # Qhull splits a flat facet into several, which would all ask for the same wrench.
            key = contact, rim_point.round(_RIM_DIGITS).tobytes()
            added[key] = discs.centres[contact] + discs.spans[contact] @ rim_point
            if len(added) == _FACETS_PER_ROUND:
                break
        if not added:
            break
        wrenches = np.vstack([wrenches, *added.values()])
        for contact, _ in added:
            counts[contact] += 1
    weakest = facets[np.argsort(support.max(axis=1))[:_WEAKEST]]
    return SupportBounds(lower, upper, int(counts.max()), weakest)


def _hull_facets(wrenches: Array, scale: float) -> tuple[Array, Array]:
    """Outward unit normals (k, 6) and offsets (k,) of the hull with the origin, nearest first."""
    points = np.vstack([np.zeros(6), wrenches])
    shift = np.random.default_rng(0).uniform(-1.0, 1.0, points.shape)
    equations = ConvexHull(points + _PERTURBATION * scale * shift).equations
    nearest_first = np.argsort(-equations[:, 6])
    return equations[nearest_first, :6], -equations[nearest_first, 6]


def spans_all_wrenches(wrenches: Array) -> bool:
    """Whether the rows (k, 6) span six dimensions, measured against the longest of them."""
    if len(wrenches) < 6:
        return False
    longest = np.linalg.norm(wrenches, axis=1).max()
    return bool(np.linalg.svd(wrenches, compute_uv=False)[-1] > _ZERO * longest)


def critical_directions(discs: FrictionDiscs, edges: int, count: int, aligned: float) -> Array:
    """Unit wrench directions (k, 6), k <= `count`, along which the hull reaches least far.

    Normals of the facets nearest to the origin, worst first, less those within a cosine of
    `aligned` of one before. The coordinate axes where the wrenches do not span all six dimensions.
    """
    wrenches, _ = discs.pyramids(edges)
    if not spans_all_wrenches(wrenches):
        return np.vstack([np.eye(6), -np.eye(6)])[:count]
    facets, _ = _hull_facets(wrenches, float(np.linalg.norm(wrenches, axis=1).max()))
    chosen = facets[:1]
    for normal in facets[1:]:
        if len(chosen) == count:
            break
        if (chosen @ normal).max() < aligned:
            chosen = np.vstack([chosen, normal])
    return chosen
