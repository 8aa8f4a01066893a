"""`GraspForce-v0`: command the contact forces that keep an object in the hand."""

import math
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from .acquisition import MAX_CONTACTS
from .conditions import FRICTION_RANGE, MASS_RANGE, PRELOAD, STANDARD_GRAVITY
from .episode import LARGEST_OBJECT, LOAD_STEPS, SURVIVAL, Episode, acquire
from .exceptions import EnvironmentSettingsError
from .hand import BARRETT_BH8_280
from .holding import random_gravity
from .objects import RANDOM_URDFS, ObjectSet
from .observation import Observation, pack, shapes
from .rendering import LOAD_COLOUR, METRES_PER_NEWTON, Camera, Picture, draw_forces, render
from .reward import TERMS, ForceMeasures, RewardWeights, measure_forces, reward_terms
from .simulation import Simulation

Array = NDArray[np.float64]

MAX_FORCE = 20.0


class GraspForceEnv(gymnasium.Env[Observation, NDArray[np.float32]]):
    """Hold an object in a Barrett hand by commanding its contact forces.

    ## Description

    The hand has just closed on an object. It hangs in a random orientation, which is to say that
    gravity comes from a random side, and the object is to stay where it is in the hand: first under
    its weight alone, then under its weight and pushes at the centre of mass, each along another
    random direction. Every load is announced. At each step the agent sees the grasp force problem
    of the coming 0.05 s and answers with a force for every contact. The joints get the torques that
    realise it, J_h' f + tau_ext, clipped to their limits, and nothing else holds them in place.
    Then the simulator (PyBullet) says what happens, and the contacts are read anew.

    ## Action Space

    `Box(-1, 1, (3 * max_contacts,), float32)`: contact forces divided by `max_force`, three numbers
    per contact, in the order of the contacts in the last observation. They are the components along
    the contact frame: tangents t1 and t2, then the inward normal n, along which a force that pushes
    is positive. Entries of padding contacts have no effect. Values beyond the bounds are clipped.

    | Num    | Action                        | Min | Max | Unit            |
    | ------ | ----------------------------- | --- | --- | --------------- |
    | 3i     | force of contact i along t1   | -1  | 1   | `max_force` [N] |
    | 3i + 1 | force of contact i along t2   | -1  | 1   | `max_force` [N] |
    | 3i + 2 | force of contact i along n    | -1  | 1   | `max_force` [N] |

    ## Observation Space

    A `Dict` of one-dimensional `Box`es, float32: the fields of `solvers.GraspForceProblem`, padded
    with zeros to n = `max_contacts` contacts, matrices row by row: `gfo_env.observation.unpack`
    gives the matrices back. The object frame has its origin at the centre of mass. Bounds are
    limits that no observation passes, not typical sizes: mu is the highest friction, tau the torque
    limit of the joint, W the largest weight plus `push`.

    | Key             | Size   | Min  | Max       | Unit   | Meaning                               |
    | --------------- | ------ | ---- | --------- | ------ | --------------------------------------|
    | grasp_map       | 6 * 3n | -1   | 1         | 1, m   | G: forces to wrench, object frame     |
    | hand_jacobian   | 3n * 8 | -1   | 1         | m      | J_h: torques J_h' f + external_torque |
    | friction        | n      | 0    | mu        | 1      | true coefficient of friction          |
    | torque_min      | 8      | -tau | 0         | N·m    | lower torque limits                   |
    | torque_max      | 8      | 0    | tau       | N·m    | upper torque limits                   |
    | external_torque | 8      | -tau | tau       | N·m    | what carries the hand's own links     |
    | external_wrench | 6      | -W   | W         | N, N·m | coming load, weight included,         |
    |                 |        |      |           |        | object frame                          |
    | normal_min      | n      | 0    | max_force | N      | `preload`                             |
    | normal_max      | n      | 0    | max_force | N      | `max_force`                           |
    | contact_mask    | n      | 0    | 1         | 1      | 1 at contacts, 0 at padding           |

    Contacts come strongest first. When the object slips there may be fewer than it takes to balance
    every load, or none; the observation then holds those there are.

    ## Rewards

    The sum of seven bounded terms, each in `info` as `reward_<name>`: holding, force_closure,
    q_lrw, equilibrium, friction, torque, effort. `gfo_env.reward.RewardWeights` states them. With
    default weights a step that holds the object with the least forces is worth about 1.07, a drop
    -0.8 or less.

    ## Starting State

    A real grasp of an object drawn from the set: the hand closes on it from a random pose, with
    fresh draws until that succeeds, as 95 % of attempts do. Friction, mass and the side of gravity
    are drawn uniformly. All randomness derives from the seed, and equal seeds give equal bits.

    ## Episode End

    *Termination*: the object's centre of mass has moved 25 mm in the hand since the grasp, or the
    object has turned 30 degrees, or nothing touches it. *Truncation*: after `horizon` steps; this
    needs no `TimeLimit` wrapper. `info["is_success"]` is True exactly when an episode is truncated,
    which takes that the object is still held.

    ## Info

    The same keys after `reset`, where no force has been commanded and every reward is 0, as after
    `step`. `force_closure` is about the contacts of the observation, the other measures about the
    forces that were commanded last. Numbers are Python floats, never NaN.

    | Key                | Unit | Meaning                                                          |
    | ------------------ | ---- | ---------------------------------------------------------------- |
    | is_success         | bool | the episode has ended with the object held                       |
    | force_closure      | bool | the contacts can resist every load, given forces enough          |
    | q_lrw              | N    | lowest resisted wrench of the normal forces: pyramids of 4 edges |
    |                    |      | in the friction cones, torques over the object's radius          |
    | wrench_residual    | N    | least change of the forces that would balance the load           |
    | friction_violation | N    | worst excess of a force over its friction cone                   |
    | torque_violation   | N·m  | worst excess of a joint torque over its limit, before clipping   |
    | object_id          | str  | in the object set                                                |
    | reward_<name>      | 1    | each term of the reward                                          |

    ## Arguments

    Args:
        object_set: "random_urdfs", or a folder of meshes in metres.
        split: of the object set: "train", "test" or "all".
        max_contacts: contacts in an observation, at least 3; the strongest are kept.
        max_force: N, what an action of 1 commands, and the cap of normal forces.
        preload: N, least normal force that the problem asks of every contact. Two newtons let more
            grasps hold than none.
        friction_range: lowest and highest coefficient of friction.
        mass_range: kg, lowest and highest mass, whatever the object's own.
        push: N, size of the pushes.
        horizon: steps until truncation. A load lasts 6 steps of 0.05 s, so 42 are seven loads.
        reward_weights: None for the default weights.
        render_mode: None or "rgb_array": pictures of 320 x 240 pixels, in which red arrows are the
            forces commanded last and the blue one is the coming load.

    Raises:
        EnvironmentSettingsError: an argument is out of its range.
        ObjectSetError: there is no such object set or split.

    ## Version History

    * v0: initial version.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}  # noqa: RUF012 (as in Env)

    def __init__(
        self,
        object_set: str | Path = RANDOM_URDFS,
        split: str = "train",
        *,
        max_contacts: int = MAX_CONTACTS,
        max_force: float = MAX_FORCE,
        preload: float = PRELOAD,
        friction_range: tuple[float, float] = FRICTION_RANGE,
        mass_range: tuple[float, float] = MASS_RANGE,
        push: float = SURVIVAL.push,
        horizon: int = 7 * LOAD_STEPS,
        reward_weights: RewardWeights | None = None,
        render_mode: str | None = None,
    ) -> None:
        _require(max_contacts >= 3, "max_contacts must be 3 or more", max_contacts)
        _require(
            0 < max_force < np.inf, "max_force must be a positive number of newtons", max_force
        )
        _require(0 <= preload <= max_force, "preload must lie between 0 and max_force", preload)
        _require_range("friction_range", friction_range)
        _require_range("mass_range", mass_range)
        _require(0 <= push < np.inf, "push must be a number of newtons >= 0", push)
        _require(horizon >= 1, "horizon must be 1 step or more", horizon)
        _require(
            render_mode is None or render_mode in self.metadata["render_modes"],
            "render_mode must be None or 'rgb_array'",
            render_mode,
        )
        self.objects = ObjectSet(object_set, split)
        self.max_contacts = max_contacts
        self.max_force = max_force
        self.preload = preload
        self.friction_range = friction_range
        self.mass_range = mass_range
        self.push = push
        self.horizon = horizon
        self.reward_weights = reward_weights or RewardWeights()
        self.render_mode = render_mode
        self.hand = BARRETT_BH8_280
        self.simulation = Simulation(self.hand, visible=render_mode is not None)
        self.observation_space = self._observation_space()
        self.action_space = spaces.Box(-1.0, 1.0, (3 * max_contacts,), np.float32)
        self._episode: Episode | None = None

    def _observation_space(self) -> spaces.Dict[Any]:
        torque = np.array(self.hand.max_torque)
        load = self.mass_range[1] * STANDARD_GRAVITY + self.push
        bounds: dict[str, tuple[float | Array, float | Array]] = {
            "grasp_map": (-LARGEST_OBJECT, LARGEST_OBJECT),
            "hand_jacobian": (-LARGEST_OBJECT, LARGEST_OBJECT),
            "friction": (0.0, self.friction_range[1]),
            "torque_min": (-torque, 0.0),
            "torque_max": (0.0, torque),
            "external_torque": (-torque, torque),
            "external_wrench": (-load, load),
            "normal_min": (0.0, self.max_force),
            "normal_max": (0.0, self.max_force),
            "contact_mask": (0.0, 1.0),
        }
        boxes: dict[str, spaces.Space[Any]] = {}
        for name, shape in shapes(self.max_contacts, len(torque)).items():
            low, high = (np.full(math.prod(shape), bound, np.float32) for bound in bounds[name])
            boxes[name] = spaces.Box(low, high, dtype=np.float32)
        return spaces.Dict(boxes)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Grasp an object; `options` are not used.

        Raises:
            AcquisitionError: no attempt led to a grasp.
        """
        super().reset(seed=seed)
        self._episode = None
        rng = self.np_random
        grasp_object, start = acquire(self.objects, self.simulation, rng, self.max_contacts)
        directions = rng.normal(size=(-(-self.horizon // LOAD_STEPS), 3))
        pushes = self.push * directions / np.linalg.norm(directions, axis=1, keepdims=True)
        pushes[0] = 0.0
        episode = Episode(
            self.simulation,
            grasp_object.with_mass(float(rng.uniform(*self.mass_range))),
            start,
            friction=float(rng.uniform(*self.friction_range)),
            gravity=random_gravity(rng),
            pushes=pushes,
            max_contacts=self.max_contacts,
            preload=self.preload,
            cap=self.max_force,
        )
        forces = np.zeros(3 * len(start.contacts))
        self._episode, self._commanded = episode, (start, forces)
        info = self._info(
            episode,
            self._measure(episode, forces),
            dict.fromkeys(TERMS, 0.0),
            force_closure=episode.closes(),
            success=False,
        )
        return pack(episode.fields, self.max_contacts), info

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Command forces for 0.05 s.

        Raises:
            EnvironmentSettingsError: the action has another shape, or holds NaN.
        """
        episode = self._running()
        forces = self._forces_of(action, len(episode.present.contacts))
        measures = self._measure(episode, forces)
        self._commanded = episode.present, forces
        episode.advance(forces)
        lost, force_closure = episode.lost(), episode.closes()
        truncated = not lost and episode.steps >= self.horizon
        terms = reward_terms(
            self.reward_weights,
            measures,
            lost=lost,
            motion=episode.motion(),
            force_closure=force_closure,
        )
        info = self._info(episode, measures, terms, force_closure=force_closure, success=truncated)
        observation = pack(episode.fields, self.max_contacts)
        return observation, sum(terms.values()), lost, truncated, info

    def render(self) -> Picture | None:
        """(240, 320, 3) RGB picture, or None without a render mode."""
        episode = self._running()
        if self.render_mode is None:
            gymnasium.logger.warn(
                "render() shows nothing without a render mode: make the environment with "
                'render_mode="rgb_array".'
            )
            return None
        camera = Camera()
        picture = render(self.simulation, camera)
        pose = self.simulation.object_pose()
        load = episode.load[None]
        pulled = pose.position + METRES_PER_NEWTON * load
        picture = draw_forces(picture, camera, pulled, load, colour=LOAD_COLOUR)
        grasp, forces = self._commanded
        frames = pose.rotation @ grasp.contacts.frames
        in_hand = np.einsum("nij,nj->ni", frames, forces.reshape(-1, 3))
        return draw_forces(picture, camera, pose.to_hand(grasp.contacts.positions), in_hand)

    def close(self) -> None:
        """Disconnect the simulator. A closed environment may be reset and used again."""
        self.simulation.close()
        self._episode = None
        super().close()

    def __getstate__(self) -> dict[str, Any]:
        # an episode lives in the simulator, which does not travel: a copy begins with reset
        return self.__dict__ | {"_episode": None}

    def _running(self) -> Episode:
        if self._episode is None:
            raise ResetNeeded("There is no episode yet, or no longer: call reset() first.")
        return self._episode

    def _measure(self, episode: Episode, forces: Array) -> ForceMeasures:
        """How forces do on the problem that the episode poses now."""
        return measure_forces(
            episode.problem,
            forces,
            q_lrw=episode.q_lrw(forces),
            load=float(np.linalg.norm(episode.load)),
            max_force=self.max_force,
            max_torque=max(self.hand.max_torque),
        )

    def _info(
        self,
        episode: Episode,
        measures: ForceMeasures,
        terms: dict[str, float],
        *,
        force_closure: bool,
        success: bool,
    ) -> dict[str, Any]:
        return {
            "is_success": success,
            "force_closure": force_closure,
            "q_lrw": measures.q_lrw,
            "wrench_residual": measures.wrench_residual,
            "friction_violation": measures.friction_violation,
            "torque_violation": measures.torque_violation,
            "object_id": episode.start.object_id,
            **{f"reward_{name}": value for name, value in terms.items()},
        }

    def _forces_of(self, action: NDArray[np.float32], contacts: int) -> Array:
        """(3n,) N of an action, padding left out."""
        commanded = np.asarray(action, dtype=np.float64)
        if commanded.shape != self.action_space.shape or np.isnan(commanded).any():
            raise EnvironmentSettingsError(
                f"An action is {3 * self.max_contacts} numbers, 3 for each of max_contacts="
                f"{self.max_contacts}, none of them NaN; got shape {commanded.shape}."
            )
        return self.max_force * np.clip(commanded[: 3 * contacts], -1.0, 1.0)


def _require(holds: bool, rule: str, value: object) -> None:
    if not holds:
        raise EnvironmentSettingsError(f"{rule}, not {value!r}.")


def _require_range(name: str, bounds: tuple[float, float]) -> None:
    _require(
        len(bounds) == 2 and 0 < bounds[0] <= bounds[1] < np.inf,
        f"{name} must be two positive numbers, the lower first",
        bounds,
    )
