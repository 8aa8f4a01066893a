"""Grasp acquisition: put an object over the palm at random, close the fingers, read contacts."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from .contacts import Contacts, read_contacts
from .objects import GraspObject
from .observation import can_balance
from .pose import Pose
from .simulation import Simulation

MAX_CONTACTS = 8
LEAST_LINKS = 3
"""A grasp touches with at least so many links, palm included."""

ACQUISITION_FRICTION = 0.8
"""Friction while closing; what the grasp is later asked to do may assume another."""

_LATERAL_RANGE = 0.01
_CLEARANCE = (0.002, 0.020)
_SPREAD_RANGE = (0.0, np.pi / 2)
_PIN_FORCE = (20.0, 100.0)
_MAX_PENETRATION = 0.001
_SPREAD_TORQUE = 2.0
_STILL_JOINT = 0.03
_STILL_OBJECT = 0.01
_STILL_STEPS = 30
_CLOSING_STEPS = 360
_SETTLING_STEPS = 180
_STARTS = 10

Array = NDArray[np.float64]


class Outcome(StrEnum):
    """How an attempt ended."""

    GRASP = "grasp"
    PENETRATION = "no start clear of the hand"
    LOST = "object lost while closing"
    FEW_LINKS = "fewer than three links touch"
    RANK = "grasp map of rank below six"


@dataclass(frozen=True, eq=False)
class Grasp:
    """A hand closed on an object: everything that is needed to come back to it.

    Args:
        object_id: in the object's set.
        pose: of the object frame in the hand frame.
        joint_angles: (n_tau,) rad.
        contacts: in the object frame.
        gravity_map: (n_tau, 3) joint torques that carry the hand's links, per gravity in the hand
            frame, N·m/(m/s2).
    """

    object_id: str
    pose: Pose
    joint_angles: Array
    contacts: Contacts
    gravity_map: Array


@dataclass(frozen=True, eq=False)
class Attempt:
    """One try: its outcome, and the grasp if there is one."""

    outcome: Outcome
    grasp: Grasp | None


@dataclass(frozen=True, eq=False)
class Start:
    """The random choices of an attempt.

    Args:
        pose: of the object in the hand frame before the hand closes.
        spread: rad.
        pin_force: N, what holds the object while the fingers come.
    """

    pose: Pose
    spread: float
    pin_force: float


Watcher = Callable[[str], None]
"""Called with the name of a phase when the simulation has reached its end."""


def sample_start(
    grasp_object: GraspObject, simulation: Simulation, rng: np.random.Generator
) -> Start:
    """A random orientation, lowest point 2 to 20 mm above the palm, and a random spread."""
    rotation = Rotation.random(rng=rng).as_matrix()
    lateral = rng.uniform(-_LATERAL_RANGE, _LATERAL_RANGE, 2)
    clearance = rng.uniform(*_CLEARANCE)
    turned = grasp_object.solid.vertices @ rotation.T + np.append(lateral, 0.0)
    floor = simulation.hand.surface_height(turned)
    height = clearance + np.max(floor - turned[:, 2])
    return Start(
        Pose(np.append(lateral, height), rotation),
        rng.uniform(*_SPREAD_RANGE),
        rng.uniform(*_PIN_FORCE),
    )


def attempt(
    grasp_object: GraspObject,
    simulation: Simulation,
    rng: np.random.Generator,
    watch: Watcher = lambda phase: None,
) -> Attempt:
    """Try once to grasp: pin the object over the palm, close, release it, keep closing until still.

    Args:
        grasp_object: what to grasp.
        simulation: any; it is loaded anew. It is left in the grasped state.
        rng: source of every random choice.
        watch: told of the phases "pre-grasp", "closing" (many times) and "grasped".
    """
    hand = simulation.hand
    for draw in range(_STARTS):
        start = sample_start(grasp_object, simulation, rng)
        angles = hand.open_angles(start.spread)
        if draw == 0:
            simulation.load(grasp_object, start.pose, angles, friction=ACQUISITION_FRICTION)
        else:
            simulation.place(start.pose, angles)
        if simulation.penetration() <= _MAX_PENETRATION:
            break
    else:
        return Attempt(Outcome.PENETRATION, None)
    watch("pre-grasp")
    simulation.couple()
    pin = simulation.hold_object(start.pin_force)
    simulation.drive(hand.spread_joints, 0.0, _SPREAD_TORQUE)
    simulation.drive(hand.closing_joints, hand.closing_speed, hand.closing_torque)
    _run_until_still(simulation, _CLOSING_STEPS, watch, with_object=False)
    simulation.release_object(pin)
    _run_until_still(simulation, _SETTLING_STEPS, watch, with_object=True)

    pose = simulation.object_pose()
    if np.linalg.norm(pose.position - start.pose.position) > grasp_object.radius + 0.1:
        return Attempt(Outcome.LOST, None)
    contacts = read_contacts(simulation, grasp_object.solid, pose, MAX_CONTACTS)
    if len(set(contacts.links.tolist())) < LEAST_LINKS:
        return Attempt(Outcome.FEW_LINKS, None)
    if not can_balance(contacts.grasp_map()):
        return Attempt(Outcome.RANK, None)
    watch("grasped")
    joint_angles, _ = simulation.joint_state()
    grasp = Grasp(grasp_object.object_id, pose, joint_angles, contacts, simulation.gravity_map())
    return Attempt(Outcome.GRASP, grasp)


def _run_until_still(
    simulation: Simulation, limit: int, watch: Watcher, *, with_object: bool
) -> None:
    still = 0
    for _ in range(limit):
        simulation.step()
        watch("closing")
        _, speeds = simulation.joint_state()
        moving = np.max(np.abs(speeds)) > _STILL_JOINT
        if with_object:
            moving = moving or np.linalg.norm(simulation.object_velocity()[0]) > _STILL_OBJECT
        still = 0 if moving else still + 1
        if still >= _STILL_STEPS:
            return
