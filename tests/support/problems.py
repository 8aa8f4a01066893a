"""Random grasp force problems that look like a hand on an object, without a simulator."""

from typing import Any

import numpy as np

from solvers import GraspForceProblem, solve
from solvers.arrays import Array

N_JOINTS = 8
FINGERS = 3
"""Joints 0 to 5 bend the fingers, two each; 6 and 7 spread the first two. Finger 3 is the palm."""

UNBOUNDED = {"torque_min": -np.inf, "torque_max": np.inf}
VARIANTS: dict[str, dict[str, Any]] = {
    "as drawn": {},
    "three contacts": {"contacts": 3},
    "uncapped": {"normal_max": np.inf},
    "uncapped, no torque limit": {"normal_max": np.inf, **UNBOUNDED},
    "one-sided torque limits": {"normal_max": np.inf, "torque_min": -np.inf},
    "weak joints": {"torque_min": -0.1, "torque_max": 0.1},
    "weak joints, uncapped": {"torque_min": -0.1, "torque_max": 0.1, "normal_max": np.inf},
    "slippery": {"friction": 0.1},
    "slippery, unbounded": {"friction": 0.1, "normal_max": np.inf, **UNBOUNDED},
    "frictionless": {"friction": 0.0},
    "frictionless, unbounded": {
        "friction": 0.0,
        "contacts": 8,
        "normal_max": np.inf,
        "normal_min": 0.0,
        **UNBOUNDED,
    },
    "pinned normal forces": {"normal_min": 5.0, "normal_max": 5.0},
    "external torque over the limit": {"external_torque": 3.0, "torque_max": 2.95},
    "tiny load": {"external_wrench": np.full(6, 1e-9), "normal_min": 0.0},
    "no load": {"external_wrench": np.zeros(6), "normal_min": 0.0},
    "huge load": {"external_wrench": np.full(6, 1e6), "normal_max": np.inf, **UNBOUNDED},
}
"""Settings of `random_problem` that matter to solvers, by name."""


def random_rotation(rng: np.random.Generator) -> Array:
    """(3, 3) uniform rotation."""
    basis, triangle = np.linalg.qr(rng.standard_normal((3, 3)))
    basis = basis * np.sign(np.diag(triangle))
    return basis if np.linalg.det(basis) > 0 else -basis


