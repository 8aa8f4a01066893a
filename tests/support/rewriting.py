"""Other ways to write down a problem: frames, units, order, padding."""

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from solvers import GraspForceProblem
from tests.support.problems import random_rotation, skew

Change = Callable[[GraspForceProblem, np.random.Generator], tuple[GraspForceProblem, Any, Any]]
"""A changed problem, the factor on the optimum, and the map of the forces."""


def scaled(problem: GraspForceProblem, unit: float, name: str) -> dict[str, Any]:
    """A field that only problems of quality have, in other units."""
    value = getattr(problem, name)
    return {} if value is None else {name: unit * value}


def turn_object(problem: GraspForceProblem, rng: np.random.Generator) -> Any:
    turn = block_diag(*[random_rotation(rng)] * 2)
    turn[3:, 3:] = turn[:3, :3]
    moved = problem.replace(
        grasp_map=turn @ problem.grasp_map, external_wrench=turn @ problem.external_wrench
    )
    return moved, lambda value, linear: value, lambda forces: forces


def move_origin(problem: GraspForceProblem, rng: np.random.Generator) -> Any:
    move = np.eye(6)
    move[3:, :3] = skew(rng.uniform(-0.05, 0.05, 3))
    moved = problem.replace(
        grasp_map=move @ problem.grasp_map, external_wrench=move @ problem.external_wrench
    )
    return moved, lambda value, linear: value, lambda forces: forces


def change_length(problem: GraspForceProblem, rng: np.random.Generator) -> Any:
    unit = 10.0 ** rng.uniform(-4, 4)
    rows = np.repeat([1.0, unit], 3)
    moved = problem.replace(
        grasp_map=rows[:, None] * problem.grasp_map,
        external_wrench=rows * problem.external_wrench,
        hand_jacobian=unit * problem.hand_jacobian,
        **{k: unit * getattr(problem, k) for k in ("torque_min", "torque_max", "external_torque")},
        **scaled(problem, unit, "characteristic_length"),
    )
    return moved, lambda value, linear: value, lambda forces: forces


def change_force(problem: GraspForceProblem, rng: np.random.Generator) -> Any:
    unit = 10.0 ** rng.uniform(-6, 6)
    names = ("external_wrench", "torque_min", "torque_max", "external_torque")
    moved = problem.replace(
        **{name: unit * getattr(problem, name) for name in (*names, "normal_min", "normal_max")},
        **scaled(problem, unit, "effort_budget"),
    )
    return moved, lambda v, linear: v * (unit if linear else unit**2), lambda f: unit * f


def turn_tangents(problem: GraspForceProblem, rng: np.random.Generator) -> Any:
    blocks = []
    for angle in rng.uniform(0, 2 * np.pi, problem.n_contacts):
        c, s = np.cos(angle), np.sin(angle)
        blocks.append(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]))
    turn = block_diag(*blocks)
    moved = problem.replace(
        grasp_map=problem.grasp_map @ turn, hand_jacobian=turn.T @ problem.hand_jacobian
    )
    return moved, lambda value, linear: value, lambda forces: turn.T @ forces


def shuffle_contacts(problem: GraspForceProblem, rng: np.random.Generator) -> Any:
    order = rng.permutation(problem.n_contacts)
    columns = (3 * order[:, None] + np.arange(3)).reshape(-1)
    names = ("friction", "normal_min", "normal_max", "contact_mask")
    moved = problem.replace(
        grasp_map=problem.grasp_map[:, columns],
        hand_jacobian=problem.hand_jacobian[columns],
        **{name: getattr(problem, name)[order] for name in names},
    )
    return moved, lambda value, linear: value, lambda forces: forces[columns]


def pad(problem: GraspForceProblem, rng: np.random.Generator) -> Any:
    moved = problem.pad(problem.n_contacts + 2)
    return moved, lambda value, linear: value, lambda f: np.append(f, np.zeros(6))


def pad_and_shuffle(problem: GraspForceProblem, rng: np.random.Generator) -> Any:
    padded, same, longer = pad(problem, rng)
    moved, _, shuffled = shuffle_contacts(padded, rng)
    return moved, same, lambda forces: shuffled(longer(forces))


def double_joints(problem: GraspForceProblem, rng: np.random.Generator) -> Any:
    names = ("torque_min", "torque_max", "external_torque")
    moved = problem.replace(
        hand_jacobian=np.hstack([problem.hand_jacobian] * 2),
        **{name: np.tile(getattr(problem, name), 2) for name in names},
    )
    return moved, lambda value, linear: value, lambda forces: forces


CHANGES: tuple[Change, ...] = (
    turn_object,
    move_origin,
    change_length,
    change_force,
    turn_tangents,
    shuffle_contacts,
    pad,
    pad_and_shuffle,
    double_joints,
)
