"""What the rest of the project needs to know about a hand: names, limits, gears, strengths."""

import math
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gfo_env.exceptions import HandError

from . import constants as c
from .elements import listed, refuse
from .urdf_reader import UrdfHand, read_urdf

LONGEST_CLOSING = 10.0
"""s that the slowest joint may take from open to closed: each attempt is simulated that long."""


@dataclass(frozen=True)
class Gear:
    """Two joints behind one motor: angle of `driven` = `ratio` * angle of `driver` + `offset`."""

    driver: str
    driven: str
    ratio: float
    offset: float = 0.0


@dataclass(frozen=True)
class PalmRegion:
    """The part of the palm from `y_min` [m] on, whose surface is `height` [m] above the base."""

    y_min: float
    height: float


@dataclass(frozen=True)
class HandDescription:
    """A hand as data, so that another hand needs a URDF and one of these but no code.

    `from_urdf` makes one from a URDF. Units are those of revolute joints; for a prismatic joint
    read m, N and m/s instead of rad, N·m and rad/s.

    Attributes:
        name: name of the hand.
        urdf: path of its URDF file, or of the copy that PyBullet can load; the base link's frame
            is the hand's frame, its z axis points out of the middle of the palm.
        base_link: name of the URDF's root link.
        link_names: the links that joints move, in the order of `joint_names` (link i is moved by
            joint i). Links fixed to one of them count as part of it.
        joint_names: all moving joints, in the order of the simulator's degrees of freedom, which
            is that of the columns of the hand Jacobian.
        joint_lower: lower joint limits [rad].
        joint_upper: upper joint limits [rad].
        max_torque: largest torque of either sign at each joint [N·m].
        max_speed: largest speed of each joint [rad/s].
        gears: couplings; a joint that is driven by none of them has a motor of its own.
        spread_joints: joints that are set to one random angle before a grasp and then held.
        closing_joints: joints that are driven to close the hand; gears move their part of the
            rest, and what neither moves is held where it is.
        closing_speed: speed of the closing joints while grasping [rad/s]. One for all is positive:
            joints close from where they are open towards the farther of their limits. One for each
            has the sign of the direction that closes it.
        closing_torque: torque with which they close at most while grasping [N·m], one for all or
            one for each.
        fingertip_links: the last link of each finger.
        contact_links: links that may touch an object.
        palm: the palm's surface; where regions overlap, the highest counts.
        joint_open: angles of the open hand [rad]; None: the lower limits.
        spread_range: lowest and highest angle to which the spread joints are set [rad].

    Raises:
        HandError: names or numbers that do not go together.
    """

    name: str
    urdf: Path
    base_link: str
    link_names: tuple[str, ...]
    joint_names: tuple[str, ...]
    joint_lower: tuple[float, ...]
    joint_upper: tuple[float, ...]
    max_torque: tuple[float, ...]
    max_speed: tuple[float, ...]
    gears: tuple[Gear, ...]
    spread_joints: tuple[str, ...]
    closing_joints: tuple[str, ...]
    closing_speed: float | tuple[float, ...]
    closing_torque: float | tuple[float, ...]
    fingertip_links: tuple[str, ...]
    contact_links: tuple[str, ...]
    palm: tuple[PalmRegion, ...]
    joint_open: tuple[float, ...] | None = None
    spread_range: tuple[float, float] = (0.0, math.pi / 2)

    def __post_init__(self) -> None:
        what = f"the description of {self.name!r}"
        refuse([*_wrong_names(self)], what)
        refuse([*_wrong_gears(self), *_wrong_numbers(self)], what)

    @classmethod
    def from_urdf(
        cls,
        path: str | Path,
        *,
        fingertip_links: Sequence[str],
        closing_joints: Sequence[str],
        closing_speed: float | Mapping[str, float],
        closing_torque: float | Mapping[str, float],
        palm: float | Sequence[PalmRegion],
        gears: Sequence[Gear] = (),
        spread_joints: Sequence[str] = (),
        spread_range: tuple[float, float] | None = None,
        open_angles: Mapping[str, float] | None = None,
        contact_links: Sequence[str] | None = None,
        max_torque: float | Mapping[str, float] | None = None,
        max_speed: float | Mapping[str, float] | None = None,
        name: str | None = None,
    ) -> "HandDescription":
        """A hand from its URDF, which names links, joints and limits, and from what it cannot say.

        Links may be named that are fixed to a moving one, such as a frame at the tip. If PyBullet
        cannot work with the file as it is, `urdf` is a copy in `graspforce/hands` below
        $XDG_CACHE_HOME or ~/.cache, and one warning tells of all that was made up for it: inertia
        of links that have a shape and none, or that no rigid body has, and pictures left out.

        Args:
            path: of the URDF. Its root link is the palm's or a frame: z points out of the palm
                through the point where the fingers meet. The root link is fixed in space.
            fingertip_links: the last link of each finger.
            closing_joints: joints that are driven to close the hand.
            closing_speed: of these [rad/s], positive; or by name, negative for joints that close
                downwards.
            closing_torque: with which they close at most [N·m], for all or by name.
            palm: height of the palm's surface above the root's origin [m], or regions of it.
            gears: couplings beside those of the URDF's mimic tags, or instead of them. A joint may
                follow one that follows another.
            spread_joints: joints that are set before a grasp and then held.
            spread_range: of the angles to which they are set [rad]; None: all that their limits
                allow.
            open_angles: joints that are not open at their lower limit, and their angle [rad].
            contact_links: links that may touch an object; None: all.
            max_torque: of every joint, or of some by name [N·m]; otherwise `effort` in the URDF.
            max_speed: of every joint, or of some by name [rad/s]; otherwise `velocity`.
            name: of the hand; None: the robot's.

        Raises:
            HandError: the URDF or an argument cannot be used; it says why and what to do, of all
                that is wrong at once.
        """
        urdf = read_urdf(Path(path))
        joints = {joint.name: joint for joint in urdf.joints}
        fingertips = _carriers(urdf, fingertip_links)
        refuse(
            [
                *_strangers("fingertip_links", fingertip_links, "link", urdf.carrier),
                *_strangers("contact_links", contact_links or (), "link", urdf.carrier),
                *_strangers("open_angles", open_angles or (), "joint", joints),
                *_strangers("max_torque", _named(max_torque), "joint", joints),
                *_strangers("max_speed", _named(max_speed), "joint", joints),
                *_not_for_all("closing_speed", closing_speed, closing_joints),
                *_not_for_all("closing_torque", closing_torque, closing_joints),
                *_untouchable(set(fingertips) - urdf.touching - {urdf.base_link}),
            ],
            path,
        )
        geared = {gear.driven for gear in gears}
        mimics = tuple(
            Gear(joint.mimic.joint, joint.name, joint.mimic.multiplier, joint.mimic.offset)
            for joint in urdf.joints
            if joint.mimic is not None and joint.name not in geared
        )
        spread = [joints[name] for name in spread_joints if name in joints]
        if spread_range is None:
            lower = max((joint.lower for joint in spread), default=0.0)
            spread_range = lower, min((joint.upper for joint in spread), default=0.0)
        heights = (PalmRegion(-math.inf, float(palm)),) if isinstance(palm, int | float) else palm
        hand = cls(
            name=urdf.name if name is None else name,
            urdf=urdf.path,
            base_link=urdf.base_link,
            link_names=tuple(joint.child for joint in urdf.joints),
            joint_names=tuple(joints),
            joint_lower=tuple(joint.lower for joint in urdf.joints),
            joint_upper=tuple(joint.upper for joint in urdf.joints),
            max_torque=_strengths(urdf, "effort", max_torque),
            max_speed=_strengths(urdf, "velocity", max_speed),
            gears=_unchained((*gears, *mimics)),
            spread_joints=tuple(spread_joints),
            closing_joints=tuple(closing_joints),
            closing_speed=_each(closing_speed, closing_joints),
            closing_torque=_each(closing_torque, closing_joints),
            fingertip_links=fingertips,
            contact_links=_carriers(urdf, urdf.carrier if contact_links is None else contact_links),
            palm=tuple(heights),
            joint_open=tuple(
                (open_angles or {}).get(joint.name, joint.lower) for joint in urdf.joints
            ),
            spread_range=spread_range,
        )
        if urdf.notes:
            warnings.warn(
                f"Of {path}, the simulator has a copy in which something is made up or left out: "
                f"{'; '.join(urdf.notes)}.",
                stacklevel=2,
            )
        return hand

    @property
    def held_joints(self) -> tuple[str, ...]:
        """Spread joints, and joints that neither a motor nor a gear closes."""
        moved = {*self.closing_joints, *self.spread_joints, *(gear.driven for gear in self.gears)}
        return self.spread_joints + tuple(name for name in self.joint_names if name not in moved)

    @property
    def closing_speeds(self) -> NDArray[np.float64]:
        """(closing joints,) speed of each [rad/s], with the sign that closes it."""
        if isinstance(self.closing_speed, tuple):
            return np.array(self.closing_speed, dtype=np.float64)
        opened, lower, upper = self._closing_ranges()
        opens_below = opened <= (lower + upper) / 2
        return np.where(opens_below, self.closing_speed, -self.closing_speed)

    @property
    def closing_torques(self) -> NDArray[np.float64]:
        """(closing joints,) torque with which each closes at most [N·m]."""
        return np.array(np.broadcast_to(self.closing_torque, len(self.closing_joints)))

    @property
    def closing_times(self) -> NDArray[np.float64]:
        """(closing joints,) s that each takes from where it is open to the limit where it ends."""
        opened, lower, upper = self._closing_ranges()
        speeds = self.closing_speeds
        return np.where(speeds > 0, upper - opened, lower - opened) / speeds

    def _closing_ranges(self) -> NDArray[np.float64]:
        """(3, closing joints) open angles, lower and upper limits [rad]."""
        columns = [self.joint_names.index(name) for name in self.closing_joints]
        ranges = (self.joint_open or self.joint_lower, self.joint_lower, self.joint_upper)
        return np.array(ranges)[:, columns]

    def surface_height(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """(k,) height [m] of the palm below points (k, 3) in the hand frame."""
        heights = [
            np.where(points[:, 1] >= region.y_min, region.height, -np.inf) for region in self.palm
        ]
        return np.max(heights, axis=0)

    def open_angles(self, spread: float) -> NDArray[np.float64]:
        """(n_tau,) joint angles [rad] of the open hand at this spread."""
        opened = dict(zip(self.joint_names, self.joint_open or self.joint_lower, strict=True))
        opened |= dict.fromkeys(self.spread_joints, spread)
        for gear in self.gears:
            opened[gear.driven] = gear.ratio * opened[gear.driver] + gear.offset
        return np.array(list(opened.values()))


def _wrong_names(hand: HandDescription) -> Iterator[str]:
    links = (hand.base_link, *hand.link_names)
    for field, names, what, known in (
        ("fingertip_links", hand.fingertip_links, "link", links),
        ("contact_links", hand.contact_links, "link", links),
        ("spread_joints", hand.spread_joints, "joint", hand.joint_names),
        ("closing_joints", hand.closing_joints, "joint", hand.joint_names),
        ("gears", [gear.driver for gear in hand.gears], "joint", hand.joint_names),
        ("gears", [gear.driven for gear in hand.gears], "joint", hand.joint_names),
    ):
        yield from _strangers(field, names, what, known)
    for field in ("fingertip_links", "closing_joints"):
        if not getattr(hand, field):
            yield f"{field} is empty: a hand needs one at least."
    if hand.base_link in hand.fingertip_links:
        yield f"fingertip_links: no joint moves {hand.base_link!r}, the base."
    if both := set(hand.closing_joints) & set(hand.spread_joints):
        yield f"Joints are to close and to be held: {_text(both)}; drop them from one."
    for field in ("closing_speed", "closing_torque"):
        given = getattr(hand, field)
        if isinstance(given, tuple) and len(given) != len(hand.closing_joints):
            yield f"{field} has {len(given)} numbers for {len(hand.closing_joints)} closing joints."


def _wrong_gears(hand: HandDescription) -> Iterator[str]:
    driven = [gear.driven for gear in hand.gears]
    if twice := {name for name in driven if driven.count(name) > 1}:
        yield f"More than one gear drives {_text(twice)}: keep one for each."
    for field, names in (
        ("a driver of gears", [gear.driver for gear in hand.gears]),
        ("among closing_joints", hand.closing_joints),
    ):
        if both := set(names) & set(driven):
            yield (
                f"{_text(both)} is driven by a gear and {field}: name the joint that has the motor."
            )
    opened = dict(zip(hand.joint_names, hand.open_angles(hand.spread_range[0]), strict=True))
    for gear in hand.gears:
        if gear.ratio == 0 or not math.isfinite(gear.ratio + gear.offset):
            yield f"The gear of {gear.driven!r} needs finite numbers, ratio not 0."
            continue
        joint = hand.joint_names.index(gear.driven)
        lower, upper = hand.joint_lower[joint], hand.joint_upper[joint]
        if not lower - _PLAY <= opened[gear.driven] <= upper + _PLAY:
            yield (
                f"Its gear opens {gear.driven!r} to {opened[gear.driven]:.4g} rad, outside its "
                f"limits from {lower:.4g} to {upper:.4g}: change the gear, the limits, or the open "
                f"angle of {gear.driver!r}."
            )


def _wrong_numbers(hand: HandDescription) -> Iterator[str]:
    for field, key in (("max_torque", "effort"), ("max_speed", "velocity")):
        values = zip(hand.joint_names, getattr(hand, field), strict=True)
        if wrong := {name: value for name, value in values if not 0 < value < math.inf}:
            yield (
                f"{field} must be positive, but is {_numbers(wrong)}: give {key} in the <limit> of "
                f"each, or the argument {field}."
            )
    opened = hand.joint_open or hand.joint_lower
    limits = zip(hand.joint_names, opened, hand.joint_lower, hand.joint_upper, strict=True)
    for name, angle, lower, upper in limits:
        if not lower <= angle <= upper:
            yield (
                f"Joint {name!r} is to be open at {angle:g}, outside its limits from {lower:g} "
                f"to {upper:g}."
            )
    yield from _wrong_closing(hand)
    if not -math.inf < hand.spread_range[0] <= hand.spread_range[1] < math.inf:
        yield (
            f"spread_range must be two angles, the lower first, not {hand.spread_range}: the "
            "limits of the spread joints may have no angle in common."
        )
    if not any(region.y_min == -math.inf for region in hand.palm):
        yield "palm needs a region whose y_min is -inf: its height everywhere."


def _wrong_closing(hand: HandDescription) -> Iterator[str]:
    one = not isinstance(hand.closing_speed, tuple)
    speeds = np.abs(hand.closing_speed) if not one else np.array([hand.closing_speed])
    if not np.all((speeds > 0) & np.isfinite(speeds)):
        what = "a positive number" if one else "finite and not 0 for each joint"
        yield f"closing_speed must be {what}, not {hand.closing_speed!r}."
    else:
        times = dict(zip(hand.closing_joints, hand.closing_times.tolist(), strict=True))
        if shut := [name for name, time in times.items() if not time > 0]:
            yield (
                f"closing_speed: {_text(shut)} is open at the limit towards which it is to close; "
                "turn the sign, or change its open angle."
            )
        if slow := {name: time for name, time in times.items() if time > LONGEST_CLOSING}:
            yield (
                f"closing_speed is so low that joints take longer than {LONGEST_CLOSING:g} s from "
                f"open to closed: {_numbers(slow)}; raise it. Slides take m/s."
            )
    torques = dict(zip(hand.closing_joints, hand.closing_torques.tolist(), strict=True))
    if not all(0 < torque < math.inf for torque in torques.values()):
        yield f"closing_torque must be a positive number, not {hand.closing_torque!r}."
    strengths = dict(zip(hand.joint_names, hand.max_torque, strict=True))
    if weak := {n: strengths[n] for n, torque in torques.items() if torque > strengths[n] > 0}:
        yield f"closing_torque is above the limit of closing joints, {_numbers(weak)}: lower it."


def _strengths(
    urdf: UrdfHand, key: str, given: float | Mapping[str, float] | None
) -> tuple[float, ...]:
    """One number for each joint: what is given for it, or else the URDF's."""
    if given is None or isinstance(given, Mapping):
        said = given or {}
        return tuple(said.get(joint.name, getattr(joint, key)) for joint in urdf.joints)
    return (float(given),) * len(urdf.joints)


def _named(given: float | Mapping[str, float] | None) -> Iterable[str]:
    return given if isinstance(given, Mapping) else ()


def _each(given: float | Mapping[str, float], joints: Sequence[str]) -> float | tuple[float, ...]:
    """One number for all, or those of the joints in their order."""
    return tuple(given[name] for name in joints) if isinstance(given, Mapping) else given


def _not_for_all(
    field: str, given: float | Mapping[str, float], joints: Sequence[str]
) -> Iterator[str]:
    """What is wrong with numbers by name, which all the closing joints must have and no others."""
    if isinstance(given, Mapping) and set(given) != set(joints):
        yield (
            f"{field} has numbers for {listed(given)}, but the closing joints are "
            f"{listed(joints)}: give one for each of them, or one number for all."
        )


def _carriers(urdf: UrdfHand, links: Iterable[str]) -> tuple[str, ...]:
    """The links that these move with, each once; strangers are left out."""
    return tuple(dict.fromkeys(urdf.carrier[link] for link in links if link in urdf.carrier))


def _untouchable(links: set[str]) -> Iterator[str]:
    """What is wrong with fingertips that nothing can touch."""
    if links:
        yield (
            f"fingertip_links: no <collision> moves with {_text(links)}, so that no object is felt "
            "there: give the links shapes, or name those that have them."
        )


def _unchained(gears: tuple[Gear, ...]) -> tuple[Gear, ...]:
    """The same couplings, each to the joint at the beginning of its chain."""
    by_driven = {gear.driven: gear for gear in gears}
    result = []
    for gear in gears:
        chain = [gear.driven]
        while above := by_driven.get(gear.driver):
            if gear.driver in chain:
                raise HandError(f"The gears of {listed(chain)} form a loop: none has a motor.")
            chain.append(gear.driver)
            gear = Gear(
                above.driver,
                gear.driven,
                gear.ratio * above.ratio,
                gear.ratio * above.offset + gear.offset,
            )
        result.append(gear)
    return tuple(result)


def _strangers(field: str, names: Iterable[str], what: str, known: Iterable[str]) -> Iterator[str]:
    """What is wrong with names that the hand does not have."""
    if missing := set(names) - set(known):
        yield f"{field}: the hand has no {what} {_text(missing)}; it has {', '.join(known)}."


def _numbers(values: Mapping[str, float]) -> str:
    return ", ".join(f"{value:.4g} of {name!r}" for name, value in values.items())


def _text(names: Iterable[str]) -> str:
    return listed(sorted(names))


_PLAY = 1e-6

_STRENGTH = {"spread": c.SPREAD_TORQUE, "med": c.INNER_TORQUE, "dist": c.OUTER_TORQUE}
_SPEED = {"spread": c.SPREAD_SPEED, "med": c.INNER_SPEED, "dist": c.OUTER_SPEED}
_ROLES = tuple(name.split("_")[1] for name in c.JOINTS)

BARRETT_BH8_280 = HandDescription(
    name="barrett_bh8_280",
    urdf=Path(__file__).with_name("barrett_bh8_280.urdf"),
    base_link="palm",
    link_names=tuple(joint.child for joint in c.JOINTS.values()),
    joint_names=tuple(c.JOINTS),
    joint_lower=(0.0,) * len(c.JOINTS),
    joint_upper=tuple(joint.upper for joint in c.JOINTS.values()),
    max_torque=tuple(_STRENGTH[role] for role in _ROLES),
    max_speed=tuple(_SPEED[role] for role in _ROLES),
    gears=(
        Gear("f1_spread", "f2_spread", c.RIGHT_PER_LEFT_SPREAD),
        Gear("f1_med", "f1_dist", c.OUTER_PER_INNER),
        Gear("f2_med", "f2_dist", c.OUTER_PER_INNER),
        Gear("f3_med", "f3_dist", c.OUTER_PER_INNER),
    ),
    spread_joints=("f1_spread", "f2_spread"),
    closing_joints=("f1_med", "f2_med", "f3_med"),
    # Slower and weaker than the hardware can, for a gentle close.
    closing_speed=1.5,
    closing_torque=0.8,
    fingertip_links=("f1_dist", "f2_dist", "f3_dist"),
    contact_links=tuple(c.LINK_KIND),
    palm=(
        PalmRegion(-math.inf, c.PALM_SURFACE_HEIGHT),
        # 2 mm of play before the knuckle, 1 mm above it
        PalmRegion(c.THUMB_KNUCKLE_Y - 0.002, c.THUMB_KNUCKLE_HEIGHT + 0.001),
    ),
)
