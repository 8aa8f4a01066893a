"""Does a grasp hold? Commanded forces become joint torques, and the simulator shakes the object."""

from dataclasses import dataclass

import numpy as np

from gfo_env.checks import checked_array, is_number, is_whole
from gfo_env.conditions import JOINT_FRICTION, STANDARD_GRAVITY
from gfo_env.grasps.acquisition import Grasp
from gfo_env.hand import HandDescription
from gfo_env.objects import GraspObject
from gfo_env.simulation import SOLVER_ITERATIONS, TIME_STEP, Simulation
from solvers import GraspForceError
from solvers.arrays import Array

_LONGEST_STEP = 0.02


class HoldingError(GraspForceError, ValueError):
    """A setting of a shake that makes no sense, or nothing that could be shaken."""


@dataclass(frozen=True)
class ShakePhysics:
    """What the simulator is told while an object is held; docs/physics.md measures each.

    Args:
        time_step: s.
        iterations: of the contact solver, at each step.
        joint_friction: N·m, dry, in every joint.
        joint_damping: N·m·s, viscous, in every joint.

    Raises:
        HoldingError: a setting that no simulator could use.
    """

    time_step: float = TIME_STEP
    iterations: int = SOLVER_ITERATIONS
    joint_friction: float = JOINT_FRICTION
    joint_damping: float = 0.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not is_number(value):
                raise HoldingError(f"{name} must be a number, not {value!r}")
        if not 0.0 < self.time_step <= _LONGEST_STEP:
            raise HoldingError(
                f"the time step is {self.time_step} s; it must be above 0, at most {_LONGEST_STEP}"
            )
        if not (is_whole(self.iterations) and self.iterations >= 1):
            raise HoldingError(
                f"there are {self.iterations} iterations; a whole number is due, 1 at least"
            )
        if not (0.0 <= self.joint_friction < np.inf and 0.0 <= self.joint_damping < np.inf):
            raise HoldingError("friction and damping of the joints must be 0 or more, and finite")


@dataclass(frozen=True)
class ShakeProtocol:
    """What a held object must survive: its weight, then its weight with disturbances, one by one.

    Every load lasts `phase_time` seconds, without a pause between them, and acts at the centre of
    mass: first the weight alone; then, each together with the weight, a force along +x, -x, +y,
    -y, +z, -z of the hand frame; then, if the protocol has torques, a torque about the same six
    directions. The grasp holds if at the end of each phase the object has moved and turned less
    than the two thresholds since the start.

    `SHAKE_PROTOCOLS` has two: `push`, of 2 N whatever the object weighs, and `weight`, whose
    forces are multiples of the object's weight and whose torques are multiples of its weight times
    its radius.

    Args:
        push: N, size of the forces.
        weight_push: size of the forces that is added to `push`, in multiples of the weight.
        weight_torque: size of the torques, in multiples of the weight times the object's radius.
        phase_time: s.
        max_displacement: m, of the centre of mass in the hand frame.
        max_rotation: rad.

    Raises:
        HoldingError: a number that is none, is not finite, or is below zero; a time or a threshold
            of zero.
    """

    push: float = 2.0
    weight_push: float = 0.0
    weight_torque: float = 0.0
    phase_time: float = 0.3
    max_displacement: float = 0.025
    max_rotation: float = np.deg2rad(30.0)

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (is_number(value) and 0.0 <= value < np.inf):
                raise HoldingError(f"{name} must be a number >= 0, not {value!r}")
        for name in ("phase_time", "max_displacement", "max_rotation"):
            if getattr(self, name) == 0.0:
                raise HoldingError(f"{name} must be above 0")

    @property
    def phases(self) -> int:
        """Number of loads."""
        return 13 if self.weight_torque else 7

    def disturbances(self, weight: float, radius: float = 0.0) -> Array:
        """(phases, 6) wrenches besides the weight, hand frame, N and N·m; the first is none.

        Args:
            weight: N.
            radius: m, largest distance of the object's surface from its centre of mass; only
                torques depend on it.
        """
        sides = np.stack([np.eye(3), -np.eye(3)], axis=1).reshape(6, 3)
        wrenches = np.zeros((self.phases, 6))
        wrenches[1:7, :3] = (self.push + self.weight_push * weight) * sides
        if self.weight_torque:
            wrenches[7:, 3:] = self.weight_torque * weight * radius * sides
        return wrenches

    def loads(self, mass: float, gravity: Array, radius: float = 0.0) -> Array:
        """(phases, 6) wrenches on the object, hand frame, N and N·m: weight and disturbances.

        Args:
            mass: kg.
            gravity: (3,) m/s2, hand frame.
            radius: m, see `disturbances`.

        Raises:
            HoldingError: gravity has another shape or is not finite.
        """
        gravity = checked_array("gravity", gravity, (3,), HoldingError)
        loads = self.disturbances(mass * float(np.linalg.norm(gravity)), radius)
        loads[:, :3] += mass * gravity
        return loads


