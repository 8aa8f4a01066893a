"""Flat facets on which contacts may move: the domain of contact synthesis."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from numbers import Real
from typing import Any

import numpy as np

from solvers.arguments import check_shape
from solvers.arrays import Array
from solvers.exceptions import ProblemError

_FLAT = 1e-5
"""Distance of a corner from its facet's plane, over the facet's size, that still counts as none."""


@dataclass(frozen=True, eq=False)
class ContactFacets:
    """One convex polygon for each contact, and the friction cone that it has anywhere on it.

    A position is x_i = centre_i + size_i T_i s_i, with T_i the two tangents of the contact frame
    and local coordinates |s_i| <= 1, so that the grasp map is affine in s:
    G_i(s_i) = base_i + s_i1 slope_i1 + s_i2 slope_i2. Torques are about the origin, which is the
    object's centre of mass, and are divided by `length` wherever this class makes wrenches.

    Args:
        corners: for each contact (k, 3) m, the polygon's corners in order.
        normals: (n, 3) unit, into the object, normal to the polygon.
        friction: (n,) mu > 0.
        length: m, divisor of torques; say the object's largest radius.

    Raises:
        ProblemError: for polygons that are not flat, convex and of some area, or for bad numbers.
    """

    corners: tuple[Array, ...]
    normals: Array
    friction: Array
    length: float

    def __post_init__(self) -> None:
        try:
            corners = tuple(np.array(ring, dtype=np.float64) for ring in self.corners)
        except (TypeError, ValueError) as error:
            raise ProblemError("corners must be numbers, (k, 3) for each facet") from error
        normals = _finite("normals", self.normals, (len(corners), 3))
        friction = _finite("friction", self.friction, (len(corners),))
        for name, value in (("corners", corners), ("normals", normals), ("friction", friction)):
            object.__setattr__(self, name, value)
        if not corners:
            raise ProblemError("there are no facets: give one for each contact")
        if not (isinstance(self.length, Real) and 0.0 < self.length < np.inf):
            raise ProblemError(f"length must be a positive number of metres, not {self.length!r}")
        if (friction <= 0).any():
            raise ProblemError("friction must be positive: without it no facet holds an object")
        if (np.abs(np.linalg.norm(normals, axis=1) - 1.0) > 1e-6).any():
            raise ProblemError("normals must have unit length: divide each by its norm")
        for index, ring in enumerate(corners):
            if ring.ndim != 2 or ring.shape[1:] != (3,) or len(ring) < 3:
                raise ProblemError(f"facet {index} needs three corners or more, as (k, 3)")
            _finite(f"corners of facet {index}", ring, ring.shape)
        # only now: what is derived from the corners is derived for all facets at once
        for index in range(len(corners)):
            self._check_plane(index)
        for index in range(len(corners)):
            self._check_outline(index)

    def _check_plane(self, index: int) -> None:
        arms, size = self.corners[index] - self.centre[index], self.size[index]
        if np.abs(arms @ self.normals[index]).max() > _FLAT * size:
            raise ProblemError(f"facet {index} is not flat, or its normal is not normal to it")
        # the frame needs a first corner off the centre, as every convex polygon with an area has
        if np.linalg.norm(arms[0]) <= _FLAT * size:
            raise ProblemError(f"facet {index} is not convex, or has no area")

    def _check_outline(self, index: int) -> None:
        sides, bounds = self.sides[index]
        local = self._local(index, self.corners[index])
        if (sides @ local.T > bounds[:, None] + _FLAT).any():
            raise ProblemError(f"facet {index} is not convex, or its corners are not in order")

    def __len__(self) -> int:
        return len(self.normals)

    @cached_property
    def centre(self) -> Array:
        """(n, 3) m, mean of the corners."""
        return np.array([ring.mean(axis=0) for ring in self.corners])

    @cached_property
    def size(self) -> Array:
        """(n,) m, largest distance of a corner from the centre."""
        return np.array(
            [
                np.linalg.norm(ring - centre, axis=1).max()
                for ring, centre in zip(self.corners, self.centre, strict=True)
            ]
        )

    @cached_property
    def frames(self) -> Array:
        """(n, 3, 3) contact frames (t1, t2, n) as columns, t1 towards the first corner."""
        first = np.array([ring[0] for ring in self.corners]) - self.centre
        first -= np.einsum("ij,ij->i", first, self.normals)[:, None] * self.normals
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        return np.stack([first, np.cross(self.normals, first), self.normals], axis=2)

    @cached_property
    def sides(self) -> tuple[tuple[Array, Array], ...]:
        """For each facet (A, b), one row a side: it is {s : A s <= b}, with rows of length one."""
        halves = []
        for index, ring in enumerate(self.corners):
            local = self._local(index, ring)
            step = np.roll(local, -1, axis=0) - local
            length = np.linalg.norm(step, axis=1)
            if length.min() <= _FLAT:
                raise ProblemError(f"facet {index} has two corners in one place")
            outward = np.stack([step[:, 1], -step[:, 0]], axis=1) / length[:, None]
            bounds = np.einsum("ij,ij->i", outward, local)
            if bounds.sum() < 0:  # corners in clockwise order
                outward, bounds = -outward, -bounds
            if bounds.min() <= _FLAT:
                raise ProblemError(f"facet {index} is not convex, or has no area")
            halves.append((outward, bounds))
        return tuple(halves)

    @cached_property
    def base(self) -> Array:
        """(n, 6, 3) grasp map of each contact at its facet's centre, torques over `length`."""
        return self._wrenches(self.centre / self.length, force=1.0)

    @cached_property
    def slope(self) -> Array:
        """(n, 2, 6, 3) change of the grasp map with each local coordinate."""
        steps = self.size[:, None, None] * self.frames[:, :, :2] / self.length
        return np.stack([self._wrenches(steps[:, :, axis], force=0.0) for axis in (0, 1)], axis=1)

    def corner_maps(self, index: int) -> Array:
        """(k, 6, 3) grasp maps of a contact at each corner of its facet, torques over `length`."""
        local = self._local(index, self.corners[index])
        return self.base[index] + np.einsum("ka,aij->kij", local, self.slope[index])

    def positions(self, local: Array) -> Array:
        """(n, 3) m, from local coordinates (n, 2)."""
        check_shape("local", local, (len(self), 2))
        tangents = self.frames[:, :, :2]
        return self.centre + self.size[:, None] * np.einsum("nij,nj->ni", tangents, local)

    def local(self, positions: Array) -> Array:
        """(n, 2) local coordinates of points (n, 3) m in the planes of the facets."""
        check_shape("positions", positions, (len(self), 3))
        return np.array([self._local(i, point[None])[0] for i, point in enumerate(positions)])

    def grasp_map(self, positions: Array) -> Array:
        """(6, 3n) G at positions (n, 3) m; torques in N·m per N."""
        check_shape("positions", positions, (len(self), 3))
        moments = np.cross(positions[:, :, None], self.frames, axis=1)
        return np.concatenate([self.frames, moments], axis=1).transpose(1, 0, 2).reshape(6, -1)

    def _local(self, index: int, points: Array) -> Array:
        tangents = self.frames[index][:, :2]
        return np.asarray((points - self.centre[index]) @ tangents / self.size[index])

    def _wrenches(self, arms: Array, force: float) -> Array:
        moments = np.cross(arms[:, :, None], self.frames, axis=1)
        return np.concatenate([force * self.frames, moments], axis=1)


def _finite(name: str, value: Any, shape: Sequence[int]) -> Array:
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ProblemError(f"{name} must be an array of numbers of shape {tuple(shape)}") from error
    if array.shape != tuple(shape):
        raise ProblemError(f"{name} must have shape {tuple(shape)}, not {array.shape}")
    if not np.isfinite(array).all():
        raise ProblemError(f"{name} must be finite")
    return array
