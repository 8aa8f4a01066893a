"""From the engine's contact points to a grasp: contacts by patch, frames, grasp map, Jacobian."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from gfo_env.checks import CheckedArrays, Shape, checked_array, checked_arrays, is_whole
from gfo_env.digests import digest
from gfo_env.exceptions import GeometryError
from gfo_env.hand.posture import Posture, point_jacobians
from gfo_env.pose import Pose, turned
from solvers.arrays import Array, Indices

from .engine import RawContacts
from .rank import balances
from .surface import Surface, nearest_points

LEAST_FORCE = 0.01
"""N: contact points that press less do not count."""

PATCH_SIZE = 0.008
"""m: points of one link that are closer than this, with like normals, are one contact."""

PATCH_NORMAL = 0.8
"""Least cosine between the normals of points of one contact."""

UNIT_TOLERANCE = 1e-5
"""Of the length of normals, which may have gone through single precision."""


@dataclass(frozen=True, eq=False)
class Contacts(CheckedArrays):
    """Point contacts of a hand on an object, in the object frame.

    Args:
        positions: (n, 3) m, on the object's surface.
        frames: (n, 3, 3) columns t1, t2, n of each contact frame; n points into the object.
        links: (n,) index of the hand's link, -1 for the base.
        normal_forces: (n,) N, as the simulator had them when the contacts were read.
        jacobian: (3n, n_tau) hand Jacobian J_h in the contact frames, m: the joint torques J_h' f
            make the fingers press on the object with f.

    Raises:
        GeometryError: an argument has another shape or is not finite.
    """

    positions: Array
    frames: Array
    links: Indices
    normal_forces: Array
    jacobian: Array

    SHAPES: ClassVar[dict[str, Shape]] = {
        "positions": ("n", 3),
        "frames": ("n", 3, 3),
        "links": ("n",),
        "normal_forces": ("n",),
        "jacobian": ("3n", "t"),
    }
    NUMBERS: ClassVar[tuple[str, ...]] = ("links",)

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
        return Contacts.unchecked(
            self.positions[:limit],
            self.frames[:limit],
            self.links[:limit],
            self.normal_forces[:limit],
            self.jacobian[: 3 * limit],
        )

    @cached_property
    def grasp_map(self) -> Array:
        """(6, 3n) G: contact forces in their frames to the wrench about the centre of mass."""
        return grasp_map_of(self.positions, self.frames)

    @cached_property
    def balanceable(self) -> bool:
        """Whether forces at the contacts, friction ignored, can balance every load."""
        return bool(len(self) >= 2 and balances(self.grasp_map))


def grasp_map(positions: ArrayLike, frames: ArrayLike) -> Array:
    """(6, 3n) grasp map of the point contacts of one grasp: [R_i; p_i x R_i] side by side.

    Args:
        positions: (n, 3) m, from the centre of mass.
        frames: (n, 3, 3) contact frames as columns t1, t2, n.

    Raises:
        GeometryError: an argument has another shape or is not finite.
    """
    points, axes = checked_arrays(
        {"positions": positions, "frames": frames},
        {"positions": ("n", 3), "frames": ("n", 3, 3)},
    )
    return grasp_map_of(_plain(points), _plain(axes))


def _plain(array: Array) -> Array:
    """The array in the one layout of memory that the loops are compiled for."""
    return np.require(array, np.float64, ["C", "W"])


@njit(cache=True)
def grasp_map_of(positions: Array, frames: Array) -> Array:
    """`grasp_map` for compiled code."""
    result = np.empty((6, 3 * len(positions)))
    for i in range(len(positions)):
        x, y, z = positions[i]
        for k in range(3):
            a, b, c = frames[i, 0, k], frames[i, 1, k], frames[i, 2, k]
            column = 3 * i + k
            result[0, column], result[1, column], result[2, column] = a, b, c
            result[3, column] = y * c - z * b
            result[4, column] = z * a - x * c
            result[5, column] = x * b - y * a
    return result


def contact_frames(normals: ArrayLike) -> Array:
    """(n, 3, 3) right-handed frames (t1, t2, n) as columns; t1 depends on the normal alone.

    The construction is that of Duff et al., "Building an Orthonormal Basis, Revisited" (2017),
    which has no division by small numbers.

    Args:
        normals: (n, 3) unit.

    Raises:
        GeometryError: the normals have another shape, are not finite, or not of unit length.
    """
    axes = checked_array("normals", normals, ("n", 3))
    if (np.abs(np.linalg.norm(axes, axis=1) - 1.0) > UNIT_TOLERANCE).any():
        raise GeometryError("normals must have unit length: divide each by its norm.")
    return _contact_frames(_plain(axes))


@njit(cache=True)
def _contact_frames(normals: Array) -> Array:
    frames = np.empty((len(normals), 3, 3))
    for i in range(len(normals)):
        x, y, z = normals[i]
        sign = 1.0 if z >= 0.0 else -1.0
        a = -1.0 / (sign + z)
        b = x * y * a
        frames[i, 0, 0], frames[i, 1, 0], frames[i, 2, 0] = (
            1.0 + sign * x * x * a,
            sign * b,
            -sign * x,
        )
        frames[i, 0, 1], frames[i, 1, 1], frames[i, 2, 1] = b, sign + y * y * a, -y
        frames[i, 0, 2], frames[i, 1, 2], frames[i, 2, 2] = x, y, z
    return frames


def merge(raw: RawContacts, limit: int) -> RawContacts:
    """One contact per patch: points of one link within 8 mm and with like normals, force-weighted.

    Patches come strongest first, at most `limit` of them.

    Raises:
        GeometryError: the limit is no whole number of at least 0.
    """
    if not (is_whole(limit) and limit >= 0):
        raise GeometryError(f"limit must be a whole number >= 0, not {limit!r}.")
    return RawContacts.unchecked(
        *merge_points(raw.positions, raw.normals, raw.forces, raw.links, limit)
    )


@njit(cache=True)
def merge_points(
    positions: Array, normals: Array, forces: Array, links: Indices, limit: int
) -> tuple[Array, Array, Array, Indices]:
    """`merge` for compiled code: the fields of `RawContacts`."""
    pressure = np.zeros(len(positions))
    for k in range(len(positions)):
        for axis in range(3):
            pressure[k] += forces[k, axis] * normals[k, axis]
    rank = np.argsort(-pressure, kind="mergesort")
    rank = rank[pressure[rank] > LEAST_FORCE]
    patch, count = _patches(positions, normals, links, rank)
    sums = np.zeros((count, 3, 3))
    weight = np.zeros(count)
    owner = np.zeros(count, dtype=np.int64)
    for at in range(len(rank)):
        point, to = rank[at], patch[at]
        weight[to] += pressure[point]
        owner[to] = links[point]
        for axis in range(3):
            sums[to, 0, axis] += pressure[point] * positions[point, axis]
            sums[to, 1, axis] += pressure[point] * normals[point, axis]
            sums[to, 2, axis] += forces[point, axis]
    strength = np.zeros(count)
    for to in range(count):
        square = 0.0
        for axis in range(3):
            sums[to, 0, axis] /= weight[to]
            square += sums[to, 1, axis] * sums[to, 1, axis]
        for axis in range(3):
            sums[to, 1, axis] /= np.sqrt(square)
            strength[to] += sums[to, 1, axis] * sums[to, 2, axis]
    strongest = np.argsort(-strength, kind="mergesort")[:limit]
    kept = sums[strongest]
    return kept[:, 0].copy(), kept[:, 1].copy(), kept[:, 2].copy(), owner[strongest]


@njit(cache=True)
def _patches(
    positions: Array, normals: Array, links: Indices, rank: Indices
) -> tuple[Indices, int]:
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
                apart = positions[head, axis] - positions[point, axis]
                square += apart * apart
                cosine += normals[head, axis] * normals[point, axis]
            near = square < PATCH_SIZE * PATCH_SIZE and cosine > PATCH_NORMAL
            if near and links[head] == links[point]:
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

    Raises:
        GeometryError: a point is of a link that the hand does not have.
    """
    tree = posture.tree
    strangers = (merged.links < -1) | (merged.links >= len(tree.joints))
    if strangers.any():
        raise GeometryError(
            f"links must lie between -1 and {len(tree.joints) - 1}, the last of the hand, and not "
            f"be {int(merged.links[strangers][0])}."
        )
    positions, frames, pressing, jacobian = contact_geometry(
        merged.positions, merged.normals, merged.forces, merged.links, pose.position, pose.rotation,
        surface.triangles, surface.low, surface.high, posture.origins, posture.orientations,
        tree.numbers, tree.parents, tree.columns, tree.slides, tree.axes,
    )  # fmt: skip
    return Contacts.unchecked(positions, frames, merged.links, pressing, jacobian)