SHAKE_PROTOCOLS = {
    "push": ShakeProtocol(),
    "weight": ShakeProtocol(push=0.0, weight_push=1.0, weight_torque=0.25),
}
"""By name. Under `push` a 100 g object feels pushes of twice its weight, one of 500 g of 0.4 times;
under `weight` both feel the same."""


@dataclass(frozen=True, eq=False)
class HoldResult:
    """How a shake went.

    Args:
        phases_held: phases survived before the object moved or turned too far.
        held: all of them.
        displacement: m, of the centre of mass when the shake ended.
        rotation: rad, likewise.
    """

    phases_held: int
    held: bool
    displacement: float
    rotation: float


def random_gravity(rng: np.random.Generator) -> Array:
    """(3,) m/s2: standard gravity from a random side, as of a hand in a random orientation."""
    direction = rng.normal(size=3)
    return STANDARD_GRAVITY * direction / np.linalg.norm(direction)


def shake(
    simulation: Simulation,
    grasp: Grasp,
    grasp_object: GraspObject,
    forces: Array,
    gravity: Array,
    *,
    friction: float,
    protocol: ShakeProtocol = ShakeProtocol(),
    physics: ShakePhysics = ShakePhysics(),
) -> HoldResult:
    """Load the grasp, command the forces of each phase as joint torques, and see whether it holds.

    The joints have no other motor than these torques, J_h' f plus what carries the links, clipped
    to the hand's limits, and a little dry friction; the transmission's gears are not simulated.

    Args:
        simulation: any; it is loaded anew.
        grasp: where to start.
        grasp_object: with the mass to carry.
        forces: (phases, 3n) N, contact forces in the contact frames, one row per phase.
        gravity: (3,) m/s2, hand frame.
        friction: the true coefficient.
        protocol: loads and thresholds.
        physics: settings of the simulator.

    Raises:
        HoldingError: forces or gravity have another shape or are not finite, or the friction is no
            positive number.
    """
    count = 3 * len(grasp.contacts)
    forces = checked_array("forces", forces, (protocol.phases, count), HoldingError)
    gravity = checked_array("gravity", gravity, (3,), HoldingError)
    if not (is_number(friction) and 0.0 < friction < np.inf):
        raise HoldingError(f"friction must be a positive number, not {friction!r}")
    weight = grasp_object.mass * float(np.linalg.norm(gravity))
    torques = commanded_torques(simulation.hand, grasp, forces, gravity)
    disturbances = protocol.disturbances(weight, grasp_object.radius)
    simulation.load(
        grasp_object,
        grasp.pose,
        grasp.joint_angles,
        friction=friction,
        time_step=physics.time_step,
    )
    simulation.set_gravity(gravity)
    _set_physics(simulation, physics)
    steps = round(protocol.phase_time / physics.time_step)
    for phase in range(protocol.phases):
        simulation.advance(steps, torques[phase], disturbances[phase])
        displacement, rotation = motion_since(simulation, grasp)
        if displacement >= protocol.max_displacement or rotation >= protocol.max_rotation:
            return HoldResult(phase, False, displacement, rotation)
    return HoldResult(protocol.phases, True, displacement, rotation)


def commanded_torques(hand: HandDescription, grasp: Grasp, forces: Array, gravity: Array) -> Array:
    """(..., n_tau) N·m: what the joints are told, J_h' f plus what carries the links, clipped.

    Args:
        hand: with the limits.
        grasp: with the Jacobian J_h.
        forces: (..., 3n) N, in the contact frames.
        gravity: (3,) m/s2, hand frame.

    Raises:
        HoldingError: forces or gravity have another shape or are not finite.
    """
    count = 3 * len(grasp.contacts)
    forces = checked_array("forces", forces, (count,), HoldingError, batched=True)
    gravity = checked_array("gravity", gravity, (3,), HoldingError)
    limits = np.array(hand.max_torque)
    return np.clip(forces @ grasp.contacts.jacobian + grasp.gravity_map @ gravity, -limits, limits)


def _set_physics(simulation: Simulation, physics: ShakePhysics) -> None:
    """Joint friction as asked for, and whatever differs from what the simulation loads."""
    simulation.set_joint_friction(physics.joint_friction)
    p, client = simulation.bullet, simulation.client
    if physics.iterations != SOLVER_ITERATIONS:
        p.setPhysicsEngineParameter(numSolverIterations=physics.iterations, physicsClientId=client)
    if physics.joint_damping:
        for index in range(p.getNumJoints(simulation.hand_id, physicsClientId=client)):
            p.changeDynamics(
                simulation.hand_id,
                index,
                jointDamping=physics.joint_damping,
                physicsClientId=client,
            )


def motion_since(simulation: Simulation, grasp: Grasp) -> tuple[float, float]:
    """Displacement (m) and rotation (rad) of the object in the hand since its acquisition."""
    return simulation.object_pose().motion_from(grasp.pose)
