"""Published numbers of the BarrettHand BH8-280: metres, kilograms, radians, N·m.

Every group carries a `Ref:` to the public source of its numbers. Two kinds of frame occur:
the link frames of the JHU model (palm z points out of the palm, the third finger stands on +y), in
which everything but the table of link parameters is written, and the modified Denavit-Hartenberg
frames of Barrett's manual, in which `gfo_env.hand.kinematics` works.
"""

import math
from dataclasses import dataclass, replace
from typing import Final

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Box:
    """A box of full edge lengths `size` [m], centred at `xyz` and turned by `rpy` [rad]."""

    size: Vector
    xyz: Vector
    rpy: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Cylinder:
    """A cylinder along its own z, `length` [m] from face to face."""

    radius: float
    length: float
    xyz: Vector
    rpy: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Capsule:
    """A capsule along its own z; `length` [m] is the cylindrical part, without the two caps."""

    radius: float
    length: float
    xyz: Vector
    rpy: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class LinkInertia:
    """Mass [kg], centre of mass [m] and principal moments about it [kg·m²], link-frame axes."""

    mass: float
    center_of_mass: Vector
    moments: Vector

    def with_flywheel(self, moment: float) -> "LinkInertia":
        """The link with a massless thin disc of this moment about z at its centre of mass."""
        ixx, iyy, izz = self.moments
        return replace(self, moments=(ixx + moment / 2, iyy + moment / 2, izz + moment))


@dataclass(frozen=True)
class JointPlacement:
    """A revolute joint: its frame in the parent link, its axis in the child, its upper limit.

    The lower limit of every joint is 0, the open hand.
    """

    parent: str
    child: str
    xyz: Vector
    rpy: Vector
    axis: Vector
    upper: float


# Modified (Craig) Denavit-Hartenberg parameters.
# Ref: Barrett Technology, BH8-262 manual, Table 9, and support wiki, Hand/280; lengths as in
#   aalto-intelligent-robotics/pytorch_barrett_hand_forward_kinematics_layer, barrett_layer.py.
# Ref: PHI_2, PHI_3 and D_W from Barrett's published CAD: the outer joint lies at (0.06994, 0.003)
#   of the inner link, the fingertip axis stands 45 deg to the inner link's axis, the inner joint
#   stands 0.0415 + 0.0339 above the base plane. The wiki rounds D_W to 0.076; GraspIt!'s
#   BarrettBH8_280.xml has the same PHI_2 and 42.46 deg for PHI_3.
DH_A_W: Final = 0.025
DH_A_1: Final = 0.050
DH_A_2: Final = 0.070
DH_A_3: Final = 0.050
DH_D_3: Final = 0.0095
DH_D_W: Final = 0.0754
DH_PHI_2: Final = math.radians(2.46)
DH_PHI_3: Final = math.radians(42.54)
# Ref: same table. R is the side of the palm, J the direction in which a finger points at rest.
DH_R: Final = (-1.0, 1.0, 0.0)
DH_J: Final = (1.0, 1.0, -1.0)

# Joint ranges.
# Ref: Barrett support wiki, Hand/280 (140 deg inner, 180 deg spread); fingertip 48 deg as in
#   RobotnikAutomation/barrett_hand, pyHand_api.py (TIP_LIMIT); the data sheet rounds it to 45.
SPREAD_UPPER: Final = math.pi
INNER_UPPER: Final = math.radians(140.0)
OUTER_UPPER: Final = math.radians(48.0)

# Gear trains.
# Ref: BarrettTechnology/libbarrett, hand.h: motor to inner joint 125:1, motor to outer joint
#   375:1, spread 17.5:1. So the outer joint turns 125/375 = 1/3 of the inner one as long as the
#   finger's TorqueSwitch is engaged.
INNER_MOTOR_RATIO: Final = 125.0
OUTER_MOTOR_RATIO: Final = 375.0
OUTER_PER_INNER: Final = INNER_MOTOR_RATIO / OUTER_MOTOR_RATIO
# Ref: both spread axes are driven by one motor, mirrored; the joint axes below are mirrored too.
RIGHT_PER_LEFT_SPREAD: Final = 1.0

