"""What the rest of the project needs to know about a hand: names, limits, gears, strengths."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gfo_env.exceptions import HandError

from . import constants as c
from .urdf_reader import UrdfHand, read_urdf


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
        urdf: path of its URDF file; the base link's frame is the hand's frame, its z axis points
            out of the middle of the palm.
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
        closing_speed: speed of the closing joints while grasping [rad/s], positive: joints close
            from where they are open towards the farther of their limits.
        closing_torque: torque with which they close at most while grasping [N·m].
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
    closing_speed: float
    closing_torque: float
    fingertip_links: tuple[str, ...]
    contact_links: tuple[str, ...]
    palm: tuple[PalmRegion, ...]
    joint_open: tuple[float, ...] | None = None
    spread_range: tuple[float, float] = (0.0, math.pi / 2)

    def __post_init__(self) -> None:
        _check_names(self)
        _check_gears(self)
        _check_numbers(self)

    @classmethod
    def from_urdf(
        cls,
        path: str | Path,
        *,
        fingertip_links: Sequence[str],
        closing_joints: Sequence[str],
        closing_speed: float,
        closing_torque: float,
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

        Links may be named that are fixed to a moving one, such as a frame at the tip.

        Args:
            path: of the URDF. Its root link is the palm's or a frame: z points out of the palm
                through the point where the fingers meet. The root link is fixed in space.
            fingertip_links: the last link of each finger.
            closing_joints: joints that are driven to close the hand.
            closing_speed: of these [rad/s], positive.
            closing_torque: with which they close at most [N·m].
            palm: height of the palm's surface above the root's origin [m], or regions of it.
            gears: couplings beside those of the URDF's mimic tags, or instead of them.
            spread_joints: joints that are set before a grasp and then held.
            spread_range: of the angles to which they are set [rad]; None: all that their limits
                allow.
            open_angles: joints that are not open at their lower limit, and their angle [rad].
            contact_links: links that may touch an object; None: all.
            max_torque: of every joint, or of some by name [N·m]; otherwise `effort` in the URDF.
            max_speed: of every joint, or of some by name [rad/s]; otherwise `velocity`.
            name: of the hand; None: the robot's.

        Raises:
            HandError: the URDF or an argument cannot be used; it says why and what to do.
        """
        urdf = read_urdf(Path(path))
        joints = {joint.name: joint for joint in urdf.joints}
        if unknown := set(open_angles or ()) - set(joints):
            raise HandError(f"open_angles: {_unknown(unknown, 'joint', joints)}")
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
        return cls(
            name=urdf.name if name is None else name,
            urdf=Path(path).resolve(),
            base_link=urdf.base_link,
            link_names=tuple(joint.child for joint in urdf.joints),
            joint_names=tuple(joints),
            joint_lower=tuple(joint.lower for joint in urdf.joints),
            joint_upper=tuple(joint.upper for joint in urdf.joints),
            max_torque=_strengths(urdf, "effort", max_torque, "max_torque"),
            max_speed=_strengths(urdf, "velocity", max_speed, "max_speed"),
            gears=(*gears, *mimics),
            spread_joints=tuple(spread_joints),
            closing_joints=tuple(closing_joints),
            closing_speed=closing_speed,
            closing_torque=closing_torque,
            fingertip_links=_carriers(urdf, fingertip_links, "fingertip_links"),
            contact_links=_carriers(
                urdf, urdf.carrier if contact_links is None else contact_links, "contact_links"
            ),
            palm=tuple(heights),
            joint_open=tuple(
                (open_angles or {}).get(joint.name, joint.lower) for joint in urdf.joints
            ),
            spread_range=spread_range,
        )

    @property
    def held_joints(self) -> tuple[str, ...]:
        """Spread joints, and joints that neither a motor nor a gear closes."""
        moved = {*self.closing_joints, *self.spread_joints, *(gear.driven for gear in self.gears)}
        return self.spread_joints + tuple(name for name in self.joint_names if name not in moved)

    @property
    def closing_speeds(self) -> NDArray[np.float64]:
        """(closing joints,) speed of each [rad/s], with the sign that closes it."""
        opened = dict(zip(self.joint_names, self.joint_open or self.joint_lower, strict=True))
        limits = zip(self.joint_lower, self.joint_upper, strict=True)
        middle = dict(zip(self.joint_names, (sum(pair) / 2 for pair in limits), strict=True))
        opens_below = np.array([opened[name] <= middle[name] for name in self.closing_joints])
        return np.where(opens_below, self.closing_speed, -self.closing_speed)

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