@njit(cache=True)
def _in_frames(
    forces: Array, normals: Array, frames: Array, rotation: Array, motion: Array
) -> tuple[Array, Array]:
    """(n,) normal forces, and (3n, n_tau) Jacobians in the contact frames."""
    count, n_tau = len(frames), motion.shape[2]
    pressing, jacobian = np.zeros(count), np.zeros((3 * count, n_tau))
    for i in range(count):
        for axis in range(3):
            pressing[i] += forces[i, axis] * normals[i, axis]
        for k in range(3):
            for row in range(3):
                direction = 0.0  # of axis k of the frame, in the hand frame
                for axis in range(3):
                    direction += rotation[row, axis] * frames[i, axis, k]
                for j in range(n_tau):
                    jacobian[3 * i + k, j] += direction * motion[i, row, j]
    return pressing, jacobian


def _entry(sources: str) -> Callable[..., tuple[Array, Array, Array, Array]]:
    @njit(cache=True)
    def read(
        points: Array, normals: Array, forces: Array, links: Indices, position: Array,
        rotation: Array, triangles: Array, low: Array, high: Array, origins: Array,
        orientations: Array, numbers: Indices, parents: Indices, columns: Indices,
        slides: NDArray[np.bool_], axes: Array,
    ) -> tuple[Array, Array, Array, Array]:  # fmt: skip
        sources  # noqa: B018 - see `digests.digest`
        positions = nearest_points(turned(points - position, rotation), triangles, low, high)
        frames = _contact_frames(turned(normals, rotation))
        motion = point_jacobians(
            turned(positions, rotation.T) + position, numbers[links], origins, orientations,
            parents, columns, slides, axes, len(numbers) - 1,
        )  # fmt: skip
        pressing, jacobian = _in_frames(forces, normals, frames, rotation, motion)
        return positions, frames, pressing, jacobian

    return read


contact_geometry = _entry(digest("contacts", "hand", "pose"))
"""`read_contacts` for compiled code: positions, frames, normal forces, Jacobian of `Contacts`.

Arguments: the fields of merged contacts; position and rotation of the object; triangles, low and
high of its surface; origins and orientations of the links; numbers, parents, columns, slides and
axes of their tree."""
