"""Grasp acquisition: put an object over the palm at random, close the fingers, read contacts."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gfo_env.contacts import LEAST_FORCE, Contacts, RawContacts, Surface, merge, read_contacts
from gfo_env.hand import HandDescription
from gfo_env.objects import GraspObject
from gfo_env.pose import Pose
from gfo_env.simulation import SOLVER_ITERATIONS, TIME_STEP, Simulation
from solvers.arrays import Array

MAX_CONTACTS = 8
LEAST_LINKS = 3
"""A grasp touches with at least so many links, palm included; that of two fingers with two."""

ACQUISITION_FRICTION = 0.8
"""Friction while closing; what the grasp is later asked to do may assume another."""

LARGEST_OBJECT = 1.0
"""m: an object that reaches farther from its centre of mass is not for a hand."""

_LATERAL_RANGE = 0.01
_PIN_FORCE = (20.0, 100.0)
_MAX_PENETRATION = 0.001
_STILL_SHARE = 0.02
_STILL_OBJECT = 0.01
_STILL_STEPS = 30
_LEAST_STEPS = 360
_CLOSED_SHARE = 0.9
_STOPPED = 7.0
_MOST_ITERATIONS = 1000
_STARTS = 10
_PLACES = 100


class Outcome(StrEnum):
    """How an attempt ended."""

    GRASP = "grasp"
    TOO_LARGE = "object reaches farther than 1 m from its centre: is its mesh in metres?"
    PENETRATION = "no start clear of the hand"
    LOST = "object lost while closing"
    FEW_LINKS = "fewer than three links touch, or two of a hand of two fingers"
    BESIDE_TIPS = "a link other than a fingertip touches"
    RANK = "grasp map of rank below six"


@dataclass(frozen=True)
class GraspStyle:
    """Where an object is held while the hand closes, and what may touch it.

    Args:
        clearance: m, range of the height of its lowest point above the palm.
        level: m, range of the height of its centre of mass above the middle of the palm.
        spread: range, as shares of the hand's range.
        settling_speed: of the closing joints once the object is released, as a share of the speed
            before. Slow fingers push away fewer objects that nothing but them holds.
        fingertips_only: whether a grasp in which another link touches is refused.
    """

    clearance: tuple[float, float]
    level: tuple[float, float]
    spread: tuple[float, float]
    settling_speed: float
    fingertips_only: bool


WHOLE_HAND = GraspStyle(
    clearance=(0.002, 0.020),
    level=(0.0, np.inf),
    spread=(0.0, 1.0),
    settling_speed=1.0,
    fingertips_only=False,
)
"""Any links, palm included."""

FINGERTIPS = GraspStyle(
    clearance=(0.030, 0.070),
    level=(0.080, 0.095),
    spread=(0.38, 0.89),
    settling_speed=0.15,
    fingertips_only=True,
)
"""Fingertips alone, their pads about as high as the centre of mass: for a hand of this size."""


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
    grasp_object: GraspObject,
    simulation: Simulation,
    rng: np.random.Generator,
    style: GraspStyle = WHOLE_HAND,
) -> Start:
    """A random orientation over the palm, as high as the style has it, and a random spread."""
    hand = simulation.hand
    lowest, highest = hand.spread_range
    (middle,) = hand.surface_height(np.zeros((1, 3)))
    for _ in range(_PLACES):
        rotation = Rotation.random(rng=rng).as_matrix()
        lateral = rng.uniform(-_LATERAL_RANGE, _LATERAL_RANGE, 2)
        clearance = rng.uniform(*style.clearance)
        turned = grasp_object.solid.vertices @ rotation.T + np.append(lateral, 0.0)
        height = clearance + np.max(hand.surface_height(turned) - turned[:, 2])
        if style.level[0] <= height - middle <= style.level[1]:
            break
    return Start(
        Pose(np.append(lateral, height), rotation),
        lowest + (highest - lowest) * rng.uniform(*style.spread),
        rng.uniform(*_PIN_FORCE),
    )


def attempt(
    grasp_object: GraspObject,
    simulation: Simulation,
    rng: np.random.Generator,
    watch: Watcher = lambda phase: None,
    style: GraspStyle = WHOLE_HAND,
) -> Attempt:
    """Try once to grasp: pin the object over the palm, close, release it, keep closing until still.

    Args:
        grasp_object: what to grasp.
        simulation: any; it is loaded anew. It is left in the grasped state.
        rng: source of every random choice.
        watch: told of the phases "pre-grasp", "closing" (many times) and "grasped".
        style: of the grasp.
    """
    if grasp_object.radius > LARGEST_OBJECT:
        return Attempt(Outcome.TOO_LARGE, None)
    hand = simulation.hand
    for draw in range(_STARTS):
        start = sample_start(grasp_object, simulation, rng, style)
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
    simulation.set_iterations(_closing_iterations(simulation))
    pin = simulation.hold_object(start.pin_force)
    strength = dict(zip(hand.joint_names, hand.max_torque, strict=True))
    simulation.drive(hand.held_joints, 0.0, [strength[name] for name in hand.held_joints])
    simulation.drive(hand.closing_joints, hand.closing_speeds, hand.closing_torques)
    steps = _closing_steps(hand)
    _run_until_still(simulation, steps, watch, with_object=False)
    simulation.release_object(pin)
    speeds = style.settling_speed * hand.closing_speeds
    simulation.drive(hand.closing_joints, speeds, hand.closing_torques)
    _run_until_still(simulation, steps // 2, watch, with_object=True)

    pose = simulation.object_pose()
    if np.linalg.norm(pose.position - start.pose.position) > grasp_object.radius + 0.1:
        return Attempt(Outcome.LOST, None)
    touching = simulation.contacts()
    if style.fingertips_only and not _links(touching, hand) <= set(hand.fingertip_links):
        return Attempt(Outcome.BESIDE_TIPS, None)
    posture, surface = simulation.posture(), Surface(grasp_object.solid)
    contacts = read_contacts(merge(touching, MAX_CONTACTS), posture, surface, pose)
    if len(set(contacts.links.tolist())) < least_links(hand):
        return Attempt(Outcome.FEW_LINKS, None)
    if not contacts.balanceable:
        return Attempt(Outcome.RANK, None)
    watch("grasped")
    joint_angles, _ = simulation.joint_state()
    grasp = Grasp(grasp_object.object_id, pose, joint_angles, contacts, posture.gravity_map())
    return Attempt(Outcome.GRASP, grasp)


def least_links(hand: HandDescription) -> int:
    """How many links touch in a grasp at least, palm included."""
    return LEAST_LINKS if len(hand.fingertip_links) >= LEAST_LINKS else 2


def _closing_steps(hand: HandDescription) -> int:
    """Time steps after which no joint closes any farther, 1.5 s at least."""
    return max(_LEAST_STEPS, math.ceil(_CLOSED_SHARE * max(hand.closing_times) / TIME_STEP))


def _closing_iterations(simulation: Simulation) -> int:
    """Iterations of the contact solver with which contacts, limits and gears stop every motor.

    In each iteration a motor pushes on, by what gives its joint the speed again, up to the torque
    that it has. A strong, slow motor of light links takes hundreds of iterations to get there; with
    fewer, joints go through what stops them, and geared ones apart.
    """
    hand = simulation.hand
    inertia = dict(zip(hand.joint_names, simulation.free_inertia().tolist(), strict=True))
    for gear in hand.gears:
        inertia[gear.driver] = min(inertia[gear.driver], inertia[gear.driven])
    momentum = [inertia[name] for name in hand.closing_joints] * np.abs(hand.closing_speeds)
    needed = _STOPPED * float(np.max(hand.closing_torques * TIME_STEP / momentum))
    return math.ceil(min(max(needed, SOLVER_ITERATIONS), _MOST_ITERATIONS))


def _still_speeds(hand: HandDescription, slides: NDArray[np.bool_]) -> Array:
    """(n_tau,) speeds up to which joints count as still [rad/s, of slides m/s].

    Those of closing joints are a share of the speed that each is told. Any other is measured by the
    fastest of its kind that closes, hinge or slide, and not at all if none does.
    """
    speeds = np.zeros(len(slides))
    closing = [hand.joint_names.index(name) for name in hand.closing_joints]
    speeds[closing] = np.abs(hand.closing_speeds)
    result = np.empty(len(slides))
    for kind in (slides, ~slides):
        result[kind] = np.max(speeds[kind], initial=0.0) or np.inf
    result[closing] = speeds[closing]
    return _STILL_SHARE * result


def _links(touching: RawContacts, hand: HandDescription) -> set[str]:
    """Names of all links that press on the object, however many contacts there are."""
    pressure = np.einsum("ki,ki->k", touching.forces, touching.normals)
    # the base is link -1, so the last name
    names = (*hand.link_names, hand.base_link)
    return {names[link] for link in touching.links[pressure > LEAST_FORCE]}


def _run_until_still(
    simulation: Simulation, limit: int, watch: Watcher, *, with_object: bool
) -> None:
    limits = _still_speeds(simulation.hand, simulation.slides)
    still = 0
    for _ in range(limit):
        simulation.step()
        watch("closing")
        _, speeds = simulation.joint_state()
        moving = np.any(np.abs(speeds) > limits)
        if with_object:
            moving = moving or np.linalg.norm(simulation.object_velocity()[0]) > _STILL_OBJECT
        still = 0 if moving else still + 1
        if still >= _STILL_STEPS:
            return
