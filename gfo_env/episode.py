"""One grasp under a sequence of announced loads: what happens between two observations."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from solvers import GraspForceProblem

from .acquisition import Grasp, attempt
from .contacts import read_contacts
from .exceptions import AcquisitionError
from .grasp_problem import problem_fields
from .holding import JOINT_FRICTION, ShakeProtocol, motion_since
from .objects import GraspObject, ObjectSet
from .observation import can_balance
from .quality import is_force_closure, lowest_resisted_wrench
from .simulation import Simulation

Array = NDArray[np.float64]

SUBSTEPS = 12
"""Simulation steps of 1/240 s for which commanded forces last: 0.05 s."""

LOAD_STEPS = 6
"""Commands for which one load lasts: 0.3 s, as in `ShakeProtocol`."""

QUALITY_EDGES = 4
"""Edges of the pyramids for q_lrw: 0.8 ms a step with five contacts, where eight take 2.3 ms."""

LARGEST_OBJECT = 1.0
"""m: an object that reaches farther from its centre of mass is not for a hand."""

SURVIVAL = ShakeProtocol()
"""What counts as lost is the same as when a grasp is shaken."""

_MAX_ATTEMPTS = 50


class Episode:
    """A grasp that is loaded step by step, in a simulation that this episode has for itself.

    Args:
        simulation: any; it is loaded anew.
        grasp_object: with the mass to carry.
        start: the grasp of it.
        friction: the true coefficient.
        gravity: (3,) m/s2, hand frame.
        pushes: (loads, 3) N at the centre of mass, hand frame, one after the other.
        max_contacts: most contacts to tell of.
        preload: N, least normal force that the problem asks for.
        cap: N, largest normal force that it allows.

    Attributes:
        steps: commands so far.
        present: the grasp as it is now.
        fields: of the problem of the coming step; see `grasp_problem.problem_fields`.
        problem: the same as a problem; None if the contacts cannot balance every load.
    """

    def __init__(
        self,
        simulation: Simulation,
        grasp_object: GraspObject,
        start: Grasp,
        *,
        friction: float,
        gravity: Array,
        pushes: Array,
        max_contacts: int,
        preload: float,
        cap: float,
    ) -> None:
        self.simulation = simulation
        self.grasp_object = grasp_object
        self.start = start
        self.friction = friction
        self.gravity = gravity
        self.pushes = pushes
        self.max_contacts = max_contacts
        self.preload = preload
        self.cap = cap
        self.steps = 0
        simulation.load(grasp_object, start.pose, start.joint_angles, friction=friction)
        simulation.set_gravity(gravity)
        simulation.set_joint_friction(JOINT_FRICTION)
        self._face(start)

    @property
    def push(self) -> Array:
        """(3,) N, hand frame: of the coming step, or of the last when none is to come."""
        return np.asarray(self.pushes[min(self.steps // LOAD_STEPS, len(self.pushes) - 1)])

    @property
    def load(self) -> Array:
        """(3,) N, hand frame: weight and push of the coming step."""
        return self.grasp_object.mass * self.gravity + self.push

    def advance(self, forces: Array) -> None:
        """Command contact forces, (3n,) N, for one step, and read the contacts anew.

        The joints have no other motor than the torques J_h' f plus what carries the links, clipped
        to the hand's limits, and a little dry friction.
        """
        limits = np.array(self.simulation.hand.max_torque)
        torques = forces @ self.fields["hand_jacobian"] + self.fields["external_torque"]
        torques = np.clip(torques, -limits, limits)
        push = np.append(self.push, np.zeros(3))
        for _ in range(SUBSTEPS):
            self.simulation.push_object(push)
            self.simulation.apply_torques(torques)
            self.simulation.step()
        self.steps += 1
        pose = self.simulation.object_pose()
        contacts = read_contacts(self.simulation, self.grasp_object.solid, pose, self.max_contacts)
        joint_angles, _ = self.simulation.joint_state()
        gravity_map = self.simulation.gravity_map()
        self._face(Grasp(self.start.object_id, pose, joint_angles, contacts, gravity_map))

    def motion(self) -> float:
        """How far the object has moved or turned in the hand, over what counts as lost."""
        displacement, rotation = motion_since(self.simulation, self.start)
        return max(
            displacement / SURVIVAL.max_displacement, rotation / float(SURVIVAL.max_rotation)
        )

    def lost(self) -> bool:
        """Whether the object has moved or turned too far, or nothing touches it."""
        return self.motion() >= 1.0 or len(self.present.contacts) == 0

    def closes(self) -> bool:
        """Whether the present contacts can resist every load, given forces enough."""
        contacts = self.present.contacts
        return is_force_closure(contacts.positions, contacts.normals, self._frictions())

    def q_lrw(self, forces: Array) -> float:
        """N: lower bound of q_lrw of the normal forces among `forces`, (3n,) N, that push."""
        contacts = self.present.contacts
        return lowest_resisted_wrench(
            contacts.positions,
            contacts.normals,
            self._frictions(),
            normal_forces=np.maximum(forces[2::3], 0.0),
            edges=QUALITY_EDGES,
            length=self.grasp_object.radius,
        ).lower

    def _frictions(self) -> Array:
        return np.full(len(self.present.contacts), self.friction)

    def _face(self, present: Grasp) -> None:
        """Pose the problem of the coming step with the contacts as they are."""
        self.present = present
        self.fields = problem_fields(
            present,
            self.simulation.hand,
            np.append(self.load, np.zeros(3)),
            self.gravity,
            friction=self.friction,
            preload=self.preload,
            cap=self.cap,
        )
        self.problem: GraspForceProblem | None = None
        if can_balance(self.fields["grasp_map"]):
            self.problem = GraspForceProblem(**self.fields)


def acquire(
    objects: ObjectSet, simulation: Simulation, rng: np.random.Generator, max_contacts: int
) -> tuple[GraspObject, Grasp]:
    """Draw objects and try to grasp each once, until a grasp can balance every load.

    Args:
        objects: to draw from.
        simulation: any; it is loaded anew.
        rng: source of every random choice.
        max_contacts: the strongest contacts to keep.

    Raises:
        AcquisitionError: 50 attempts failed, or an object is too large for any hand.
    """
    outcomes: dict[str, int] = {}
    for _ in range(_MAX_ATTEMPTS):
        grasp_object = objects[objects.object_ids[rng.integers(len(objects))]]
        if grasp_object.radius > LARGEST_OBJECT:
            raise AcquisitionError(
                f"Object {grasp_object.object_id!r} of {objects.name} reaches "
                f"{grasp_object.radius:.3g} m from its centre of mass, too far for this hand: "
                "is its mesh in metres?"
            )
        result = attempt(grasp_object, simulation, rng)
        reason: str = result.outcome
        if result.grasp is not None:
            pose = result.grasp.pose
            kept = read_contacts(simulation, grasp_object.solid, pose, max_contacts)
            if can_balance(kept.grasp_map()):
                return grasp_object, replace(result.grasp, contacts=kept)
            reason = f"the {max_contacts} strongest contacts cannot balance every load"
        outcomes[reason] = outcomes.get(reason, 0) + 1
    counts = ", ".join(f"{count} x {reason}" for reason, count in outcomes.items())
    raise AcquisitionError(
        f"None of {_MAX_ATTEMPTS} attempts to grasp objects of {objects.name} succeeded "
        f"({counts}): use objects 3 to 15 cm across, thicker than 1 cm, and max_contacts=8."
    )