# Speeds [rad/s].
# Ref: BarrettHand specification sheet: finger fully open to closed in 1.0 s, spread of 180 deg
#   in 0.5 s. The outer joint follows by the gear ratio.
INNER_SPEED: Final = INNER_UPPER / 1.0
OUTER_SPEED: Final = INNER_SPEED * OUTER_PER_INNER
SPREAD_SPEED: Final = SPREAD_UPPER / 0.5

# Largest joint torques [N·m].
# Ref: BarrettHand specification sheet: 15 N at the fingertip. With a straight finger of
#   0.0700 + 0.0585 m that is 1.9 N·m at the inner joint and 0.88 N·m at the outer one, rounded
#   up. Spread: 2.0 N·m as in rdiankov/openrave, barretthand.kinbody.xml.
INNER_TORQUE: Final = 2.0
OUTER_TORQUE: Final = 1.0
SPREAD_TORQUE: Final = 2.0

# Rotor inertia [kg·m²].
# Ref: BarrettHand specification sheet, motor data.
ROTOR_INERTIA: Final = 1.41e-7

# Link kinds by name: F1 and F2 have a moving knuckle ("prox"), F3 stands on the palm.
LINK_KIND: Final[dict[str, str]] = {
    "palm": "palm",
    "f1_prox": "prox",
    "f1_med": "med",
    "f1_dist": "dist",
    "f2_prox": "prox",
    "f2_med": "med",
    "f2_dist": "dist",
    "f3_med": "med",
    "f3_dist": "dist",
}

# Masses, centres of mass and moments of inertia. Products of inertia are left out: the largest are
# the palm's yz, 6.4e-5, which the fixed palm never feels, and the knuckle's xz, -1.3e-5.
# Ref: palm: Barrett support wiki, Hand/280 MassByJoint v5, frame W with palm pad, turned by
#   180 deg about z into the frame used here.
# Ref: knuckle mass, inner and outer link: jhu-lcsr/barrett_model, hand.urdf.xacro, which took them
#   from the wiki; its tensors are about the joint, so m d² is subtracted. That file repeats the
#   inner link's tensor for the knuckle: here it is that of Barrett's CAD at uniform density.
LINK_INERTIA: Final[dict[str, LinkInertia]] = {
    "palm": LinkInertia(0.60858, (0.0, 0.0044561, 0.037268), (6.99e-4, 5.04e-4, 6.23e-4)),
    "prox": LinkInertia(0.14109, (0.0289, 0.0, 0.0171), (2.62e-5, 8.52e-5, 7.37e-5)),
    "med": LinkInertia(0.062139, (0.02313, 0.00079, 0.00053), (4.82e-6, 4.33e-5, 4.44e-5)),
    "dist": LinkInertia(0.041377, (0.02283, 0.00105, 0.00042), (3.11e-6, 1.68e-5, 1.57e-5)),
}

# Moment of inertia [kg·m²] of a massless flywheel that each moving link carries about z, its joint
# axis, to stand in for the rotor behind the gears: a modelling choice, not a published number,
# because PyBullet has no armature parameter. One finger motor reflects ROTOR_INERTIA * 125², so
# 2.2e-3, at the inner joint, five times the 4e-4 that the whole finger has about it; without it
# the simulated finger is far livelier than the real one. Inner and outer link, geared 1 to 1/3,
# together have 1e-3 + (4/3)² 3e-4 = 1.5e-3. The spread motor reflects only 4.3e-5: the knuckle's
# share, near the finger's own 0.3e-3 to 1.3e-3 about that axis, steadies a light chain in contact.
# A thin disc also has half of its moment about each diameter. Adding to z alone would not be the
# tensor of any rigid body, and PyBullet then sets the whole tensor to zero.
ARMATURE: Final[dict[str, float]] = {"palm": 0.0, "prox": 1e-3, "med": 1e-3, "dist": 3e-4}

