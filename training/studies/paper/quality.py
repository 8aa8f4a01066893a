"""The paper's validation: q_lrw of a three-finger grasp, and why its 6.7 compares with nothing.

The paper grasps a PyBullet object with a Barrett hand that touches it in three points, and reports
q_lrw = 6.7 for the "optimal force input" without a unit, a divisor of torques, a number of edges or
a coefficient of friction (its sections "Grasp Analysis Problem" and "Validation based on Grasp
Quality Measure"). Here such a grasp is acquired, its optimal forces are solved for, and q_lrw of
this one grasp is measured by every convention that the paper leaves open.

It may not have been q_lrw at all. The public program that best fits the paper's citation "PyBullet
GraspIt" is https://github.com/carcamdou/cr_grasper, and what it prints as epsilon is neither a
function of the friction nor a distance to the hull's boundary: see `vertex_distance`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.spatial import ConvexHull

from gfo_env.contacts import (
    QualityInterval,
    has_interior_internal_force,
    is_force_closure,
    lowest_resisted_wrench,
)
from solvers.arrays import Array
from solvers.quality.friction_discs import FrictionDiscs

from .three_fingers import FORCES, PaperGrasp

PRINTED_QUALITY = 6.7
"""The paper's q_lrw, without a unit."""

EDGES = 8
"""Edges of each cone where nothing else is said."""

EDGE_COUNTS = (4, 8, 16)

_SHORTEST, _LONGEST = 1e-5, 1e3


@dataclass(frozen=True)
class QualityRow:
    """q_lrw of one grasp by one convention.

    Args:
        forces: what the contacts press with, one of `FORCES`.
        length_name: what torques are divided by.
        length: the same, m.
        edges: of each cone's pyramid.
        lower: q_lrw of the pyramids, which is what a program with these settings prints: N, or a
            pure number where the forces are "unit".
        upper: no q_lrw of the round cones exceeds it.
    """

    forces: str
    length_name: str
    length: float
    edges: int
    lower: float
    upper: float


@dataclass(frozen=True)
class ClosureRow:
    """Force closure of one grasp at one coefficient of friction, by independent computations.

    Args:
        friction: coefficient.
        quality: q_lrw of the commanded forces, lower bound, N.
        closes: whether it is positive, decided by adding edges (`is_force_closure`).
        interior_force: the paper's own LMI test.
        vertex_distance: what the cited program prints for the commanded forces, N.
    """

    friction: float
    quality: float
    closes: bool
    interior_force: bool
    vertex_distance: float


@dataclass(frozen=True)
class ArbitraryForces:
    """What q_lrw says of normal forces that were drawn at random.

    Args:
        count: how many draws.
        positive: how many of them have q_lrw > 0.
        lowest: least q_lrw, N.
        highest: largest q_lrw, N.
        least_residual: least |G f + w| / |w| of them: 0 would be balance.
    """

    count: int
    positive: int
    lowest: float
    highest: float
    least_residual: float


@dataclass(frozen=True, eq=False)
class Projection:
    """A convex polyhedron around the origin: a hull of wrenches, one half of them left out.

    Args:
        points: (p, 3) N.
        faces: (f, 3) triangles, indices of `points`, anticlockwise seen from outside.
        inradius: N, distance from the origin to the nearest face.
    """

    points: Array
    faces: NDArray[np.int64]
    inradius: float


@dataclass(frozen=True, eq=False)
class Hull:
    """The hull whose inscribed ball q_lrw is the radius of, in the two projections one can draw.

    The ball of the six-dimensional hull projects to balls of the same radius, which lie inside both
    polyhedra but need not touch either: `inradius` of a projection overstates q_lrw.

    Args:
        edges: of each cone's pyramid.
        length: divisor of torques, m.
        radius: q_lrw of these pyramids, N.
        wrenches: (k, 6) primitive wrenches, N: force, torque / length.
        touch: (6,) where the ball touches the hull, N.
        force: projection to forces.
        torque: projection to torques / length.
    """

    edges: int
    length: float
    radius: float
    wrenches: Array
    touch: Array
    force: Projection
    torque: Projection


