"""Random grasp force problems from a table of grasps: fresh loads, friction and limits."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import constants

from gfo_env.grasps import GraspTable
from solvers import GraspForceError, GraspForceProblem
from solvers.arrays import Array


class SamplingError(GraspForceError):
    """Problems cannot be drawn from these ranges."""


def check_ranges(settings: Any, *, positive: tuple[str, ...], shares: tuple[str, ...]) -> None:
    """See that ranges are finite, in order and nowhere negative.

    Args:
        settings: a dataclass whose fields are upper ends of ranges from 0, or pairs of ends.
        positive: those whose lower end is not 0 either, because their logarithms are drawn.
        shares: those that lie from 0 to 1.

    Raises:
        SamplingError: if one cannot be drawn from.
    """
    for name, value in vars(settings).items():
        if not isinstance(value, tuple | float | int):
            continue
        low, high = value if isinstance(value, tuple) else (0.0, value)
        if not 0.0 <= low <= high < math.inf or (name in positive and low == 0.0):
            least = "above 0" if name in positive else "0 or more"
            raise SamplingError(f"{name} is {value}; it must be finite, in order, and {least}")
        if name in shares and high > 1.0:
            raise SamplingError(f"{name} is {value}; it must lie from 0 to 1")


@dataclass(frozen=True)
class SamplingSettings:
    """Ranges that problems are drawn from: wider than use, so that every branch is trained.

    Raises:
        SamplingError: if a range is empty, reaches below zero or to infinity.
    """

    mass: tuple[float, float] = (0.05, 0.6)
    """kg, of the object, log-uniform."""
    push: float = 6.0
    """N, largest push, uniform from 0, from any side, at any point of the object's ball."""
    torque: float = 0.1
    """N·m, largest pure torque, uniform from 0, about any axis."""
    friction: tuple[float, float] = (0.2, 1.2)
    """Coefficient, uniform."""
    torque_scale: tuple[float, float] = (0.1, 1.0)
    """Factor on the hand's torque limits, uniform."""
    preload: float = 5.0
    """N, largest preload, uniform from 0."""
    cap: tuple[float, float] = (4.0, 100.0)
    """N, cap of the normal force above the preload, log-uniform."""
    hard: float = 0.0
    """Share of problems that are made harder, each in one way: slippery contacts, weak joints, low
    caps, or the largest loads."""

    def __post_init__(self) -> None:
        check_ranges(self, positive=("mass", "cap"), shares=("hard",))


def sample_problems(
    grasps: GraspTable, rng: np.random.Generator, settings: SamplingSettings | None = None
) -> GraspForceProblem:
    """One random `min_norm` problem for each grasp, padding trimmed to the largest grasp.

    Gravity has a random direction in the hand frame: the hand may be held any way. To weight alone
    (a quarter), weight and push (half), weight and pure torque (an eighth) or pure torque alone (an
    eighth) come, each for a share of the problems, friction that differs between contacts,
    asymmetric or missing torque limits, no or uneven preload, and caps. Some problems are
    infeasible.

    Args:
        grasps: table of N grasps.
        rng: the only source of randomness.
        settings: ranges.
    """
    settings = settings or SamplingSettings()
    width = int(grasps.contact_mask.sum(axis=1).max())
    mask = grasps.contact_mask[:, :width]
    count, n_tau = len(grasps), grasps.hand_jacobian.shape[-1]
    gravity = constants.g * _directions(rng, count)
    limits = _torque_limits(grasps, rng, settings)
    preload = np.where(mask, _preload(rng, (count, width), settings), 0.0)
    friction = _friction(rng, (count, width), settings)
    load = _load(grasps, gravity, rng, settings)
    room = _cap_above_preload(rng, (count, width), settings)
    if settings.hard:
        hardship = np.where(rng.random(count) < settings.hard, rng.integers(4, size=count), -1)
        slippery, weak, capped, heavy = (hardship[:, None] == kind for kind in range(4))
        share = rng.random((count, 1))
        friction = np.where(slippery, _between(settings.friction, 0.2 * share), friction)
        least = _between(settings.torque_scale, 0.1 * share) * grasps.max_torque
        limits = np.where(weak, least, limits)
        room = np.where(capped, settings.cap[0] * (1.0 + share), room)
        load = np.where(heavy, (1.0 + 3.0 * share) * load, load)
    return GraspForceProblem(
        grasp_map=grasps.grasp_map[:, :, : 3 * width],
        hand_jacobian=grasps.hand_jacobian[:, : 3 * width],
        friction=np.where(mask, friction, 0.0),
        torque_min=-limits[0].reshape(count, n_tau),
        torque_max=limits[1].reshape(count, n_tau),
        external_wrench=load,
        external_torque=np.einsum("bij,bj->bi", grasps.gravity_map, gravity),
        normal_min=preload,
        normal_max=preload + room,
        contact_mask=mask,
    )


