"""Triangles of a closed mesh turned outward."""

import numpy as np
import trimesh

from solvers.arrays import Array


def outward(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The mesh with its triangles wound outward, as seen from what it encloses.

    Bodies that are wound inward are turned round, unless they lie in the rest: they are cavities.

    Args:
        mesh: watertight; another is given back as it is, since it has no outside.
    """
    if not mesh.is_watertight:
        return mesh
    turned = mesh
    if not mesh.is_winding_consistent:
        turned = mesh.copy()
        trimesh.repair.fix_winding(turned)
    faces, triangles = np.array(turned.faces), np.array(turned.triangles, dtype=np.float64)
    owner = trimesh.graph.connected_component_labels(turned.face_adjacency, node_count=len(faces))
    middle = triangles.reshape(-1, 3).mean(axis=0)
    a, b, c = np.moveaxis(triangles - middle, 1, 0)
    volumes = np.bincount(owner, np.einsum("fi,fi->f", np.cross(a, b), c))
    flip = np.full(len(volumes), volumes.sum() < 0)
    inward = np.flatnonzero(np.where(flip, -volumes, volumes) < 0)
    for body in inward:
        rest = triangles[owner != body]
        flip[body] ^= abs(_turns_round(triangles[owner == body][0, 0], rest)) < 0.5
    if not flip.any() and turned is mesh:
        return mesh
    faces[flip[owner]] = faces[flip[owner], ::-1]
    return trimesh.Trimesh(turned.vertices, faces, process=False)


def _turns_round(point: Array, triangles: Array) -> float:
    """How often a closed surface goes round a point: by the solid angles of its triangles.

    Ref: Van Oosterom and Strackee, The solid angle of a plane triangle (1983), equation 8.
    """
    arms = triangles - point
    a, b, c = np.moveaxis(arms, 1, 0)
    x, y, z = np.moveaxis(np.linalg.norm(arms, axis=2), 1, 0)
    volume = np.einsum("fi,fi->f", a, np.cross(b, c))
    ab, bc, ca = (np.einsum("fi,fi->f", p, q) for p, q in ((a, b), (b, c), (c, a)))
    return float(np.arctan2(volume, x * y * z + ab * z + bc * x + ca * y).sum() / (2 * np.pi))
