"""What the rest of the project needs to know about a hand: names, limits, gears, strengths."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gfo_env.hand import constants as c


@dataclass(frozen=True)
class Gear:
    """Two joints behind one motor: angle of `driven` = `ratio` * angle of `driver`."""

    driver: str
    driven: str
    ratio: float


@dataclass(frozen=True)
class PalmRegion:
    """The part of the palm from `y_min` [m] on, whose surface is `height` [m] above the base."""

    y_min: float
    height: float


@dataclass(frozen=True)
class HandDescription:
    """A hand as data, so that another hand needs a URDF and one of these but no code.

    Attributes:
        name: name of the hand.
        urdf: path of its URDF file; the base link's frame is the hand's frame, its z axis points
            out of the palm.
        base_link: name of the URDF's root link.
        link_names: all other links, in the order of `joint_names` (link i is moved by joint i).
        joint_names: all moving joints, in the order of the simulator's joint indices and of the
            columns of the hand Jacobian.
        joint_lower: lower joint limits [rad], where the hand is open.
        joint_upper: upper joint limits [rad].
        max_torque: largest torque of either sign at each joint [N·m].
        max_speed: largest speed of each joint [rad/s].
        gears: couplings; a joint that is driven by none of them has a motor of its own.
        spread_joints: joints that are set before a grasp and then held.
        closing_joints: joints that are driven to close the hand; gears move the rest.
        closing_speed: speed of the closing joints while grasping [rad/s].
        closing_torque: torque with which they close at most while grasping [N·m].
        fingertip_links: the last link of each finger.
        contact_links: links that may touch an object.
        palm: the palm's surface; where regions overlap, the highest counts.
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

    def surface_height(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """(k,) height [m] of the palm below points (k, 3) in the hand frame."""
        heights = [
            np.where(points[:, 1] >= region.y_min, region.height, -np.inf) for region in self.palm
        ]
        return np.max(heights, axis=0)

    def open_angles(self, spread: float) -> NDArray[np.float64]:
        """(n_tau,) joint angles [rad] of the open hand at this spread."""
        return np.array(
            [
                spread if name in self.spread_joints else lower
                for name, lower in zip(self.joint_names, self.joint_lower, strict=True)
            ]
        )


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
