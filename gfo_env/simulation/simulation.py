"""The physics: one PyBullet client that holds a hand and an object, and nothing about tasks.

The hand's base is fixed at the world's origin, so world frame and hand frame are one; a hand that
hangs in another orientation is the same hand under gravity from another side. PyBullet is imported
when a simulation connects, which it does on first use: an unused or pickled simulation holds no
client.
"""

import os
import shutil
import tempfile
import weakref
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gfo_env.contacts import POINT_NUMBERS, RawContacts, contact_arrays, number_table
from gfo_env.exceptions import HandError
from gfo_env.hand import BARRETT_BH8_280, HandDescription
from gfo_env.hand.posture import Posture, Tree, read_tree
from gfo_env.hand.shapes import check_shapes
from gfo_env.objects import GraspObject
from gfo_env.pose import Pose, rotation_of
from solvers.arrays import Array

from .engine_mesh import EngineMesh, write_engine_mesh

TIME_STEP = 1.0 / 240.0
"""s; shorter ones cost in proportion, and hold no more. Measured in docs/physics.md."""

SOLVER_ITERATIONS = 100
"""Of the contact solver in a time step. With 50, some grasps creep that hold with 100."""

LINK_NUMBERS = 10
"""Of a link in a table: origin and orientation of its frame, centre of mass."""


