"""Facets for the tests of contact synthesis, and an oracle for the internal forces on them."""

import cvxpy as cp
import numpy as np
import trimesh

from gfo_env.objects import Patches
from solvers.arrays import Array
from solvers.synthesis import ContactFacets
from solvers.synthesis.lifted import INTERIOR_FRICTION
from tests.support.seeds import seeded
from tests.support.shapes import box

OFF_CENTRE = (0.005, -0.004, 0.003)
"""m: a centre for a box whose facets have theirs away from the foot of the origin."""

LENGTH = 0.05
X, Y, Z = np.eye(3)


def polygon(rng: np.random.Generator, corners: int, size: float) -> Array:
    """(k, 2) corners of a random convex polygon, clockwise or not."""
    gaps = 0.5 / corners + 0.5 * rng.dirichlet(np.ones(corners))
    angles = 2 * np.pi * np.cumsum(gaps)
    ring = size * np.stack([np.cos(angles), rng.uniform(0.5, 1.0) * np.sin(angles)], axis=1)
    return ring[::-1] if rng.random() < 0.5 else ring


def random_facets(seed: int, count: int, size: float = 0.015) -> ContactFacets:
    """Convex polygons around the origin: sides of a lumpy box, at most six of them."""
    rng = seeded(seed)
    outward = np.array([X, -X, Y, -Y, Z, -Z])[:count] + 0.2 * rng.normal(size=(count, 3))
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    corners = []
    for direction in outward:
        tangents = np.linalg.svd(direction[None])[2][1:]
        ring = polygon(rng, int(rng.integers(3, 7)), size) @ tangents
        corners.append(ring + rng.uniform(0.02, 0.04) * direction)
    return ContactFacets(tuple(corners), -outward, rng.uniform(0.3, 1.0, count), LENGTH)


def box_facets(
    normals: Array, friction: float, centre: tuple[float, float, float] = OFF_CENTRE
) -> ContactFacets:
    """The facets with these inward normals of a box of 60 by 50 by 40 mm around `centre`."""
    patches = Patches(box((0.06, 0.05, 0.04), centre)).patches
    chosen = [max(patches, key=lambda patch: float(patch.normal @ normal)) for normal in normals]
    assert all(patch.normal @ normal > 0.999 for patch, normal in zip(chosen, normals, strict=True))
    corners = tuple(patch.corners for patch in chosen)
    return ContactFacets(corners, normals, np.full(len(normals), friction), LENGTH)


def feet(facets: ContactFacets) -> Array:
    """(n, 3) m, the point of each facet's plane that is nearest to the origin."""
    return facets.normals * np.einsum("ni,ni->n", facets.normals, facets.centre)[:, None]


def points_on(facets: ContactFacets, rng: np.random.Generator) -> Array:
    """(n, 3) m, a random point of every facet."""
    return np.array([rng.dirichlet(np.ones(len(ring))) @ ring for ring in facets.corners])


def random_loads(rng: np.random.Generator, count: int) -> Array:
    """(count, 6) unit wrenches."""
    loads = rng.normal(size=(count, 6))
    return loads / np.linalg.norm(loads, axis=1, keepdims=True)


def outside(facets: ContactFacets, positions: Array) -> float:
    """m, the farthest that a point lies off its facet; from corners alone, zero inside.

    A point is inside a convex polygon if it lies on the same side of every edge as the centre.
    """
    worst = 0.0
    for ring, normal, point in zip(facets.corners, facets.normals, positions, strict=True):
        worst = max(worst, abs(float((point - ring[0]) @ normal)))
        for start, end in zip(ring, np.roll(ring, -1, axis=0), strict=True):
            across = np.cross(normal, (end - start) / np.linalg.norm(end - start))
            inward = np.sign((ring.mean(axis=0) - start) @ across)
            worst = max(worst, -float(inward * ((point - start) @ across)))
    return worst


def least_eigenvalue(facets: ContactFacets, positions: Array) -> float:
    """The smallest of G G', torques over the length."""
    grasp_map = np.repeat([1.0, 1.0 / facets.length], 3)[:, None] * facets.grasp_map(positions)
    return float(np.linalg.eigvalsh(grasp_map @ grasp_map.T)[0])


def off_surface(mesh: trimesh.Trimesh, points: Array) -> Array:
    """(n,) m, distances of points (n, 3) from the nearest triangle.

    trimesh.proximity.closest_point may take another whose squared distance is within 1e-8.
    """
    triangles = mesh.triangles[mesh.area_faces > 0]
    nearest = [
        trimesh.triangles.closest_point(triangles, np.tile(point, (len(triangles), 1)))
        for point in points
    ]
    return np.linalg.norm(np.array(nearest) - points[:, None], axis=2).min(axis=1)


def even_internal_forces(facets: ContactFacets, positions: Array) -> tuple[float, Array]:
    """The largest least normal force of internal forces whose mean is one, and the forces (n, 3).

    Inside cones of 0.95 mu; -inf if there are none. Modelled anew, and solved by way of CVXPY.
    """
    n = len(facets)
    forces, least = cp.Variable((n, 3)), cp.Variable()
    units = np.repeat([1.0, 1.0 / facets.length], 3)
    balance = units[:, None] * facets.grasp_map(positions) @ cp.vec(forces, order="C")
    permitted = cp.multiply(INTERIOR_FRICTION * facets.friction, forces[:, 2])
    constraints = [
        balance == 0,
        cp.norm(forces[:, :2], axis=1) <= permitted,
        forces[:, 2] >= least,
        cp.sum(forces[:, 2]) == n,
    ]
    program = cp.Problem(cp.Maximize(least), constraints)
    program.solve(solver=cp.CLARABEL)
    if program.status not in ("optimal", "optimal_inaccurate"):
        return -np.inf, np.full((n, 3), np.nan)
    return float(least.value), np.asarray(forces.value)
