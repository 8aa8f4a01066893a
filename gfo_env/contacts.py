"""From the engine's contact points to a grasp: contacts by patch, frames, grasp map, Jacobian."""

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

from .pose import Pose
from .simulation import RawContacts, Simulation

LEAST_FORCE = 0.01
"""N: contact points that press less do not count."""

PATCH_SIZE = 0.008
"""m: points of one link that are closer than this, with like normals, are one contact."""

PATCH_NORMAL = 0.8
"""Least cosine between the normals of points of one contact."""

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Contacts:
    """Point contacts of a hand on an object, in the object frame.

    Args:
        positions: (n, 3) m, on the object's surface.
        frames: (n, 3, 3) columns t1, t2, n of each contact frame; n points into the object.
        links: (n,) index of the hand's link, -1 for the base.
        normal_forces: (n,) N, as the simulator had them at the end of the acquisition.
        jacobian: (3n, n_tau) hand Jacobian J_h in the contact frames, m: the joint torques J_h' f
            make the fingers press on the object with f.
    """

    positions: Array
    frames: Array
    links: NDArray[np.int64]
    normal_forces: Array
    jacobian: Array

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def normals(self) -> Array:
        """(n, 3) unit, into the object."""
        return self.frames[:, :, 2]

    def grasp_map(self) -> Array:
        """(6, 3n) G: contact forces in their frames to the wrench about the centre of mass."""
        return grasp_map(self.positions, self.frames)


def grasp_map(positions: Array, frames: Array) -> Array:
    """(6, 3n) grasp map of point contacts: [R_i; p_i x R_i] side by side.

    Args:
        positions: (n, 3) m, from the centre of mass.
        frames: (n, 3, 3) contact frames as columns t1, t2, n.
    """
    moments = np.cross(positions[:, :, None], frames, axis=1)
    return np.concatenate([frames, moments], axis=1).transpose(1, 0, 2).reshape(6, -1)


def contact_frames(normals: Array) -> Array:
    """(n, 3, 3) right-handed frames (t1, t2, n) as columns; t1 depends on the normal alone.

    The construction is that of Duff et al., "Building an Orthonormal Basis, Revisited" (2017),
    which has no division by small numbers.
    """
    x, y, z = normals.T
    sign = np.where(z >= 0, 1.0, -1.0)
    a = -1.0 / (sign + z)
    b = x * y * a
    first = np.stack([1.0 + sign * x * x * a, sign * b, -sign * x], axis=1)
    second = np.stack([b, sign + y * y * a, -y], axis=1)
    return np.stack([first, second, normals], axis=2)


def merge(raw: RawContacts, limit: int) -> RawContacts:
    """One contact per patch: points of one link within 8 mm and with like normals, force-weighted.

    Patches come strongest first, at most `limit` of them.
    """
    pressure = np.einsum("ki,ki->k", raw.forces, raw.normals)
    rank = np.argsort(-pressure, kind="stable")
    rank = rank[pressure[rank] > LEAST_FORCE]
    patches: list[list[int]] = []
    for index in rank:
        for patch in patches:
            head = patch[0]
            if (
                raw.links[head] == raw.links[index]
                and np.linalg.norm(raw.positions[head] - raw.positions[index]) < PATCH_SIZE
                and raw.normals[head] @ raw.normals[index] > PATCH_NORMAL
            ):
                patch.append(int(index))
                break
        else:
            patches.append([int(index)])
    positions, normals, forces, links = [], [], [], []
    for patch in patches:
        weight = pressure[patch] / pressure[patch].sum()
        normal = weight @ raw.normals[patch]
        positions.append(weight @ raw.positions[patch])
        normals.append(normal / np.linalg.norm(normal))
        forces.append(raw.forces[patch].sum(axis=0))
        links.append(raw.links[patch[0]])
    merged = RawContacts(
        np.array(positions).reshape(-1, 3),
        np.array(normals).reshape(-1, 3),
        np.array(forces).reshape(-1, 3),
        np.array(links, dtype=np.int64),
    )
    strength = np.einsum("ki,ki->k", merged.forces, merged.normals)
    strongest = np.argsort(-strength, kind="stable")[:limit]
    return RawContacts(
        merged.positions[strongest],
        merged.normals[strongest],
        merged.forces[strongest],
        merged.links[strongest],
    )


def read_contacts(
    simulation: Simulation, solid: trimesh.Trimesh, pose: Pose, limit: int
) -> Contacts:
    """The present contacts of a simulation, at most `limit`, strongest first.

    Positions are put on the mesh, because the engine keeps bodies a collision margin of 1 mm apart.
    Normals stay the engine's: for an edge or a vertex of the object that is the finger's face,
    which is right, where a face of the mesh would be wrong.

    Args:
        simulation: after a step.
        solid: the object's surface, object frame.
        pose: of the object.
        limit: most contacts to keep.
    """
    raw = merge(simulation.contacts(), limit)
    if not len(raw.links):
        n_tau = len(simulation.hand.joint_names)
        return Contacts(
            np.zeros((0, 3)), np.zeros((0, 3, 3)), raw.links, np.zeros(0), np.zeros((0, n_tau))
        )
    positions, _, _ = trimesh.proximity.closest_point(solid, pose.to_object(raw.positions))
    frames = contact_frames(raw.normals @ pose.rotation)
    in_hand = pose.rotation @ frames
    motion = simulation.point_jacobians(pose.to_hand(positions), raw.links)
    jacobian = np.swapaxes(in_hand, 1, 2) @ motion
    return Contacts(
        positions=np.asarray(positions, dtype=np.float64),
        frames=frames,
        links=raw.links,
        normal_forces=np.einsum("ki,ki->k", raw.forces, raw.normals),
        jacobian=jacobian.reshape(-1, motion.shape[-1]),
    )
