"""`GraspForce-v0` and its variants: command the contact forces that keep an object in the hand."""

from collections.abc import Collection, Mapping
from os import PathLike
from pathlib import Path
from typing import Any, Literal

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from gfo_env.conditions import FRICTION_RANGE, MASS_RANGE, PRELOAD
from gfo_env.exceptions import EnvironmentSettingsError
from gfo_env.grasps.acquisition import MAX_CONTACTS
from gfo_env.grasps.source import GraspSource, StoredGrasp
from gfo_env.hand import BARRETT_BH8_280, HandDescription
from gfo_env.mdp.actions import checked_action, commanded_forces
from gfo_env.mdp.arguments import (
    checked_options,
    checked_seed,
    choice,
    flag,
    number,
    number_range,
    require,
    whole_number,
)
from gfo_env.mdp.episode import Episode, EpisodeSettings, SimulatedEpisode, StaticEpisode
from gfo_env.mdp.loads import LOAD_STEPS, LoadSettings, draw_loads
from gfo_env.mdp.observation import Observation, feedback_shapes, shapes
from gfo_env.mdp.resistance import disturbances_of, least_resistance
from gfo_env.mdp.reward import TERMS, ForceMeasures, RewardWeights, reward_terms
from gfo_env.mdp.spaces import observation_space
from gfo_env.objects import RANDOM_URDFS, ObjectSet
from gfo_env.simulation import Picture, Simulation, picture_of_grasp
from solvers.arrays import Array

MAX_FORCE = 20.0

HORIZON = 7 * LOAD_STEPS

LONGEST_HORIZON = 10_000
"""Steps; their loads are drawn when an episode begins."""

MOST_CONTACTS = 1000

_REWARD_KEYS = tuple(f"reward_{name}" for name in TERMS)