def _between(limits: tuple[float, float], share: Array) -> Array:
    """The values that lie at a share of the way from the lower to the upper limit."""
    return limits[0] + (limits[1] - limits[0]) * share


def _directions(rng: np.random.Generator, count: int) -> Array:
    """(count, 3) uniform unit vectors."""
    vectors = rng.standard_normal((count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def log_uniform(
    rng: np.random.Generator, limits: tuple[float, float], shape: int | tuple[int, ...]
) -> Array:
    """Draws whose logarithms are uniform."""
    low, high = limits
    return np.exp(rng.uniform(np.log(low), np.log(high), shape))


def _load(
    grasps: GraspTable, gravity: Array, rng: np.random.Generator, settings: SamplingSettings
) -> Array:
    """(N, 6) wrench in the object frame about the centre of mass."""
    count = len(grasps)
    kind = rng.choice(4, size=(count, 1), p=[0.25, 0.5, 0.125, 0.125])
    mass = log_uniform(rng, settings.mass, (count, 1))
    push = rng.uniform(0.0, settings.push, (count, 1)) * _directions(rng, count)
    radius = grasps.object_radius[:, None] * rng.uniform(0.0, 1.0, (count, 1)) ** (1.0 / 3.0)
    arm = radius * _directions(rng, count)
    twist = rng.uniform(0.0, settings.torque, (count, 1)) * _directions(rng, count)
    force = np.where(kind < 3, mass * gravity, 0.0) + np.where(kind == 1, push, 0.0)
    torque = np.where(kind == 1, np.cross(arm, push), 0.0) + np.where(kind >= 2, twist, 0.0)
    turn = grasps.object_rotation  # columns are the object's axes in the hand frame
    in_object = [np.einsum("bji,bj->bi", turn, vector) for vector in (force, torque)]
    return np.concatenate(in_object, axis=1)


def _friction(
    rng: np.random.Generator, shape: tuple[int, int], settings: SamplingSettings
) -> Array:
    """(N, n): one value a grasp, or (3 in 10) uneven; a fifth is drawn from the slippery third."""
    low, high = settings.friction
    slippery = rng.random((shape[0], 1)) < 0.2
    top = np.where(slippery, low + (high - low) / 3.0, high)
    even = low + (top - low) * rng.random((shape[0], 1))
    uneven = even * rng.uniform(0.5, 1.5, shape)
    return np.where(rng.random((shape[0], 1)) < 0.3, uneven, even)


def _torque_limits(
    grasps: GraspTable, rng: np.random.Generator, settings: SamplingSettings
) -> Array:
    """(2, N, n_tau): sizes of lower and upper limits; 1 in 5 asymmetric, 1 in 20 missing."""
    count, n_tau = len(grasps), len(grasps.max_torque)
    even = rng.uniform(*settings.torque_scale, (count, 1))
    uneven = rng.uniform(*settings.torque_scale, (2, count, n_tau))
    scale = np.where(rng.random((count, 1)) < 0.2, uneven, even)
    scale = np.where(rng.random((count, 1)) < 0.05, np.inf, scale)
    return scale * grasps.max_torque


def _preload(rng: np.random.Generator, shape: tuple[int, int], settings: SamplingSettings) -> Array:
    """(N, n): zero for 4 in 10, else one value a grasp, or (1 in 5) uneven."""
    even = rng.uniform(0.0, settings.preload, (shape[0], 1))
    uneven = even * rng.random(shape)
    value = np.where(rng.random((shape[0], 1)) < 0.2, uneven, even)
    return np.where(rng.random((shape[0], 1)) < 0.4, 0.0, value)


def _cap_above_preload(
    rng: np.random.Generator, shape: tuple[int, int], settings: SamplingSettings
) -> Array:
    """(N, n): infinite for 6 in 10, else one value a grasp."""
    cap = log_uniform(rng, settings.cap, (shape[0], 1))
    cap = np.where(rng.random((shape[0], 1)) < 0.6, np.inf, cap)
    return np.broadcast_to(cap, shape)
