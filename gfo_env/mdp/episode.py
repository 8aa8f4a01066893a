"""One grasp under a schedule of loads: what happens between two observations."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gfo_env.conditions import JOINT_FRICTION
from gfo_env.contacts import Contacts, Surface, closes, lowest_resisted_wrench
from gfo_env.grasps.problem import ForceLimits, carrying_torques, in_object_frame
from gfo_env.grasps.source import StoredGrasp
from gfo_env.hand import HandDescription
from gfo_env.holding import ShakeProtocol
from gfo_env.objects import GraspObject
from gfo_env.pose import Pose
from gfo_env.simulation import TIME_STEP, Simulation
from solvers import GraspForceProblem
from solvers.arrays import Array

from .actions import joint_torques
from .force_quality import residuals_and_quality
from .loads import LoadSchedule
from .observation import Observation, pack
from .reading import Reader, Reading
from .reward import ForceMeasures, evaluate_forces, holding_simulated, holding_static

CONTROL_PERIOD = 0.05
"""s for which commanded forces last."""

SUBSTEPS = round(CONTROL_PERIOD / TIME_STEP)
"""Simulation steps of a control period."""

SURVIVAL = ShakeProtocol()
"""What counts as lost is the same as when a grasp is shaken."""

STATIC_MISFIT = 0.1
"""Misfit (`reward.ForceMeasures.misfit`) below which forces count as a success in static mode. Of
forces that are off by so much, most hold in the simulator; see docs/physics.md."""


@dataclass(frozen=True)
class EpisodeSettings:
    """What episodes have in common.

    Args:
        max_contacts: most contacts to tell of.
        max_force: N, largest component of a command, and the cap of normal forces.
        preload: N, least normal force that problems ask for.
        announced: whether problems tell of the coming load and friction, or of what was known in
            the beginning: the weight.
        fingertips: whether contacts of other links are kept quiet about.
        exact_quality: whether q_lrw is that of a hull, instead of an estimate.
    """

    max_contacts: int
    max_force: float
    preload: float
    announced: bool
    fingertips: bool
    exact_quality: bool


@dataclass(frozen=True, eq=False)
class Hold:
    """How an object is held at the beginning of a step; see `acquisition.Grasp`."""

    pose: Pose
    contacts: Contacts
    gravity_map: Array


class Episode(ABC):
    """A grasp that is loaded step by step.

    Args:
        settings: of the environment.
        hand: that holds.
        stored: the grasp to begin with.
        schedule: of the loads.
        torque_scale: factor on the hand's torque limits.

    Attributes:
        step: number of the coming step; the last one's when none is to come.
        present: how the object is held now.
        fields: of the problem that the agent is told of the coming step, see
            `gfo_env.grasps.problem.ForceLimits.fields`.
    """

    def __init__(
        self,
        settings: EpisodeSettings,
        hand: HandDescription,
        stored: StoredGrasp,
        schedule: LoadSchedule,
        torque_scale: float,
    ) -> None:
        self.settings = settings
        self.hand = hand
        self.start = stored.grasp
        self.radius = stored.radius
        self.schedule = schedule
        self.torque_scale = torque_scale
        self.step = 0
        self._strongest = max(hand.max_torque)
        self._limits = ForceLimits.of(
            hand, settings.max_contacts, settings.preload, settings.max_force, torque_scale
        )
        grasp = stored.grasp
        contacts = grasp.contacts.strongest(settings.max_contacts)
        self._face(
            Hold(grasp.pose, contacts, grasp.gravity_map),
            in_object_frame(schedule.wrench(0), grasp.pose),
            carrying_torques(schedule.gravity[0], grasp.gravity_map),
        )

    @property
    def load(self) -> Array:
        """(6,) N and N·m on the object in the coming step, hand frame, announced or not."""
        return self.schedule.wrench(self.step)

    @property
    def friction(self) -> float:
        """True coefficient in the coming step."""
        return float(self.schedule.friction[self.step])

    def problem(self) -> GraspForceProblem | None:
        """The problem of the coming step as it is; None if no force can balance every load."""
        if not self.present.contacts.balanceable:
            return None
        return GraspForceProblem.unchecked(self._true)

    def measure(self, forces: Array) -> ForceMeasures:
        """How forces, (3n,) N, do on the problem of the coming step."""
        residuals, q_lrw = None, 0.0
        if self.present.contacts.balanceable:
            residuals, q_lrw = residuals_and_quality(self._true, forces, self.radius)
            if self.settings.exact_quality:
                q_lrw = self._exact_quality(forces)
        return evaluate_forces(
            residuals,
            forces,
            q_lrw=q_lrw,
            load=self.schedule.force(self.step),
            max_force=self.settings.max_force,
            max_torque=self._strongest,
        )

    def _exact_quality(self, forces: Array) -> float:
        """N: q_lrw of the hull for the normal forces among `forces`, (3n,) N, that push."""
        contacts = self.present.contacts
        return lowest_resisted_wrench(
            contacts.positions,
            contacts.normals,
            self._true["friction"],
            normal_forces=np.maximum(forces[2::3], 0.0),
            length=self.radius,
        ).lower

    def closes(self) -> bool:
        """Whether the present contacts can resist every load, given forces enough."""
        return closes(self.present.contacts, self.friction)

    @abstractmethod
    def advance(self, forces: Array, measures: ForceMeasures) -> None:
        """Command contact forces, (3n,) N, for one step; they have been measured."""

    @abstractmethod
    def lost(self) -> bool:
        """Whether the object is no longer held."""

    @abstractmethod
    def holding(self) -> float:
        """What the last step is worth for holding, from -1 to 1."""

    @abstractmethod
    def feedback(self) -> dict[str, Array]:
        """What a hand can feel, by the names of `observation.feedback_shapes`."""

    def observe(self, layout: Mapping[str, tuple[int, ...]]) -> Observation:
        """What the agent sees before the coming step, see `observation.pack`."""
        told = self.fields
        if not self.settings.announced:
            told = told | self.feedback()
        return pack(told, layout)

    def _face(self, present: Hold, wrench: Array, torque: Array) -> None:
        """Pose the problem of the coming step with the contacts as they are.

        Args:
            present: how the object is held.
            wrench: (6,) N and N·m, the load, object frame.
            torque: (n_tau,) N·m that carry the hand's links.
        """
        schedule, step = self.schedule, self.step
        self.present = present
        self._true = self._limits.fields(present.contacts, wrench, torque, self.friction)
        self.fields = self._true
        if not self.settings.announced:
            self.fields = self._true | {
                "friction": np.full(len(present.contacts), schedule.friction[0]),
                "external_wrench": in_object_frame(schedule.known_wrench(step), present.pose),
            }


class StaticEpisode(Episode):
    """A single problem: nothing moves, and forces are judged by statics. No simulator is needed."""

    def advance(self, forces: Array, measures: ForceMeasures) -> None:
        """Nothing moves."""
        self._measures = measures

    def lost(self) -> bool:
        """Whether the forces miss what statics asks for."""
        return self._measures.misfit >= STATIC_MISFIT

    def holding(self) -> float:
        """See `reward.holding_static`."""
        return holding_static(self._measures)

    def feedback(self) -> dict[str, Array]:
        """Joints and object at rest, and contacts as they were acquired, without friction."""
        contacts = self.present.contacts
        forces = np.zeros(3 * len(contacts))
        forces[2::3] = contacts.normal_forces
        return _feedback(self.start.joint_angles, np.zeros_like(self.start.joint_angles), forces)


class SimulatedEpisode(Episode):
    """The physics decide. The simulation belongs to this episode as long as it lasts.

    Args:
        settings, hand, stored, schedule, torque_scale: see `Episode`.
        simulation: any; it is loaded anew.
        grasp_object: of the grasp.
    """

    def __init__(
        self,
        settings: EpisodeSettings,
        hand: HandDescription,
        stored: StoredGrasp,
        schedule: LoadSchedule,
        torque_scale: float,
        simulation: Simulation,
        grasp_object: GraspObject,
    ) -> None:
        super().__init__(settings, hand, stored, schedule, torque_scale)
        self.simulation = simulation
        self.surface = Surface(grasp_object.solid)
        self._object = grasp_object.with_mass(float(schedule.mass[0]))
        simulation.load(
            self._object, self.start.pose, self.start.joint_angles, friction=self.friction
        )
        simulation.set_joint_friction(JOINT_FRICTION)
        simulation.set_gravity(schedule.gravity[0])
        links = {name: index for index, name in enumerate(hand.link_names)}
        tips = [links[name] for name in hand.fingertip_links] if settings.fingertips else None
        self._reader = Reader(simulation, self.surface, self.start.pose, tips, self._limits)
        self._motion = 0.0
        self._reading: Reading | None = None

    def advance(self, forces: Array, measures: ForceMeasures) -> None:
        """Command contact forces, (3n,) N, for one step, and read the contacts anew.

        The joints have no other motor than the torques J_h' f plus what carries the links, clipped
        to the limits, and a little dry friction.
        """
        fields = self.fields
        torques = joint_torques(
            forces, fields["hand_jacobian"], fields["external_torque"],
            fields["torque_min"], fields["torque_max"],
        )  # fmt: skip
        self.simulation.advance(SUBSTEPS, torques, self.schedule.push[self.step])
        if self.step + 1 < len(self.schedule):
            self.step += 1
            self._change_conditions()
        schedule, step = self.schedule, self.step
        now = self._reading = self._reader.read(
            schedule.wrench(step), schedule.gravity[step], self.friction
        )
        displacement, rotation = now.motion
        self._motion = max(
            displacement / SURVIVAL.max_displacement, rotation / float(SURVIVAL.max_rotation)
        )
        self._face(Hold(now.pose, now.contacts, now.gravity_map), now.wrench, now.torque)

    def closes(self) -> bool:
        """See `Episode.closes`."""
        return (self._reading is not None and self._reading.closes) or super().closes()

    def lost(self) -> bool:
        """Whether the object has moved or turned too far, or nothing touches it."""
        return self._motion >= 1.0 or len(self.present.contacts) == 0

    def holding(self) -> float:
        """See `reward.holding_simulated`."""
        return holding_simulated(self._motion, lost=self.lost())

    def observe(self, layout: Mapping[str, tuple[int, ...]]) -> Observation:
        """See `Episode.observe`."""
        if self._reading is None or not self.settings.announced:
            return super().observe(layout)
        return self._reader.observation(self._reading)

    def feedback(self) -> dict[str, Array]:
        """As the simulator has it; before the first step, contacts as they were acquired."""
        contacts, turn = self.present.contacts, self.present.pose.rotation
        forces = np.zeros((len(contacts), 3))
        forces[:, 2] = contacts.normal_forces
        angles, speeds = self.start.joint_angles, np.zeros_like(self.start.joint_angles)
        if self._reading is not None:
            angles, speeds = self.simulation.joint_state()
            in_object = self._reading.forces @ turn
            forces = np.einsum("kij,ki->kj", contacts.frames, in_object)
        linear, angular = self.simulation.object_velocity()
        velocity = np.concatenate([linear @ turn, angular @ turn])
        return _feedback(angles, speeds, forces.ravel(), velocity)

    def _change_conditions(self) -> None:
        """Give the simulator the gravity, mass and friction of the coming step."""
        schedule, step = self.schedule, self.step
        if schedule.turns[step]:
            self.simulation.set_gravity(schedule.gravity[step])
        if schedule.changes[step]:
            self._object = self._object.with_mass(float(schedule.mass[step]))
            self.simulation.change_object(self._object, self.friction)


def _feedback(
    positions: Array, velocities: Array, forces: Array, velocity: Array | None = None
) -> dict[str, Array]:
    return {
        "joint_positions": positions,
        "joint_velocities": velocities,
        "contact_forces": forces,
        "object_velocity": np.zeros(6) if velocity is None else velocity,
    }