class GraspForceEnv(gymnasium.Env[Observation, NDArray[np.float32]]):
    """Hold an object in a robot hand by commanding its contact forces.

    ## Description

    The hand, a Barrett hand unless you bring another, has just closed on an object. It hangs in a
    random orientation, which is to say that gravity comes from a random side, and the object is to
    stay where it is in the hand: first under its weight alone, then through loads of 0.3 s each. A
    load is a push at the centre of mass from a random side, a torque about a random axis, a turn of
    the hand, another mass or another friction (`gfo_env.mdp.loads.LoadSettings`). At each step the
    agent sees the grasp force problem of the coming 0.05 s and answers with a force for every
    contact. The joints get the torques that realise it, J_h' f + tau_ext, clipped to their limits,
    and but for 0.01 N·m of dry friction nothing else holds them in place. Then the simulator
    (PyBullet) says what happens, and the contacts are read anew.

    With `announced=False` the problem that the agent sees has the weight of the beginning as its
    load and the friction of the beginning: pushes come as a surprise, and the observation adds what
    a hand can feel. With `mode="static"` an episode is one problem under a random load, and the
    laws of statics decide, at thousands of episodes a second.

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
    with zeros to n = `max_contacts` contacts, matrices row by row: `gfo_env.mdp.observation.unpack`
    gives the matrices back. The object frame has its origin at the centre of mass. Bounds are
    limits that no observation passes, not typical sizes, and depend on no argument but
    `max_contacts`, `announced` and the hand's number of joints: an agent that was trained under
    some loads, forces and strengths can be loaded under others. t is the number of joints, 8 for
    the Barrett hand. The last four keys are there if `announced=False`.

    | Key             | Size   | Min  | Max | Unit   | Meaning                               |
    | --------------- | ------ | ---- | --- | ------ | --------------------------------------|
    | grasp_map       | 6 * 3n | -1   | 1   | 1, m   | G: forces to wrench, object frame     |
    | hand_jacobian   | 3n * t |      |     | m      | J_h: torques J_h' f + external_torque |
    | friction        | n      | 0    |     | 1      | true coefficient of friction          |
    | torque_min      | t      |      | 0   | N·m    | lower torque limits                   |
    | torque_max      | t      | 0    |     | N·m    | upper torque limits                   |
    | external_torque | t      |      |     | N·m    | what carries the hand's own links     |
    | external_wrench | 6      |      |     | N, N·m | coming load, weight included,         |
    |                 |        |      |     |        | object frame                          |
    | normal_min      | n      | 0    |     | N      | `preload`                             |
    | normal_max      | n      | 0    |     | N      | `max_force`                           |
    | contact_mask    | n      | 0    | 1   | 1      | 1 at contacts, 0 at padding           |
    | joint_positions | t      |      |     | rad    |                                       |
    | joint_velocities| t      |      |     | rad/s  |                                       |
    | contact_forces  | 3n     |      |     | N      | measured, in the contact frames       |
    | object_velocity | 6      |      |     | m/s,   | relative to the palm, object frame    |
    |                 |        |      |     | rad/s  |                                       |

    Contacts come strongest first. When the object slips there may be fewer than it takes to balance
    every load, or none; the observation then holds those there are.

    ## Rewards

    The sum of eight bounded terms, each in `info` as `reward_<name>`: holding, force_closure,
    q_lrw, equilibrium, friction, torque, effort, resistance, the last of which is off unless
    `reward_weights` give it a weight. `gfo_env.mdp.reward.RewardWeights` states them. With default
    weights a step that holds the object with the least forces is worth about 1.05, a drop -0.85 or
    less.

    ## Starting State

    A real grasp, drawn from a fixed set of seeded attempts in which the hand closed on an object in
    a random pose: those in `grasps`, or those of the user's cache, which are made when they are
    first drawn. Friction, mass and the side of gravity are drawn uniformly. All randomness derives
    from the seed, and equal seeds and actions give equal bits, in any process.

    ## Episode End

    *Termination*: the object's centre of mass has moved 25 mm in the hand since the grasp, or the
    object has turned 30 degrees, or nothing touches it. *Truncation*: after `horizon` steps; this
    needs no `TimeLimit` wrapper. `info["is_success"]` is True exactly when an episode is truncated,
    which takes that the object is still held. In static mode every step is a termination, and a
    success if the misfit of the forces (`gfo_env.mdp.reward.ForceMeasures.misfit`) is below 0.1.

    ## Info

    The same keys after `reset`, where no force has been commanded and every reward is 0, as after
    `step`. `force_closure` is about the contacts of the observation, the other measures about the
    forces that were commanded last. Numbers are Python floats, never NaN.

    | Key                | Unit | Meaning                                                          |
    | ------------------ | ---- | ---------------------------------------------------------------- |
    | is_success         | bool | the episode has ended with the object held                       |
    | force_closure      | bool | the contacts can resist every load, given forces enough          |
    | q_lrw              | N    | lowest resisted wrench of the normal forces, torques over the    |
    |                    |      | object's radius; an upper bound, see `quality_estimate`          |
    | wrench_residual    | N    | least change of the forces that would balance the load           |
    | friction_violation | N    | worst excess of a force over its friction cone                   |
    | torque_violation   | N·m  | worst excess of a joint torque over its limit, before clipping   |
    | effort             | N    | 2-norm of the commanded forces                                   |
    | resistance         | 1    | least multiple of a push or twist that the forces resist without |
    |                    |      | motion; 0 unless the reward gives it a weight                    |
    | object_id          | str  | in the object set                                                |
    | grasp              | int  | number of the grasp, for `reset(options={"grasp": number})`      |
    | reward_<name>      | 1    | each term of the reward                                          |

    ## Arguments

    A number is an int or a float of Python or numpy, and 0 or from 1e-6 to 1e6; a whole number is
    one by its type, so that 42.0 is none; a range is two numbers, as a tuple, a list or an array,
    the lower first.

    Args:
        object_set: "random_urdfs", or a folder of meshes.
        split: of the object set: "train", "test" or "all".
        object_ids: the objects to use, in a list, a tuple, a set or an array; None for all of the
            split.
        target_size: m; if given, the objects are scaled to this longest edge.
        scale: metres per unit of a folder's files, 0.001 for millimetres; None for 1.
        pattern: which files of a folder are objects, "**/*.stl" say; None for all.
        grasps: a table of grasps from `scripts/collect.py` to begin episodes with; None for the
            user's cache, which fills itself, see `gfo_env.grasps.source`.
        mode: "dynamic", or "static": one-step episodes judged by statics, without a simulator.
        announced: whether the agent is told of the coming load. If not, the problem that it sees
            has the weight of the beginning as its load and the friction of the beginning, and the
            observation adds what a hand can feel.
        contacts: "hand", or "fingertips": grasps that touch with fingertips alone.
        hand: that grasps.
        max_contacts: contacts in an observation, 3 to 1000; the strongest are kept.
        max_force: N, what an action of 1 commands, and the cap of normal forces.
        preload: N, least normal force that the problem asks of every contact. It lets more grasps
            hold than none.
        mass_range: kg, lowest and highest mass in the beginning, whatever the object's own.
        friction_range: lowest and highest coefficient of friction in the beginning.
        push: N, size of the pushes.
        twist: N·m, size of the torques.
        turn: rad, how far the hand turns in 0.3 s.
        mass_change: lowest and highest factor on the mass of the beginning.
        friction_change: lowest and highest factor on the friction of the beginning.
        torque_scale_range: lowest and highest factor on the hand's torque limits, one an episode.
        horizon: steps until truncation, 10,000 at most; None for 42, or 1 in static mode. A load
            lasts 6 steps of 0.05 s, so 42 are seven loads.
        exact_quality: whether q_lrw is that of the hull of pyramids of 8 edges, a lower bound that
            takes milliseconds.
        reward_weights: of the terms of the reward, or those that are not the default ones by name.
        render_mode: None or "rgb_array": pictures of 320 x 240 pixels, in which red arrows are the
            forces commanded last and the blue one is the coming load.

    Raises:
        EnvironmentSettingsError: an argument is of another type, or out of its range.
        ObjectSetError: there is no such object set, split or object, or no such size.
        MeshError: no file of the folder is a solid.

    ## Version History

    * v0: initial version.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}  # noqa: RUF012 (as in Env)

    def __init__(
        self,
        object_set: str | Path = RANDOM_URDFS,
        split: str = "train",
        *,
        object_ids: Collection[str] | None = None,
        target_size: float | None = None,
        scale: float | None = None,
        pattern: str | None = None,
        grasps: str | Path | None = None,
        mode: Literal["dynamic", "static"] = "dynamic",
        announced: bool = True,
        contacts: Literal["hand", "fingertips"] = "hand",
        hand: HandDescription = BARRETT_BH8_280,
        max_contacts: int = MAX_CONTACTS,
        max_force: float = MAX_FORCE,
        preload: float = PRELOAD,
        mass_range: tuple[float, float] = MASS_RANGE,
        friction_range: tuple[float, float] = FRICTION_RANGE,
        push: float = LoadSettings.push,
        twist: float = LoadSettings.twist,
        turn: float = LoadSettings.turn,
        mass_change: tuple[float, float] = LoadSettings.mass_change,
        friction_change: tuple[float, float] = LoadSettings.friction_change,
        torque_scale_range: tuple[float, float] = (1.0, 1.0),
        horizon: int | None = None,
        exact_quality: bool = False,
        reward_weights: RewardWeights | Mapping[str, float] | None = None,
        render_mode: str | None = None,
    ) -> None:
        static = choice("mode", mode, ("dynamic", "static")) == "static"
        fingertips = choice("contacts", contacts, ("hand", "fingertips")) == "fingertips"
        if render_mode is not None:
            choice("render_mode", render_mode, self.metadata["render_modes"])
        require(
            isinstance(hand, HandDescription),
            "hand must be a HandDescription, such as HandDescription.from_urdf makes",
            hand,
        )
        require(
            grasps is None or isinstance(grasps, str | PathLike),
            "grasps must be None or the path of a table",
            grasps,
        )
        most_contacts = whole_number("max_contacts", max_contacts, 3, MOST_CONTACTS)
        self.settings = EpisodeSettings(
            most_contacts,
            number("max_force", max_force),
            number("preload", preload, zero=True),
            flag("announced", announced),
            fingertips,
            flag("exact_quality", exact_quality),
        )
        require(preload <= max_force, "preload must lie between 0 and max_force", preload)
        steps = 1 if static else HORIZON
        if horizon is not None:
            steps = whole_number("horizon", horizon, 1, LONGEST_HORIZON)
        require(not static or steps == 1, "horizon must be 1 in static mode", horizon)
        self.loads = LoadSettings(
            mass_range, friction_range, push, twist, turn, mass_change, friction_change
        )
        self.torque_scale_range = number_range("torque_scale_range", torque_scale_range)
        self.objects = ObjectSet(
            object_set,
            split,
            object_ids=object_ids,
            target_size=target_size,
            scale=scale,
            pattern=pattern,
        )
        self.mode = mode
        self.horizon = steps
        self.reward_weights = RewardWeights.of(reward_weights)
        self._disturbances = disturbances_of(self.loads.push, self.loads.twist)
        require(
            not self.reward_weights.resistance or len(self._disturbances) > 0,
            "reward_weights of resistance take a push or a twist to resist",
            reward_weights,
        )
        self.render_mode = render_mode
        self.hand = hand
        self.grasps = GraspSource(
            self.objects,
            hand,
            fingertips=self.settings.fingertips,
            path=None if grasps is None else Path(grasps),
        )
        self.simulation = Simulation(hand, visible=render_mode is not None)
        joints = len(hand.joint_names)
        self._layout = shapes(most_contacts, joints)
        if not self.settings.announced:
            self._layout |= feedback_shapes(most_contacts, joints)
        self.observation_space = observation_space(self._layout)
        self.action_space = spaces.Box(-1.0, 1.0, (3 * most_contacts,), np.float32)
        self._episode: Episode | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin with a grasp.

        Args:
            seed: of all randomness from here on; None to go on with the one there is.
            options: what not to draw at random: "grasp", the number of a grasp in `grasps`, as
                `info` has it; "mass" [kg], "friction" and "gravity" ((3,) m/s2, hand frame) of the
                beginning.

        Raises:
            AcquisitionError: no grasp was found.
            EnvironmentSettingsError: the seed is none, or an option is unknown or makes no sense.
        """
        self._episode = None
        fixed = checked_options(options)
        super().reset(seed=checked_seed(seed))
        rng = self.np_random
        # drawn in any case, so that what is drawn later does not depend on the options
        number, stored = self.grasps.draw(rng, self._keeps_balance)
        if "grasp" in fixed:
            number = fixed.pop("grasp")
            chosen = self.grasps.grasp(number) if 0 <= number < len(self.grasps) else None
            if chosen is None or not self._keeps_balance(chosen):
                raise EnvironmentSettingsError(
                    "options['grasp'] must be the number of a grasp that balances every load, not "
                    f"{number!r}."
                )
            stored = chosen
        torque_scale = float(rng.uniform(*self.torque_scale_range))
        if self.mode == "static":
            # the last step of a schedule is under a load of any kind, not under the weight alone
            schedule = draw_loads(self.loads, rng, LOAD_STEPS + 1, **fixed).from_step(LOAD_STEPS)
            episode: Episode = StaticEpisode(
                self.settings, self.hand, stored, schedule, torque_scale
            )
        else:
            episode = SimulatedEpisode(
                self.settings,
                self.hand,
                stored,
                draw_loads(self.loads, rng, self.horizon, **fixed),
                torque_scale,
                self.simulation,
                self.objects[stored.grasp.object_id],
            )
        self._episode, self._number, self._steps = episode, number, 0
        forces = np.zeros(3 * len(episode.present.contacts))
        self._commanded = episode.present, forces
        info = self._info(
            episode,
            self._measure(episode, forces),
            dict.fromkeys(TERMS, 0.0),
            force_closure=episode.closes(),
            success=False,
        )
        return episode.observe(self._layout), info

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Command forces for 0.05 s.

        Raises:
            EnvironmentSettingsError: the action has another shape, or holds what is no number.
            ResetNeeded: there is no episode.
        """
        episode = self._running()
        settings = self.settings
        forces = commanded_forces(
            checked_action(action, 3 * settings.max_contacts),
            len(episode.present.contacts),
            settings.max_force,
        )
        measures = self._measure(episode, forces)
        self._commanded = episode.present, forces
        episode.advance(forces, measures)
        self._steps += 1
        lost, force_closure = episode.lost(), episode.closes()
        over = self._steps >= self.horizon
        # a single problem has no future that a truncation could cut off
        terminated = lost or (over and self.mode == "static")
        terms = reward_terms(
            self.reward_weights,
            measures,
            holding=episode.holding(),
            force_closure=force_closure,
        )
        info = self._info(
            episode, measures, terms, force_closure=force_closure, success=over and not lost
        )
        observation = episode.observe(self._layout)
        return observation, sum(terms.values()), terminated, over and not terminated, info

    def _keeps_balance(self, stored: StoredGrasp) -> bool:
        """Whether the contacts that observations have room for can balance every load."""
        return stored.grasp.contacts.strongest(self.settings.max_contacts).balanceable

    def render(self) -> Picture | None:
        """(240, 320, 3) RGB picture, or None without a render mode."""
        episode = self._running()
        if self.render_mode is None:
            gymnasium.logger.warn(
                "render() shows nothing without a render mode: make the environment with "
                'render_mode="rgb_array".'
            )
            return None
        pose = episode.present.pose
        if isinstance(episode, StaticEpisode):
            body = self.objects[episode.start.object_id]
            self.simulation.load(body, pose, episode.start.joint_angles, friction=episode.friction)
        grasp, forces = self._commanded
        return picture_of_grasp(self.simulation, pose, grasp.contacts, forces, episode.load[:3])

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
        """How forces, (3n,) N, do on the problem of the coming step; resistance if it counts."""
        measures = episode.measure(forces)
        if not self.reward_weights.resistance:
            return measures
        resistance = least_resistance(episode.problem(), forces, self._disturbances, episode.radius)
        return measures._replace(resistance=resistance)

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
            "effort": measures.size,
            "resistance": measures.resistance,
            "object_id": episode.start.object_id,
            "grasp": self._number,
            **dict(zip(_REWARD_KEYS, terms.values(), strict=True)),
        }