# Kinematic tree; at zero all fingers lie flat and point outward, F1 and F2 to -y, F3 to +y.
# Ref: Barrett's published CAD (BH8-280), in the frames of jhu-lcsr/barrett_model,
#   hand.urdf.xacro.
_INNER_IN_KNUCKLE: Final = (0.05, 0.0, 0.0339)
_OUTER_IN_INNER: Final = (0.06994, 0.003, 0.0)
_SPREAD_RPY: Final = (0.0, 0.0, -math.pi / 2)
_INNER_RPY: Final = (math.pi / 2, 0.0, 0.0)
_OUTER_RPY: Final = (0.0, 0.0, math.pi / 4)
_Z: Final = (0.0, 0.0, 1.0)
_MINUS_Z: Final = (0.0, 0.0, -1.0)
JOINTS: Final[dict[str, JointPlacement]] = {
    "f1_spread": JointPlacement(
        "palm", "f1_prox", (-0.025, 0.0, 0.0415), _SPREAD_RPY, _MINUS_Z, SPREAD_UPPER
    ),
    "f1_med": JointPlacement("f1_prox", "f1_med", _INNER_IN_KNUCKLE, _INNER_RPY, _Z, INNER_UPPER),
    "f1_dist": JointPlacement("f1_med", "f1_dist", _OUTER_IN_INNER, _OUTER_RPY, _Z, OUTER_UPPER),
    "f2_spread": JointPlacement(
        "palm", "f2_prox", (0.025, 0.0, 0.0415), _SPREAD_RPY, _Z, SPREAD_UPPER
    ),
    "f2_med": JointPlacement("f2_prox", "f2_med", _INNER_IN_KNUCKLE, _INNER_RPY, _Z, INNER_UPPER),
    "f2_dist": JointPlacement("f2_med", "f2_dist", _OUTER_IN_INNER, _OUTER_RPY, _Z, OUTER_UPPER),
    "f3_med": JointPlacement(
        "palm", "f3_med", (0.0, 0.05, 0.0754), (math.pi / 2, 0.0, math.pi / 2), _Z, INNER_UPPER
    ),
    "f3_dist": JointPlacement("f3_med", "f3_dist", _OUTER_IN_INNER, _OUTER_RPY, _Z, OUTER_UPPER),
}

# Collision primitives by link kind.
# Ref: fitted to the bounding boxes of the parts of Barrett's published CAD (BH8-280).
_ALONG_X: Final = (0.0, math.pi / 2, 0.0)
COLLISION: Final[dict[str, tuple[Box | Cylinder | Capsule, ...]]] = {
    "palm": (
        Cylinder(0.0445, 0.0415, (0.0, 0.0, 0.02075)),
        Box((0.025, 0.084, 0.0248), (0.0, 0.0, 0.0539)),
        Box((0.089, 0.0615, 0.013), (0.0, -0.00425, 0.0728)),
        Box((0.0246, 0.038, 0.0485), (0.0, 0.046, 0.06615)),
    ),
    "prox": (
        Box((0.038, 0.0246, 0.0485), (0.046, 0.0, 0.02465)),
        Box((0.0473, 0.0246, 0.0248), (0.01135, 0.0, 0.0124)),
    ),
    "med": (Capsule(0.011, 0.067, (0.0335, 0.0007, -0.0008), _ALONG_X),),
    "dist": (Capsule(0.0095, 0.049, (0.0245, -0.0003, -0.0006), _ALONG_X),),
}

# Height [m] above the base plane of the palm's surface and, at y >= THUMB_KNUCKLE_Y, of the
# knuckle that carries the third finger.
# Ref: Barrett's published CAD (BH8-280).
PALM_SURFACE_HEIGHT: Final = 0.0793
THUMB_KNUCKLE_HEIGHT: Final = 0.0904
THUMB_KNUCKLE_Y: Final = 0.027
