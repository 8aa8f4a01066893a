"""From the engine's contact points to a grasp: contacts by patch, frames, grasp map, Jacobian."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .observation import can_balance
from .pose import Pose
from .posture import Posture
from .raw_contacts import RawContacts
from .surface import Surface

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
        normal_forces: (n,) N, as the simulator had them when the contacts were read.
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

    def strongest(self, limit: int) -> "Contacts":
        """The first `limit` contacts, which are the strongest."""
        if len(self) <= limit:
            return self
        return Contacts(
            self.positions[:limit],
            self.frames[:limit],
            self.links[:limit],
            self.normal_forces[:limit],
            self.jacobian[: 3 * limit],
        )

    @cached_property
    def grasp_map(self) -> Array:
        """(6, 3n) G: contact forces in their frames to the wrench about the centre of mass."""
        return grasp_map(self.positions, self.frames)

    @cached_property
    def balanceable(self) -> bool:
        """Whether forces at the contacts, friction ignored, can balance every load."""
        return bool(can_balance(self.grasp_map))


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
    patch, count = _patches(raw.positions, raw.normals, raw.links, rank)
    share = np.zeros((count, len(rank)))
    share[patch, np.arange(len(rank))] = 1.0
    forces = share @ raw.forces[rank]
    share *= pressure[rank]
    share /= share.sum(axis=1, keepdims=True)
    normals = share @ raw.normals[rank]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    strength = np.einsum("ki,ki->k", forces, normals)
    strongest = np.argsort(-strength, kind="stable")[:limit]
    links = np.zeros(count, dtype=np.int64)
    links[patch] = raw.links[rank]
    return RawContacts(
        (share @ raw.positions[rank])[strongest],
        normals[strongest],
        forces[strongest],
        links[strongest],
    )


@njit(cache=True)
def _patches(
    positions: Array, normals: Array, links: NDArray[np.int64], rank: NDArray[np.int64]
) -> tuple[NDArray[np.int64], int]:
    """(k,) the patch of each point in the order of `rank`, and how many there are.

    A point belongs to the first patch whose strongest point it is near to.
    """
    patch = np.empty(len(rank), dtype=np.int64)
    heads = np.empty(len(rank), dtype=np.int64)
    count = 0
    for at in range(len(rank)):
        point = rank[at]
        patch[at] = count
        for known in range(count):
            head = heads[known]
            square, cosine = 0.0, 0.0
            for axis in range(3):
                square += (positions[head, axis] - positions[point, axis]) ** 2
                cosine += normals[head, axis] * normals[point, axis]
            if links[head] == links[point] and square < PATCH_SIZE**2 and cosine > PATCH_NORMAL:
                patch[at] = known
                break
        if patch[at] == count:
            heads[count] = point
            count += 1
    return patch, count


def read_contacts(merged: RawContacts, posture: Posture, surface: Surface, pose: Pose) -> Contacts:
    """The contacts of a hand on an object.

    Positions are put on the mesh, because the engine keeps bodies a collision margin of 1 mm apart.
    Normals stay the engine's: for an edge or a vertex of the object that is the finger's face,
    which is right, where a face of the mesh would be wrong.

    Args:
        merged: one point for each contact, from `merge`.
        posture: of the hand.
        surface: of the object, object frame.
        pose: of the object.
    """
    positions = surface.nearest(pose.to_object(merged.positions))
    frames = contact_frames(merged.normals @ pose.rotation)
    in_hand = np.swapaxes(pose.rotation @ frames, 1, 2)
    motion = posture.jacobians(pose.to_hand(positions), merged.links)
    return Contacts(
        positions=positions,
        frames=frames,
        links=merged.links,
        normal_forces=np.einsum("ki,ki->k", merged.forces, merged.normals),
        jacobian=(in_hand @ motion).reshape(-1, motion.shape[-1]),
    )