class Simulation:
    """A hand, an object, and the engine that moves them.

    Args:
        hand: the hand to load.
        visible: give the object a visual mesh, for rendering.
    """

    def __init__(self, hand: HandDescription = BARRETT_BH8_280, *, visible: bool = False) -> None:
        self.hand = hand
        self.visible = visible
        self._bullet: ModuleType | None = None
        self._client = -1
        self._meshes: dict[int, EngineMesh] = {}
        self._folder = Path()
        self._release: Callable[[], object] = lambda: None
        self._principal = np.eye(3)
        self._gravity = np.zeros(3)
        self._joints: list[int] = []
        self._tree: Tree

    def __reduce__(self) -> tuple[Any, ...]:
        # a client does not travel: a copy connects on its own
        return partial(type(self), visible=self.visible), (self.hand,)

    @property
    def bullet(self) -> ModuleType:
        """The pybullet module, connected."""
        if self._bullet is None:
            import pybullet

            self._bullet = pybullet
            self._client = pybullet.connect(pybullet.DIRECT)
            self._folder = Path(tempfile.mkdtemp(prefix="graspforce-"))
            # for simulations that nobody closes: their number per process is limited
            self._release = weakref.finalize(
                self, _release, pybullet, self._client, self._folder, os.getpid()
            )
        return self._bullet

    @property
    def client(self) -> int:
        """PyBullet's physicsClientId."""
        _ = self.bullet
        return self._client

    def close(self) -> None:
        """Disconnect. A closed simulation connects anew when it is used again."""
        self._release()
        self._bullet, self._client = None, -1
        self._meshes.clear()

    def load(
        self,
        grasp_object: GraspObject,
        pose: Pose,
        joint_angles: Array,
        *,
        friction: float,
        time_step: float = TIME_STEP,
    ) -> None:
        """Start from nothing: the hand at these joint angles, the object at this pose, no motor on.

        Reloading everything makes runs bit-reproducible, which saved states do not.

        Args:
            grasp_object: what is grasped.
            pose: of the object frame in the hand frame.
            joint_angles: (n_tau,) rad.
            friction: coefficient between object and hand.
            time_step: s.
        """
        p, client = self.bullet, self.client
        p.resetSimulation(physicsClientId=client)
        self._gravity = np.zeros(3)
        p.setPhysicsEngineParameter(
            fixedTimeStep=time_step,
            numSolverIterations=SOLVER_ITERATIONS,
            deterministicOverlappingPairs=1,
            physicsClientId=client,
        )
        try:
            self.hand_id = p.loadURDF(
                str(self.hand.urdf),
                useFixedBase=True,
                flags=p.URDF_USE_INERTIA_FROM_FILE
                | (0 if self.visible else p.URDF_IGNORE_VISUAL_SHAPES),
                physicsClientId=client,
            )
        except p.error as error:
            raise HandError(
                f"PyBullet cannot load {self.hand.urdf}, for the reasons that it has printed: is "
                "the file still there, and are its meshes? HandDescription.from_urdf checks them."
            ) from error
        if not self._joints:
            check_shapes(p, client, self.hand_id, self.hand.urdf)
            self._tree = read_tree(p, client, self.hand_id, self.hand.joint_names)
            self._joints = self._tree.joints.tolist()
            self._links = range(len(self._tree.masses))
        for link in range(-1, len(self._tree.masses)):
            # friction is the product of both bodies': the object's alone counts
            p.changeDynamics(
                self.hand_id,
                link,
                lateralFriction=1.0,
                linearDamping=0.0,
                angularDamping=0.0,
                jointDamping=0.0,
                physicsClientId=client,
            )
        for joint, angle in zip(self._joints, joint_angles, strict=True):
            p.resetJointState(self.hand_id, joint, angle, physicsClientId=client)
        p.setJointMotorControlArray(
            self.hand_id,
            self._joints,
            p.VELOCITY_CONTROL,
            forces=[0.0] * len(self._joints),
            physicsClientId=client,
        )
        self._load_object(grasp_object, pose, friction)

    def _load_object(self, grasp_object: GraspObject, pose: Pose, friction: float) -> None:
        p, client = self.bullet, self.client
        mesh = self._mesh(grasp_object)
        self._principal = mesh.axes
        path = str(mesh.path)
        shape = p.createCollisionShape(p.GEOM_MESH, fileName=path, physicsClientId=client)
        visual = -1
        if self.visible:
            visual = p.createVisualShape(
                p.GEOM_MESH,
                fileName=path,
                rgbaColor=[0.35, 0.68, 0.62, 1.0],
                physicsClientId=client,
            )
        turned = Pose(pose.position, pose.rotation @ mesh.axes)
        self.object_id = p.createMultiBody(
            baseMass=grasp_object.mass,
            baseCollisionShapeIndex=shape,
            baseVisualShapeIndex=visual,
            basePosition=pose.position,
            baseOrientation=turned.quaternion(),
            physicsClientId=client,
        )
        p.changeDynamics(
            self.object_id,
            -1,
            localInertiaDiagonal=mesh.moments(grasp_object),
            lateralFriction=friction,
            linearDamping=0.0,
            angularDamping=0.0,
            physicsClientId=client,
        )

    def _mesh(self, grasp_object: GraspObject) -> EngineMesh:
        known = self._meshes.get(id(grasp_object.parts))
        if known is None:
            # the engine remembers files by name, so every object has a name of its own
            path = self._folder / f"object{len(self._meshes)}.obj"
            known = self._meshes[id(grasp_object.parts)] = write_engine_mesh(grasp_object, path)
        return known

    def place(self, pose: Pose, joint_angles: Array) -> None:
        """Put the loaded object and the joints elsewhere, at rest."""
        p, client = self.bullet, self.client
        turned = Pose(pose.position, pose.rotation @ self._principal)
        p.resetBasePositionAndOrientation(
            self.object_id, pose.position, turned.quaternion(), physicsClientId=client
        )
        for joint, angle in zip(self._joints, joint_angles, strict=True):
            p.resetJointState(self.hand_id, joint, angle, physicsClientId=client)

    def change_object(self, grasp_object: GraspObject, friction: float) -> None:
        """Give the loaded object the mass and inertia of another of its shape, and friction."""
        self.bullet.changeDynamics(
            self.object_id,
            -1,
            mass=grasp_object.mass,
            localInertiaDiagonal=self._mesh(grasp_object).moments(grasp_object),
            lateralFriction=friction,
            physicsClientId=self.client,
        )

    def set_gravity(self, gravity: Array) -> None:
        """Set gravity (m/s2, hand frame), which acts on object and hand alike."""
        self._gravity = gravity
        self.bullet.setGravity(*gravity, physicsClientId=self.client)

    def couple(self, max_force: float = 50.0) -> None:
        """Join the geared joints, as the hand's transmission does."""
        p, client = self.bullet, self.client
        for gear in self.hand.gears:
            constraint = p.createConstraint(
                self.hand_id,
                self._joint(gear.driver),
                self.hand_id,
                self._joint(gear.driven),
                p.JOINT_GEAR,
                [0, 0, 1],
                [0, 0, 0],
                [0, 0, 0],
                physicsClientId=client,
            )
            p.changeConstraint(
                constraint, gearRatio=-1.0 / gear.ratio, maxForce=max_force, physicsClientId=client
            )

    def _joint(self, name: str) -> int:
        return self._joints[self.hand.joint_names.index(name)]

    @property
    def slides(self) -> NDArray[np.bool_]:
        """(n_tau,) which joints of the loaded hand are prismatic."""
        return self._tree.slides[self._joints]

    def drive(self, names: tuple[str, ...], speed: ArrayLike, torque: ArrayLike) -> None:
        """Run joints at this speed (rad/s) with at most this torque (N·m), for all or each."""
        joints = [self._joint(name) for name in names]
        self.bullet.setJointMotorControlArray(
            self.hand_id,
            joints,
            self.bullet.VELOCITY_CONTROL,
            targetVelocities=np.broadcast_to(speed, len(joints)).tolist(),
            forces=np.broadcast_to(torque, len(joints)).tolist(),
            physicsClientId=self.client,
        )

    def free_inertia(self) -> Array:
        """(n_tau,) kg·m2, or kg of slides: what each joint feels as all others give way."""
        angles, _ = self.joint_state()
        matrix = self.bullet.calculateMassMatrix(
            self.hand_id, angles.tolist(), physicsClientId=self.client
        )
        return 1.0 / np.diag(np.linalg.inv(matrix))

    def set_iterations(self, count: int) -> None:
        """Iterations of the contact solver in a time step, until something is loaded anew."""
        self.bullet.setPhysicsEngineParameter(
            numSolverIterations=count, physicsClientId=self.client
        )

    def set_joint_friction(self, torque: float) -> None:
        """Dry friction (N·m) in every joint: a zero-speed motor of that strength."""
        self.drive(self.hand.joint_names, 0.0, torque)

    def hold_object(self, max_force: float) -> int:
        """Pin the object where it is, with a force of at most `max_force` N; returns the pin."""
        p, client = self.bullet, self.client
        position, quaternion = p.getBasePositionAndOrientation(
            self.object_id, physicsClientId=client
        )
        pin = p.createConstraint(
            self.object_id,
            -1,
            -1,
            -1,
            p.JOINT_FIXED,
            [0, 0, 0],
            [0, 0, 0],
            position,
            [0, 0, 0, 1],
            quaternion,
            physicsClientId=client,
        )
        p.changeConstraint(pin, maxForce=max_force, physicsClientId=client)
        return int(pin)

    def release_object(self, pin: int) -> None:
        """Remove the pin of `hold_object`."""
        self.bullet.removeConstraint(pin, physicsClientId=self.client)

    def advance(self, steps: int, torques: Array, push: Array) -> None:
        """Advance by time steps under joint torques and a push on the object, as if held.

        Args:
            steps: how many.
            torques: (n_tau,) N·m, of the joints; their motors stay as they are.
            push: (6,) N and N·m at the centre of mass, hand frame.
        """
        p, client, hand, body = self.bullet, self.client, self.hand_id, self.object_id
        joints, commanded = self._joints, torques.tolist()
        force, torque = push[:3].tolist(), push[3:].tolist()
        pushed, twisted = any(force), any(torque)
        for _ in range(steps):
            if pushed:
                at, _ = p.getBasePositionAndOrientation(body, physicsClientId=client)
                p.applyExternalForce(body, -1, force, at, p.WORLD_FRAME, physicsClientId=client)
            if twisted:
                p.applyExternalTorque(body, -1, torque, p.WORLD_FRAME, physicsClientId=client)
            p.setJointMotorControlArray(
                hand, joints, p.TORQUE_CONTROL, forces=commanded, physicsClientId=client
            )
            p.stepSimulation(physicsClientId=client)

    def step(self) -> None:
        """Advance by one time step."""
        self.bullet.stepSimulation(physicsClientId=self.client)

    def joint_state(self) -> tuple[Array, Array]:
        """Joint angles (rad) and speeds (rad/s), each (n_tau,)."""
        states = self.bullet.getJointStates(self.hand_id, self._joints, physicsClientId=self.client)
        angles, speeds = number_table([n for state in states for n in state[:2]], 2).T
        return angles, speeds

    def object_pose(self) -> Pose:
        """Where the object is."""
        position, quaternion = self.bullet.getBasePositionAndOrientation(
            self.object_id, physicsClientId=self.client
        )
        return Pose.unchecked(np.array(position), rotation_of(quaternion, self._principal))

    def object_velocity(self) -> tuple[Array, Array]:
        """Velocity of the object's centre of mass (m/s) and angular velocity (rad/s), each (3,)."""
        linear, angular = self.bullet.getBaseVelocity(self.object_id, physicsClientId=self.client)
        return np.array(linear), np.array(angular)

    def contacts(self) -> RawContacts:
        """Contacts between hand and object after the last step."""
        table = number_table(self.contact_numbers(), POINT_NUMBERS)
        return RawContacts.unchecked(*contact_arrays(table, self._tree.bodies))

    def contact_numbers(self) -> list[float]:
        """What the engine tells of each contact point, `POINT_NUMBERS` one after the other."""
        row: list[float] = []
        for point in self.bullet.getContactPoints(
            self.object_id, self.hand_id, physicsClientId=self.client
        ):
            row.append(point[4])
            row += point[5]
            row += point[7]
            row += point[9:11]
            row += point[11]
            row.append(point[12])
            row += point[13]
        return row

    def penetration(self) -> float:
        """Depth (m) of the deepest overlap of hand and object in the present pose; no step."""
        p, client = self.bullet, self.client
        p.performCollisionDetection(physicsClientId=client)
        points = p.getContactPoints(self.object_id, self.hand_id, physicsClientId=client)
        return max((-point[8] for point in points), default=0.0)

    def posture(self) -> Posture:
        """Where the hand's links are now."""
        table = number_table(self.link_numbers(), LINK_NUMBERS)
        return Posture(self._tree, table[:, :3], table[:, 3:7], table[:, 7:])

    def link_numbers(self) -> list[float]:
        """What the engine tells of each link, `LINK_NUMBERS` one after the other."""
        row: list[float] = []
        for centre, _, _, _, origin, orientation in self.bullet.getLinkStates(
            self.hand_id, self._links, computeForwardKinematics=1, physicsClientId=self.client
        ):
            row += origin
            row += orientation
            row += centre
        return row


def _release(bullet: ModuleType, client: int, folder: Path, owner: int) -> None:
    """Disconnect a client and delete its files, unless they belong to the parent of a fork."""
    if os.getpid() == owner:
        bullet.disconnect(client)
        shutil.rmtree(folder, ignore_errors=True)
