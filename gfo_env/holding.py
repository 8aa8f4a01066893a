"""Does a grasp hold? Commanded forces become joint torques, and the simulator shakes the object."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from .acquisition import Grasp
from .conditions import STANDARD_GRAVITY
from .objects import GraspObject
from .simulation import TIME_STEP, Simulation

JOINT_FRICTION = 0.005
"""N·m of dry friction in every joint. Ten times more hides bad forces and spoils good ones."""

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ShakeProtocol:
    """What a held object must survive: its weight, then its weight with a push from six sides.

    Every load lasts `phase_time` seconds, one after the other, without a pause. A push acts at the
    centre of mass along +x, -x, +y, -y, +z, -z of the hand frame. The grasp holds if at the end of
    each phase the object has moved and turned less than the two thresholds since the start.

    Args:
        push: N.
        phase_time: s.
        max_displacement: m, of the centre of mass in the hand frame.
        max_rotation: rad.
    """

    push: float = 2.0
    phase_time: float = 0.3
    max_displacement: float = 0.025
    max_rotation: float = np.deg2rad(30.0)

    @property
    def phases(self) -> int:
        """Number of loads."""
        return 7

    def loads(self, mass: float, gravity: Array) -> Array:
        """(phases, 6) wrenches on the object, hand frame, N and N·m: weight alone, then six pushes.

        Args:
            mass: kg.
            gravity: (3,) m/s2, hand frame.
        """
        loads = np.zeros((self.phases, 6))
        loads[:, :3] = mass * gravity
        loads[1::2, :3] += self.push * np.eye(3)
        loads[2::2, :3] -= self.push * np.eye(3)
        return loads


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
    time_step: float = TIME_STEP,
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
        time_step: s.
    """
    limits = np.array(simulation.hand.max_torque)
    carry = grasp.gravity_map @ gravity
    torques = np.clip(forces @ grasp.contacts.jacobian + carry, -limits, limits)
    pushes = protocol.loads(0.0, gravity)
    simulation.load(
        grasp_object, grasp.pose, grasp.joint_angles, friction=friction, time_step=time_step
    )
    simulation.set_gravity(gravity)
    simulation.set_joint_friction(JOINT_FRICTION)
    steps = round(protocol.phase_time / time_step)
    for phase in range(protocol.phases):
        for _ in range(steps):
            simulation.push_object(pushes[phase])
            simulation.apply_torques(torques[phase])
            simulation.step()
        displacement, rotation = motion_since(simulation, grasp)
        if displacement >= protocol.max_displacement or rotation >= protocol.max_rotation:
            return HoldResult(phase, False, displacement, rotation)
    return HoldResult(protocol.phases, True, displacement, rotation)


def motion_since(simulation: Simulation, grasp: Grasp) -> tuple[float, float]:
    """Displacement (m) and rotation (rad) of the object in the hand since its acquisition."""
    pose = simulation.object_pose()
    turned = Rotation.from_matrix(grasp.pose.rotation.T @ pose.rotation).magnitude()
    return float(np.linalg.norm(pose.position - grasp.pose.position)), float(turned)