def quality(
    grasp: PaperGrasp,
    *,
    forces: str = "commanded",
    length: float | None = None,
    edges: int = EDGES,
    relative_width: float | None = None,
) -> QualityInterval:
    """q_lrw of the grasp, at its true friction.

    Args:
        grasp: whose contacts, forces and friction.
        forces: what the contacts press with, one of `FORCES`.
        length: divisor of torques, m; the object's radius if None.
        edges: of each cone's pyramid.
        relative_width: as in `lowest_resisted_wrench`.
    """
    contacts = grasp.contacts
    return lowest_resisted_wrench(
        contacts.positions,
        contacts.normals,
        np.full(len(contacts), grasp.friction),
        normal_forces=grasp.normal_forces(forces),
        length=grasp.radius if length is None else length,
        edges=edges,
        relative_width=relative_width,
    )


def lengths(grasp: PaperGrasp) -> dict[str, float]:
    """What programs divide torques by, m. By 1 m: N·m are added to N; by 1 mm: N·mm are."""
    return {
        "object's radius": grasp.radius,
        "farthest contact": float(np.linalg.norm(grasp.contacts.positions, axis=1).max()),
        "1 m": 1.0,
        "1 mm": 1e-3,
    }


def conventions(grasp: PaperGrasp) -> tuple[QualityRow, ...]:
    """q_lrw of the grasp by every convention: forces, then divisors of torques, then edges."""
    rows = []
    for forces in FORCES:
        for name, length in lengths(grasp).items():
            for edges in EDGE_COUNTS:
                interval = quality(grasp, forces=forces, length=length, edges=edges)
                rows.append(QualityRow(forces, name, length, edges, interval.lower, interval.upper))
    return tuple(rows)


def force_scale_for(grasp: PaperGrasp, target: float = PRINTED_QUALITY) -> float:
    """The factor on the commanded forces at which q_lrw is `target`; q_lrw is linear in it."""
    return target / quality(grasp).lower


def strongest_scale(grasp: PaperGrasp) -> float:
    """The largest factor on the commanded forces that the hand's joints can supply."""
    problem = grasp.problem
    torques = np.reshape(grasp.solution.forces, -1) @ np.asarray(problem.hand_jacobian)
    limits = np.where(torques > 0, problem.torque_max, problem.torque_min)
    # the joints carry the hand's own links, too, and these do not press harder
    spare = limits - np.asarray(problem.external_torque)
    loaded = np.abs(torques) > 0
    return float(np.min(spare[loaded] / torques[loaded]))


def length_for(
    grasp: PaperGrasp, target: float = PRINTED_QUALITY, *, forces: str = "printed sizes"
) -> float:
    """The divisor of torques [m] at which q_lrw is `target`; NaN if there is none.

    q_lrw falls with the divisor: a smaller one stretches the hull along the torques, and the ball
    that was inside remains so. For a divisor of 0 it would be the largest pure force, without any
    torque, that is resisted in every direction; no divisor gives more.
    """

    def excess(log_length: float) -> float:
        return quality(grasp, forces=forces, length=float(np.exp(log_length))).lower - target

    shortest, longest = np.log([_SHORTEST, _LONGEST])
    if excess(shortest) < 0 or excess(longest) > 0:
        return float("nan")
    return float(np.exp(brentq(excess, shortest, longest, xtol=1e-12)))


def closure(grasp: PaperGrasp, frictions: Sequence[float]) -> tuple[ClosureRow, ...]:
    """The paper's claim that q_lrw > 0 means force closure, at several coefficients of friction."""
    contacts = grasp.contacts
    points, normals = contacts.positions, contacts.normals
    distance = vertex_distance(points, normals, grasp.normal_forces(), grasp.radius)
    rows = []
    for friction in frictions:
        coefficients = np.full(len(contacts), friction)
        lower = lowest_resisted_wrench(
            points,
            normals,
            coefficients,
            normal_forces=grasp.normal_forces(),
            length=grasp.radius,
            edges=EDGES,
        ).lower
        rows.append(
            ClosureRow(
                friction=float(friction),
                quality=lower,
                closes=is_force_closure(points, normals, coefficients),
                interior_force=has_interior_internal_force(points, normals, coefficients),
                vertex_distance=distance,
            )
        )
    return tuple(rows)