def _check_names(hand: HandDescription) -> None:
    links = (hand.base_link, *hand.link_names)
    for field, names, what, known in (
        ("fingertip_links", hand.fingertip_links, "link", links),
        ("contact_links", hand.contact_links, "link", links),
        ("spread_joints", hand.spread_joints, "joint", hand.joint_names),
        ("closing_joints", hand.closing_joints, "joint", hand.joint_names),
        ("gears", [gear.driver for gear in hand.gears], "joint", hand.joint_names),
        ("gears", [gear.driven for gear in hand.gears], "joint", hand.joint_names),
    ):
        if missing := set(names) - set(known):
            raise HandError(f"{field}: {_unknown(missing, what, known)}")
    for field in ("fingertip_links", "closing_joints"):
        if not getattr(hand, field):
            raise HandError(f"{field} is empty: a hand needs one at least.")
    if hand.base_link in hand.fingertip_links:
        raise HandError(f"fingertip_links: no joint moves {hand.base_link!r}, the base.")
    if both := set(hand.closing_joints) & set(hand.spread_joints):
        raise HandError(f"Joints are to close and to be held: {_text(both)}; drop them from one.")


def _check_gears(hand: HandDescription) -> None:
    driven = [gear.driven for gear in hand.gears]
    if twice := {name for name in driven if driven.count(name) > 1}:
        raise HandError(f"More than one gear drives {_text(twice)}: keep one for each.")
    for field, names in (
        ("a driver of gears", [gear.driver for gear in hand.gears]),
        ("among closing_joints", hand.closing_joints),
    ):
        if both := set(names) & set(driven):
            raise HandError(
                f"{_text(both)} is driven by a gear and {field}: name the joint that has the motor."
            )
    opened = dict(zip(hand.joint_names, hand.open_angles(hand.spread_range[0]), strict=True))
    for gear in hand.gears:
        if gear.ratio == 0 or not math.isfinite(gear.ratio + gear.offset):
            raise HandError(f"The gear of {gear.driven!r} needs finite numbers, ratio not 0.")
        joint = hand.joint_names.index(gear.driven)
        lower, upper = hand.joint_lower[joint], hand.joint_upper[joint]
        if not lower - _PLAY <= opened[gear.driven] <= upper + _PLAY:
            raise HandError(
                f"Its gear opens {gear.driven!r} to {opened[gear.driven]:.4g} rad, outside its "
                f"limits from {lower:.4g} to {upper:.4g}: change the gear, the limits, or the open "
                f"angle of {gear.driver!r}."
            )


def _check_numbers(hand: HandDescription) -> None:
    for field in ("max_torque", "max_speed"):
        for name, value in zip(hand.joint_names, getattr(hand, field), strict=True):
            if not 0 < value < math.inf:
                key = {"max_torque": "effort", "max_speed": "velocity"}[field]
                raise HandError(
                    f"Joint {name!r} has {field} {value:g}, but it must be positive: give "
                    f"{key} in its <limit>, or the argument {field}."
                )
    for field in ("closing_speed", "closing_torque"):
        value = getattr(hand, field)
        if not 0 < value < math.inf:
            raise HandError(f"{field} must be a positive number, not {value!r}.")
    weakest = min(hand.max_torque[hand.joint_names.index(name)] for name in hand.closing_joints)
    if hand.closing_torque > weakest:
        raise HandError(
            f"closing_torque {hand.closing_torque:g} is above the limit of a closing joint, "
            f"{weakest:g}: lower it."
        )
    opened = hand.joint_open or hand.joint_lower
    limits = zip(hand.joint_names, opened, hand.joint_lower, hand.joint_upper, strict=True)
    for name, angle, lower, upper in limits:
        if not lower <= angle <= upper:
            raise HandError(
                f"Joint {name!r} is to be open at {angle:g}, outside its limits from {lower:g} "
                f"to {upper:g}."
            )
    if not -math.inf < hand.spread_range[0] <= hand.spread_range[1] < math.inf:
        raise HandError(
            f"spread_range must be two angles, the lower first, not {hand.spread_range}: the "
            "limits of the spread joints may have no angle in common."
        )
    if not any(region.y_min == -math.inf for region in hand.palm):
        raise HandError("palm needs a region whose y_min is -inf: its height everywhere.")


def _strengths(
    urdf: UrdfHand, key: str, given: float | Mapping[str, float] | None, field: str
) -> tuple[float, ...]:
    """One number for each joint: what is given for it, or else the URDF's."""
    names = [joint.name for joint in urdf.joints]
    if given is None or isinstance(given, int | float):
        given = {} if given is None else dict.fromkeys(names, float(given))
    if missing := set(given) - set(names):
        raise HandError(f"{field}: {_unknown(missing, 'joint', names)}")
    return tuple(given.get(joint.name, getattr(joint, key)) for joint in urdf.joints)


def _carriers(urdf: UrdfHand, links: Iterable[str], field: str) -> tuple[str, ...]:
    """The links that these move with, each once."""
    links = tuple(links)
    if missing := set(links) - set(urdf.carrier):
        raise HandError(f"{field}: {_unknown(missing, 'link', urdf.carrier)}")
    return tuple(dict.fromkeys(urdf.carrier[link] for link in links))


def _unknown(names: Iterable[str], what: str, known: Iterable[str]) -> str:
    return f"the hand has no {what} {_text(names)}; it has {', '.join(known)}."


def _text(names: Iterable[str]) -> str:
    return ", ".join(map(repr, sorted(names)))


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