def skew(vector: Array) -> Array:
    """(3, 3) matrix of the cross product with `vector`."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def random_problem(
    rng: np.random.Generator, contacts: int = 4, **overrides: Any
) -> GraspForceProblem:
    """A problem with well-spread contacts on an ellipsoid of a few centimetres; mostly feasible.

    Args:
        rng: source of everything random.
        contacts: how many, at least 3.
        overrides: fields to set; numbers are repeated over contacts or joints.
    """
    radii = rng.uniform(0.015, 0.04, 3)
    directions = _spread_directions(rng, contacts)
    positions = radii * directions
    frames = np.stack(
        [_contact_frame(rng, -direction / radii) for direction in directions]
    )  # (n, 3, 3), columns t1, t2, n
    grasp_map = np.hstack(
        [np.vstack([frame, skew(p) @ frame]) for p, frame in zip(positions, frames, strict=True)]
    )
    weight = rng.uniform(1.0, 5.0) * random_rotation(rng)[0]
    torque = rng.uniform(0.0, 0.05) * random_rotation(rng)[0]
    limit = rng.uniform(0.5, 2.0, N_JOINTS)
    fields: dict[str, Any] = {
        "grasp_map": grasp_map,
        "hand_jacobian": _hand_jacobian(rng, positions, frames),
        "friction": rng.uniform(0.4, 1.0, contacts),
        "torque_min": -limit,
        "torque_max": limit * rng.uniform(0.5, 1.0, N_JOINTS),
        "external_wrench": np.concatenate([weight, torque]),
        "external_torque": rng.uniform(-0.05, 0.05, N_JOINTS),
        "normal_min": rng.choice([0.0, 0.5, 2.0]) * rng.uniform(0.5, 1.0, contacts),
        "normal_max": rng.choice([20.0, 40.0, np.inf]) * rng.uniform(0.5, 1.0, contacts),
    }
    for name, value in overrides.items():
        like = fields.get(name)
        repeat = like is not None and np.ndim(value) == 0 and name != "objective"
        fields[name] = np.full(np.shape(like), value, dtype=float) if repeat else value
    return GraspForceProblem(**fields)


def feasible_problem(
    rng: np.random.Generator, contacts: int = 4, **overrides: Any
) -> GraspForceProblem:
    """The first `random_problem` that has an optimum."""
    drawn = (random_problem(rng, contacts, **overrides) for _ in range(100))
    return next(one for one in drawn if solve(one, "clarabel").status == "optimal")


def random_batch(
    rng: np.random.Generator, count: int, contacts: int | None = None, **overrides: Any
) -> GraspForceProblem:
    """A batch of `random_problem`s; by default with 3 to 8 contacts each, padded."""
    sizes = rng.integers(3, 9, count) if contacts is None else np.full(count, contacts)
    return GraspForceProblem.stack([random_problem(rng, int(n), **overrides) for n in sizes])


def uneven_batch(
    rng: np.random.Generator, count: int, contacts: int, **overrides: Any
) -> GraspForceProblem:
    """A batch with unequal preloads, caps and friction, some of it zero.

    Each torque limit is missing or weak at random.
    """
    limit = 10.0 ** rng.uniform(-1.5, 1.0, (2, count, N_JOINTS))
    limit[rng.random(limit.shape) < 0.3] = np.inf
    problems = [
        random_problem(
            rng,
            contacts,
            torque_min=-lower,
            torque_max=upper,
            normal_min=rng.uniform(0.0, 2.0, contacts) * rng.integers(0, 2, contacts),
            normal_max=rng.choice([5.0, 20.0, np.inf], contacts),
            friction=rng.uniform(0.0, 1.0, contacts) * (rng.random(contacts) < 0.9),
            **overrides,
        )
        for lower, upper in zip(*limit, strict=True)
    ]
    return GraspForceProblem.stack(problems)


def forces_in_cones(rng: np.random.Generator, problem: GraspForceProblem) -> Array:
    """(3n,) random forces of a single problem inside its cones, some within 0.1 % of an edge.

    Not on it: forces that alone keep all constraints cannot be found in floating point.
    """
    count = problem.n_contacts
    share = 1e-3 + 0.998 * rng.uniform(0.0, 1.0, count) * rng.integers(0, 2, count)
    normal = problem.normal_min + share * np.minimum(problem.normal_max - problem.normal_min, 20.0)
    size = problem.friction * normal * rng.choice([0.0, 0.5, 0.999], count)
    angle = rng.uniform(0.0, 2 * np.pi, count)
    return np.stack([size * np.cos(angle), size * np.sin(angle), normal], axis=-1).reshape(-1)


def solved_by(
    rng: np.random.Generator, problem: GraspForceProblem, forces: Array
) -> GraspForceProblem:
    """The problem with its load and torque limits moved so that `forces` satisfy all of them."""
    torque = problem.hand_jacobian.T @ forces + problem.external_torque
    slack = rng.uniform(0.0, 0.5, (2, problem.n_joints)) * rng.integers(0, 2, (2, problem.n_joints))
    slack += 1e-3
    return problem.replace(
        external_wrench=-problem.grasp_map @ forces,
        torque_min=np.where(np.isfinite(problem.torque_min), torque - slack[0], -np.inf),
        torque_max=np.where(np.isfinite(problem.torque_max), torque + slack[1], np.inf),
    )


def _spread_directions(rng: np.random.Generator, count: int) -> Array:
    """(count, 3) unit vectors, each the farthest of a few candidates from those before it."""
    chosen = np.empty((0, 3))
    while len(chosen) < count:
        candidates = rng.standard_normal((10, 3))
        candidates /= np.linalg.norm(candidates, axis=1, keepdims=True)
        nearest = (candidates @ chosen.T).max(axis=1, initial=-1.0)
        chosen = np.vstack([chosen, candidates[np.argmin(nearest)]])
    return chosen


def _contact_frame(rng: np.random.Generator, inward: Array) -> Array:
    """(3, 3) columns (t1, t2, n), n near `inward`, the tangents turned at random."""
    normal = inward / np.linalg.norm(inward) + rng.normal(0.0, 0.1, 3)
    normal /= np.linalg.norm(normal)
    tangent = np.cross(normal, rng.standard_normal(3))
    tangent /= np.linalg.norm(tangent)
    return np.column_stack([tangent, np.cross(normal, tangent), normal])


def _hand_jacobian(rng: np.random.Generator, positions: Array, frames: Array) -> Array:
    """(3n, N_JOINTS) of a hand whose joint axes pass a few centimetres from the contacts."""
    finger = rng.permutation(np.arange(len(positions)) % (FINGERS + 1))
    jacobian = np.zeros((len(positions), 3, N_JOINTS))
    for joint in range(N_JOINTS):
        axis = random_rotation(rng)[0]
        origin = 0.06 * random_rotation(rng)[0]
        moved = finger == (joint // 2 if joint < 2 * FINGERS else joint - 2 * FINGERS)
        velocity = np.cross(axis, positions[moved] - origin)
        jacobian[moved, :, joint] = np.einsum("kij,ki->kj", frames[moved], velocity)
    return jacobian.reshape(-1, N_JOINTS)