def arbitrary_forces(grasp: PaperGrasp, count: int = 200, seed: int = 0) -> ArbitraryForces:
    """q_lrw of forces that have nothing to do with the load: it validates contacts, not forces.

    Every contact presses along its normal with 0.1 to 10 N, independently. In force closure q_lrw
    is positive for all such forces, for the hull contains a ball as soon as every contact presses.
    """
    rng = np.random.default_rng(seed)
    contacts = grasp.contacts
    draws = np.exp(rng.uniform(np.log(0.1), np.log(10.0), (count, len(contacts))))
    grasp_map = contacts.grasp_map
    load = np.asarray(grasp.problem.external_wrench)
    # newtons and newton metres in one norm, by the divisor that q_lrw has
    weights = np.repeat([1.0, 1.0 / grasp.radius], 3)
    qualities = [
        lowest_resisted_wrench(
            contacts.positions,
            contacts.normals,
            np.full(len(contacts), grasp.friction),
            normal_forces=forces,
            length=grasp.radius,
            edges=EDGES,
        ).lower
        for forces in draws
    ]
    residuals = (draws @ grasp_map[:, 2::3].T + load) * weights
    relative = np.linalg.norm(residuals, axis=1) / np.linalg.norm(load * weights)
    return ArbitraryForces(
        count=count,
        positive=int(np.sum(np.array(qualities) > 0)),
        lowest=float(min(qualities)),
        highest=float(max(qualities)),
        least_residual=float(relative.min()),
    )


def vertex_distance(
    positions: Array,
    normals: Array,
    normal_forces: Array,
    length: float,
    *,
    sides: int = 9,
    pyramid_radius: float = 0.06,
) -> float:
    """What the program that the paper seems to cite prints as epsilon, N. It is not q_lrw.

    Each contact has a pyramid of `sides` edges around its normal force N n, as wide as
    `pyramid_radius`, every edge then cut to the length N / sides. The figure is the distance from
    the mean of the hull's vertices to the nearest *vertex*. No friction enters; the origin does not
    either; and it is positive whether or not the grasp closes.

    Args:
        positions: (n, 3) m, from the centre of mass.
        normals: (n, 3) unit, into the object.
        normal_forces: (n,) N, > 0.
        length: divisor of torques, m. The program takes half the diagonal of what PyBullet says
            about the object's shape: of its box, or, for a mesh, of the three scale factors.
        sides: the program's default.
        pyramid_radius: N, the program's default.

    Source: `gws_pyramid_extension` and `eplison` of cr_grasper/grasper.py in
    https://github.com/carcamdou/cr_grasper, its bh_config.ini; written anew.
    """
    # a disc of the width pyramid_radius is what a friction of pyramid_radius / N would give
    discs = FrictionDiscs.of_contacts(
        positions, normals, pyramid_radius / normal_forces, normal_forces, length
    )
    wrenches, _ = discs.pyramids(sides)
    sizes = np.linalg.norm(wrenches[:, :3], axis=1, keepdims=True)
    wrenches *= np.repeat(normal_forces, sides)[:, None] / sides / sizes
    vertices = wrenches[ConvexHull(wrenches, qhull_options="QJ").vertices]
    return float(np.linalg.norm(wrenches - vertices.mean(axis=0), axis=1).min())


def hull(grasp: PaperGrasp, *, forces: str = "commanded", edges: int = EDGES) -> Hull:
    """The hull of the primitive wrenches, and its ball, torques divided by the object's radius.

    Args:
        grasp: whose contacts, forces and friction.
        forces: what the contacts press with, one of `FORCES`.
        edges: of each cone's pyramid.
    """
    contacts = grasp.contacts
    discs = FrictionDiscs.of_contacts(
        contacts.positions,
        contacts.normals,
        np.full(len(contacts), grasp.friction),
        grasp.normal_forces(forces),
        grasp.radius,
    )
    wrenches, _ = discs.pyramids(edges)
    with_origin = np.vstack([np.zeros(6), wrenches])
    # the wrenches of a contact are coplanar: joggled, Qhull does not stumble over it
    equations = ConvexHull(with_origin, qhull_options="QJ").equations
    nearest = equations[equations[:, 6].argmax()]
    radius = quality(grasp, forces=forces, edges=edges).lower
    return Hull(
        edges=edges,
        length=grasp.radius,
        radius=radius,
        wrenches=wrenches,
        touch=radius * nearest[:6],
        force=_projection(with_origin[:, :3]),
        torque=_projection(with_origin[:, 3:]),
    )


def _projection(points: Array) -> Projection:
    polyhedron = ConvexHull(points)
    faces = polyhedron.simplices.astype(np.int64)
    first, second, third = points[faces].transpose(1, 0, 2)
    normals = np.cross(second - first, third - first)
    inward = np.einsum("fi,fi->f", normals, polyhedron.equations[:, :3]) < 0
    faces[inward] = faces[inward, ::-1]
    return Projection(points, faces, float(-polyhedron.equations[:, 3].max()))
