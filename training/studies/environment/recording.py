"""Episodes that can be played again, by the environment and by the bare simulator.

The actions are those of an exact solver. Equal seeds and actions give equal bits, so playing an
episode again takes the time of the environment and none of the solver's.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gfo_env.env import GraspForceEnv
from gfo_env.objects import GraspObject
from gfo_env.policy import SolverPolicy
from gfo_env.pose import Pose
from gfo_env.simulation import Simulation
from solvers.arrays import Array

Actions = list[NDArray[np.float32]]
Command = tuple[str, tuple[Any, ...], dict[str, Any]]

SOLVER = "dual_newton"
"""Whose forces are played again."""


class RecordingSimulation(Simulation):
    """A simulation that remembers what it was told since it was last loaded.

    Attributes:
        commands: method, arguments and named arguments of each call, `load` first.
    """

    commands: list[Command]

    def load(
        self, grasp_object: GraspObject, pose: Pose, joint_angles: Array, **named: Any
    ) -> None:
        """See `Simulation.load`."""
        self.commands = [("load", (grasp_object, pose, joint_angles), named)]
        super().load(grasp_object, pose, joint_angles, **named)

    def set_joint_friction(self, torque: float) -> None:
        """See `Simulation.set_joint_friction`."""
        self.commands.append(("set_joint_friction", (torque,), {}))
        super().set_joint_friction(torque)

    def set_gravity(self, gravity: Array) -> None:
        """See `Simulation.set_gravity`."""
        self.commands.append(("set_gravity", (gravity,), {}))
        super().set_gravity(gravity)

    def change_object(self, grasp_object: GraspObject, friction: float) -> None:
        """See `Simulation.change_object`."""
        self.commands.append(("change_object", (grasp_object, friction), {}))
        super().change_object(grasp_object, friction)

    def advance(self, steps: int, torques: Array, push: Array) -> None:
        """See `Simulation.advance`."""
        self.commands.append(("advance", (steps, torques.copy(), push.copy()), {}))
        super().advance(steps, torques, push)


@dataclass(frozen=True, eq=False)
class RecordedEpisode:
    """An episode as it was played.

    Args:
        seed: of its reset.
        actions: of its steps.
        commands: that the simulation got.
        end: where the object was at last, hand frame.
    """

    seed: int
    actions: Actions
    commands: list[Command]
    end: Pose


def record(env: GraspForceEnv, seconds: float, seed: int) -> list[RecordedEpisode]:
    """Episodes under a solver's forces, as many as the environment plays in some time.

    Args:
        env: dynamic; its simulation is another one afterwards.
        seconds: that its steps take altogether, at least.
        seed: of the first episode; each next one adds 1.
    """
    policy = SolverPolicy(SOLVER)
    env.simulation.close()
    simulation = env.simulation = RecordingSimulation(env.hand)
    episodes: list[RecordedEpisode] = []
    spent = 0.0
    while spent < seconds:
        number = seed + len(episodes)
        observation, _ = env.reset(seed=number)
        actions, over = [], False
        while not over:
            action, _ = policy.predict(observation)
            actions.append(action)
            begin = time.perf_counter()
            observation, _, terminated, truncated, _ = env.step(action)
            spent += time.perf_counter() - begin
            over = terminated or truncated
        episodes.append(
            RecordedEpisode(number, actions, simulation.commands, simulation.object_pose())
        )
    simulation.close()
    env.simulation = Simulation(env.hand)
    return episodes


def record_static(env: GraspForceEnv, seconds: float, seed: int) -> Actions:
    """The solver's answers to one-step episodes, which begin with one seed and go on without."""
    policy = SolverPolicy(SOLVER)
    actions: Actions = []
    spent = 0.0
    observation, _ = env.reset(seed=seed)
    while spent < seconds:
        action, _ = policy.predict(observation)
        actions.append(action)
        begin = time.perf_counter()
        env.step(action)
        observation, _ = env.reset()
        spent += time.perf_counter() - begin
    return actions


@dataclass(frozen=True)
class PlayTime:
    """Wall times in s: of the steps altogether, and of each reset."""

    steps: float
    resets: tuple[float, ...]


def play(env: GraspForceEnv, episodes: Sequence[RecordedEpisode]) -> PlayTime:
    """Play recorded episodes again."""
    steps, resets = 0.0, []
    for episode in episodes:
        begin = time.perf_counter()
        env.reset(seed=episode.seed)
        loaded = time.perf_counter()
        for action in episode.actions:
            env.step(action)
        steps += time.perf_counter() - loaded
        resets.append(loaded - begin)
    return PlayTime(steps, tuple(resets))


def play_static(env: GraspForceEnv, actions: Actions, seed: int) -> float:
    """s for one-step episodes, resets included."""
    env.reset(seed=seed)
    begin = time.perf_counter()
    for action in actions:
        env.step(action)
        env.reset()
    return time.perf_counter() - begin


@dataclass(frozen=True)
class BareTime:
    """Wall times of the bare simulator in s, and how many episodes ended in the same bits.

    Args:
        steps: all commands and all simulation steps.
        physics: of these, `stepSimulation` alone.
        loads: of each episode: hand and object loaded anew.
        identical: episodes at whose end the object is exactly where the environment had it.
    """

    steps: float
    physics: float
    loads: tuple[float, ...]
    identical: int


def play_bare(simulation: Simulation, episodes: Sequence[RecordedEpisode]) -> BareTime:
    """Give a simulator the commands of recorded episodes, in a plain loop, and nothing else.

    The clock on `stepSimulation` adds about 0.1 us to each of its calls.
    """
    steps, physics, loads, identical = 0.0, 0.0, [], 0
    for episode in episodes:
        (_, arguments, named), *commands = episode.commands
        begin = time.perf_counter()
        simulation.load(*arguments, **named)
        loads.append(time.perf_counter() - begin)
        joints = simulation.posture().tree.joints.tolist()
        begin = time.perf_counter()
        for method, arguments, _ in commands:
            if method == "advance":
                physics += _advance(simulation, joints, *arguments)
            else:
                getattr(simulation, method)(*arguments)
        steps += time.perf_counter() - begin
        identical += _same(simulation.object_pose(), episode.end)
    return BareTime(steps, physics, tuple(loads), identical)


def _advance(
    simulation: Simulation, joints: list[int], steps: int, torques: Array, push: Array
) -> float:
    """Simulation steps under torques and a push, as PyBullet is told of them; s of the physics."""
    p, client = simulation.bullet, simulation.client
    hand, body, physics = simulation.hand_id, simulation.object_id, 0.0
    commanded, force, torque = torques.tolist(), push[:3].tolist(), push[3:].tolist()
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
        begin = time.perf_counter()
        p.stepSimulation(physicsClientId=client)
        physics += time.perf_counter() - begin
    return physics


def _same(pose: Pose, other: Pose) -> bool:
    """Whether two poses have the same bits."""
    return np.array_equal(pose.position, other.position) and np.array_equal(
        pose.rotation, other.rotation
    )
