"""Eight public right hands as their makers' URDFs have them, from published numbers, in few shapes.

Names, limits, strengths and couplings of joints are the makers', lengths rounded to what capsules
and boxes can show. So are their habits: frames without mass, links without inertia, inertia that no
rigid body has, chains of coupled joints, slides that open upwards, and meshes of formats that
PyBullet does not read.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import trimesh

Numbers = Sequence[float]
Limits = tuple[float, float]

ALONG = (0.0, 0.0, 0.0)
FROM_ABOVE = (0.0, math.pi / 2, 0.0)
"""Of a finger at the upper edge of the palm that points out of it and closes downwards."""
FROM_BELOW = (math.pi, -math.pi / 2, 0.0)
"""Of a thumb at the lower edge of the palm that points out of it and closes upwards."""


def words(values: Iterable[float]) -> str:
    return " ".join(f"{value:.6g}" for value in values)


@dataclass(frozen=True)
class Bone:
    """A hinge and its link, which reaches along z; one of no length is a frame between two axes."""

    joint: str
    limits: Limits
    length: float = 0.0
    axis: str = "0 1 0"
    mimic: tuple[str, float, float] | None = None


@dataclass
class Urdf:
    """A URDF under construction. Palms have x out of them and z along the fingers.

    Attributes:
        name: of the robot.
        folder: of the file and its meshes.
        effort: N·m, of every joint.
        velocity: rad/s, of every joint.
        moments: of every link that has inertia.
        mass: kg, of every such link; links have none if it is 0.
        mesh: endings of the files of shapes, in turns; none: capsules.
    """

    name: str
    folder: Path
    effort: float
    velocity: float
    moments: tuple[float, float, float] = (2e-5, 2e-5, 1e-5)
    mass: float = 0.02
    mesh: Sequence[str] = ()
    lines: list[str] = field(default_factory=list)

    def write(self) -> Path:
        """The file, all in one line, as some generators write it."""
        path = self.folder / f"{self.name}.urdf"
        path.write_text(f'<robot name="{self.name}">{"".join(self.lines)}</robot>')
        return path

    def frame(self, name: str, parent: str, xyz: Numbers, rpy: Numbers = ALONG) -> None:
        """A link that is nothing but a place."""
        self.lines.append(f'<link name="{name}"/>')
        self.joint(f"{name}_fixed", "fixed", parent, name, xyz, rpy)

    def link(self, name: str, shape: str, at: Numbers, visual: str = "") -> None:
        """A link of one shape."""
        ixx, iyy, izz = self.moments
        inertial = (
            f'<inertial><origin xyz="{words(at)}"/><mass value="{self.mass}"/><inertia ixx="{ixx}" '
            f'iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0"/></inertial>'
        )
        place = f'<origin xyz="{words(at)}"/><geometry>'
        self.lines.append(
            f'<link name="{name}">{inertial if self.mass else ""}'
            f"<visual>{place}{visual or shape}</geometry></visual>"
            f"<collision>{place}{shape}</geometry></collision></link>"
        )

    def joint(
        self, name: str, kind: str, parent: str, child: str, xyz: Numbers, rpy: Numbers = ALONG,
        rest: str = "",
    ) -> None:  # fmt: skip
        self.lines.append(
            f'<joint name="{name}" type="{kind}"><origin xyz="{words(xyz)}" rpy="{words(rpy)}"/>'
            f'<parent link="{parent}"/><child link="{child}"/>{rest}</joint>'
        )

    def moved(
        self, axis: str, limits: Limits, mimic: tuple[str, float, float] | None = None
    ) -> str:
        """What a joint that moves has beside its place."""
        follows = '<mimic joint="{}" multiplier="{}" offset="{}"/>'.format(*mimic) if mimic else ""
        return (
            f'<axis xyz="{axis}"/><limit lower="{limits[0]}" upper="{limits[1]}" '
            f'effort="{self.effort}" velocity="{self.velocity}"/>{follows}'
        )

    def palm(self, name: str, size: Numbers, centre: float, parent: str = "root") -> None:
        """The root and a palm whose face is at x = 0, its upper edge at z = 0.

        The root's z axis, out of the palm, passes `centre` below that edge.
        """
        self.lines.append(f'<link name="{parent}"/>')
        self.joint(f"{name}_fixed", "fixed", parent, name, (-centre, 0, 0), (0, -math.pi / 2, 0))
        self.link(name, f'<box size="{words(size)}"/>', (-size[0] / 2, 0, -size[2] / 2))

    def finger(
        self, parent: str, xyz: Numbers, rpy: Numbers, radius: float, bones: Sequence[Bone],
        tip: str,
    ) -> str:  # fmt: skip
        """Bones one after the other, and a frame at the end, whose name is returned."""
        for bone in bones:
            link = f"{bone.joint}_link"
            if bone.length:
                self.link(link, self.shape(link, radius, bone.length), (0, 0, bone.length / 2))
            else:
                self.lines.append(f'<link name="{link}"/>')
            rest = self.moved(bone.axis, bone.limits, bone.mimic)
            self.joint(bone.joint, "revolute", parent, link, xyz, rpy, rest)
            parent, xyz, rpy = link, (0, 0, bone.length), ALONG
        self.frame(tip, parent, xyz)
        return tip

    def shape(self, link: str, radius: float, length: float) -> str:
        """A capsule, or a mesh of it."""
        straight = max(length - radius, 1e-3)
        if not self.mesh:
            return f'<capsule radius="{radius}" length="{straight:.6g}"/>'
        mesh = trimesh.creation.capsule(height=straight, radius=radius, count=[8, 8])
        ending = self.mesh[len(self.lines) % len(self.mesh)]
        path = self.folder / "meshes" / f"{link}.{ending.removeprefix('text.')}"
        path.parent.mkdir(exist_ok=True)
        mesh.export(path, file_type="stl_ascii" if ending == "text.stl" else None)
        # in a package whose folder has another name, as one that was downloaded
        return f'<mesh filename="package://{self.name}_description/meshes/{path.name}"/>'


@dataclass(frozen=True)
class PublicHand:
    """What `HandDescription.from_urdf` is given, and what it must find.

    Attributes:
        path: of the URDF.
        said: the other arguments.
        joints: how many move.
        motors: how many of them follow no other.
        made_up: whether something must be made up, of which a warning tells.
    """

    path: Path
    said: dict[str, Any]
    joints: int
    motors: int
    made_up: bool = False


def said(tips: Sequence[str], closing: Sequence[str], torque: float, **more: Any) -> dict[str, Any]:
    """The arguments that all have."""
    return {
        "fingertip_links": tips,
        "closing_joints": closing,
        "closing_speed": 1.5,
        "closing_torque": torque,
        "palm": 0.0,
    } | more


def allegro(folder: Path) -> PublicHand:
    """Wonik Robotics Allegro: wrist and fingertips are frames without mass."""
    urdf = Urdf("allegro_hand_right", folder, effort=0.7, velocity=7)
    urdf.palm("palm", (0.0408, 0.113, 0.095), 0.03)
    urdf.frame("wrist", "palm", (0, 0, -0.095))
    tips = []
    for first, y, roll in ((0, 0.0435, -0.0873), (4, 0.0, 0.0), (8, -0.0435, 0.0873)):
        limits = ((-0.47, 0.47), (-0.196, 1.61), (-0.174, 1.709), (-0.227, 1.618))
        lengths, axes = (0.0164, 0.054, 0.0384, 0.0427), ("0 0 1", *["0 1 0"] * 3)
        bones = [Bone(f"joint_{first + k}.0", limits[k], lengths[k], axes[k]) for k in range(4)]
        tip = f"link_{first + 3}.0_tip"
        tips.append(urdf.finger("palm", (0, y, 0), (roll, 0, 0), 0.0098, bones, tip))
    bones = [
        Bone("joint_12.0", (0.263, 1.396), axis="1 0 0"),
        Bone("joint_13.0", (-0.105, 1.163), 0.0177),
        Bone("joint_14.0", (-0.189, 1.644), 0.0514),
        Bone("joint_15.0", (-0.162, 1.719), 0.0593),
    ]
    place = (math.pi - 0.8, *FROM_BELOW[1:])
    tips.append(urdf.finger("palm", (0.01, 0, -0.085), place, 0.0098, bones, "link_15.0_tip"))
    closing = [f"joint_{k}.0" for k in range(14) if k % 4 and k != 12] + [
        "joint_14.0",
        "joint_15.0",
    ]
    opened = {"joint_0.0": 0.0, "joint_4.0": 0.0, "joint_8.0": 0.0, "joint_12.0": 0.8}
    return PublicHand(urdf.write(), said(tips, closing, 0.3, open_angles=opened), 16, 16)


def leap(folder: Path) -> PublicHand:
    """LEAP hand (Shaw et al. 2023): joints with numbers for names, meshes of every format."""
    meshes = ("text.stl", "ply", "glb", "off", "stl", "obj")
    urdf = Urdf("leap_hand_right", folder, effort=0.95, velocity=8.48, mesh=meshes)
    urdf.palm("palm_lower", (0.03, 0.14, 0.1), 0.03)
    tips = []
    for finger, y in enumerate((0.0454, 0.0, -0.0454)):
        first = 4 * finger
        bones = [
            Bone(str(first + 1), (-0.314, 2.23), 0.015),
            Bone(str(first), (-1.047, 1.047), 0.038, "0 0 1"),
            Bone(str(first + 2), (-0.506, 1.885), 0.036),
            Bone(str(first + 3), (-0.366, 2.042), 0.045),
        ]
        tips.append(urdf.finger("palm_lower", (0, y, 0), ALONG, 0.01, bones, f"tip{finger}"))
    bones = [
        Bone("12", (-0.349, 2.094), axis="1 0 0"),
        Bone("13", (-0.47, 2.443), 0.03),
        Bone("14", (-1.2, 1.9), 0.045),
        Bone("15", (-1.34, 1.88), 0.05),
    ]
    place = (math.pi - 0.9, *FROM_BELOW[1:])
    tips.append(urdf.finger("palm_lower", (0.01, 0, -0.09), place, 0.01, bones, "thumb_tip"))
    closing = [str(first + k) for first in (0, 4, 8) for k in (1, 2, 3)] + ["13", "14", "15"]
    opened = dict.fromkeys(("0", "1", "4", "5", "8", "9", "14", "15"), 0.0) | {"12": 0.9}
    return PublicHand(urdf.write(), said(tips, closing, 0.4, open_angles=opened), 16, 16)


def shadow(folder: Path) -> PublicHand:
    """Shadow Dexterous Hand: two joints of a wrist, and axes that meet in links without mass."""
    urdf = Urdf("shadow_hand_right", folder, effort=2.0, velocity=2.0)
    urdf.lines.append('<link name="world"/>')
    urdf.joint("forearm_fixed", "fixed", "world", "forearm", (0.307, 0, 0), (0, -math.pi / 2, 0))
    urdf.link("forearm", '<cylinder radius="0.05" length="0.2"/>', (-0.05, 0, 0.1))
    wrist = [
        Bone("rh_WRJ2", (-0.524, 0.175), 0.034, "1 0 0"),
        Bone("rh_WRJ1", (-0.698, 0.489)),
    ]
    urdf.finger("forearm", (-0.02, 0, 0.213), ALONG, 0.012, wrist, "rh_wrist_end")
    urdf.link("rh_palm", '<box size="0.022 0.085 0.09"/>', (-0.011, 0, 0.045))
    urdf.joint("rh_palm_fixed", "fixed", "rh_wrist_end", "rh_palm", (0.02, 0, 0))
    tips = []
    for name, y, z in (("FF", 0.033, 0.095), ("MF", 0.011, 0.099), ("RF", -0.011, 0.095)):
        bones = shadow_bones(name)
        tips.append(urdf.finger("rh_palm", (0, y, z), ALONG, 0.009, bones, f"{name}tip"))
    little = [Bone("rh_LFJ5", (0.0, 0.785), 0.066, "0.573576 0 0.819152"), *shadow_bones("LF")]
    tips.append(urdf.finger("rh_palm", (0, -0.033, 0.0207), ALONG, 0.009, little, "LFtip"))
    thumb = [
        Bone("rh_THJ5", (-1.047, 1.047), axis="0 0 1"),
        Bone("rh_THJ4", (0.0, 1.222), 0.038),
        Bone("rh_THJ3", (-0.209, 0.209), axis="0 1 0"),
        Bone("rh_THJ2", (-0.698, 0.698), 0.032, "1 0 0"),
        Bone("rh_THJ1", (-0.262, 1.571), 0.035),
    ]
    tips.append(urdf.finger("rh_palm", (0.01, 0, 0.0), FROM_BELOW, 0.01, thumb, "thtip"))
    fingers = ("FF", "MF", "RF", "LF")
    closing = [f"rh_{name}J{k}" for name in fingers for k in (1, 2, 3)] + ["rh_THJ4", "rh_THJ1"]
    straight = ["WRJ1", "WRJ2", "THJ5", "THJ3", "THJ2", "THJ1"]
    straight += [f"{name}J{k}" for name in fingers for k in (3, 4)]
    opened = {f"rh_{name}": 0.0 for name in straight}
    return PublicHand(urdf.write(), said(tips, closing, 0.5, open_angles=opened), 24, 24)


def shadow_bones(name: str) -> list[Bone]:
    """A finger's: abduction and flexion of the knuckle meet in one point."""
    return [
        Bone(f"rh_{name}J4", (-0.349, 0.349), axis="1 0 0"),
        Bone(f"rh_{name}J3", (-0.262, 1.571), 0.045),
        Bone(f"rh_{name}J2", (0.0, 1.571), 0.025),
        Bone(f"rh_{name}J1", (0.0, 1.571), 0.026),
    ]


def robotiq(folder: Path) -> PublicHand:
    """Robotiq three-finger gripper: its smallest links have moments of no rigid body."""
    urdf = Urdf("robotiq_3f", folder, effort=60, velocity=2.0, moments=(1e-5, 4e-5, 1e-4))
    urdf.palm("palm", (0.09, 0.16, 0.12), 0.06)
    lengths = (0.057, 0.038, 0.0254)
    limits = ((0.0, 1.2218), (0.0, 1.5708), (-0.6632, 1.0471))
    tips, closing = [], []
    for name, xyz, rpy, scissor in (
        ("finger_1", (0, 0.036, -0.015), FROM_ABOVE, (-0.16, 0.25)),
        ("finger_2", (0, -0.036, -0.015), FROM_ABOVE, (-0.25, 0.16)),
        ("finger_middle", (0, 0, -0.105), FROM_BELOW, None),
    ):
        bones = [Bone(f"{name}_joint_{k + 1}", limits[k], lengths[k]) for k in range(3)]
        closing += [bone.joint for bone in bones]
        if scissor is not None:
            bones.insert(0, Bone(f"palm_{name}_joint", scissor, axis="1 0 0"))
        tips.append(urdf.finger("palm", xyz, rpy, 0.011, bones, f"{name}_tip"))
    opened = {"palm_finger_1_joint": 0.0, "palm_finger_2_joint": 0.0}
    return PublicHand(urdf.write(), said(tips, closing, 1.0, open_angles=opened), 11, 11, True)


def svh(folder: Path) -> PublicHand:
    """Schunk SVH: nine motors move twenty joints."""
    urdf = Urdf("svh_right", folder, effort=3.0, velocity=3.0)
    urdf.palm("base", (0.03, 0.09, 0.1), 0.02)
    spread, radius = "Finger_Spread", 0.009
    tips = []
    for name, y, mimic in (("index", 0.036, (spread, 0.5, 0.0)), ("middle", 0.012, None)):
        proximal, distal = f"{name}_Proximal", f"{name}_Distal"
        bones = [
            Bone(f"{name}_spread" if mimic else spread, (0.0, 0.5829), 0.0, "1 0 0", mimic),
            Bone(proximal, (0.0, 0.79849), 0.048),
            Bone(distal, (0.0, 1.334), 0.026),
            Bone(f"{name}_tip_joint", (0.0, 1.394), 0.022, mimic=(distal, 1.045, 0.0)),
        ]
        tips.append(urdf.finger("base", (0, y, 0), ALONG, radius, bones, f"{name}_tip"))
    for name, y, third in (("ring", -0.012, 1.42093), ("pinky", -0.036, 1.42307)):
        bones = [
            Bone(name, (0.0, 0.98175), 0.046),
            Bone(f"{name}_2", (0.0, 1.334), 0.026, mimic=(name, 1.3588, 0.0)),
            Bone(f"{name}_3", (0.0, 1.3955), 0.022, mimic=(name, third, 0.0)),
        ]
        if name == "ring":
            bones.insert(0, Bone("ring_spread", (0.0, 0.5829), 0.0, "-1 0 0", (spread, 0.5, 0.0)))
        tips.append(urdf.finger("base", (0, y, 0), ALONG, radius, bones, f"{name}_tip"))
    flexion = "Thumb_Flexion"
    bones = [
        Bone("Thumb_Opposition", (0.0, 0.9879), 0.0, "0 0 1"),
        Bone(flexion, (0.0, 0.9704), 0.045),
        Bone("thumb_2", (0.0, 0.98506), 0.035, mimic=(flexion, 1.01511, 0.0)),
        Bone("thumb_3", (0.0, 1.406), 0.025, mimic=(flexion, 1.44889, 0.0)),
    ]
    tips.append(urdf.finger("base", (0.01, 0, -0.09), FROM_BELOW, radius, bones, "thumb_tip"))
    # the palm folds as the thumb opposes
    fold = [Bone("j5", (0.0, 0.9879), 0.02, "0 0 1", ("Thumb_Opposition", 1.0, 0.0))]
    urdf.finger("base", (-0.03, 0, -0.1), ALONG, radius, fold, "fold_end")
    closing = [f"{n}_{part}" for n in ("index", "middle") for part in ("Proximal", "Distal")]
    more = {"spread_joints": [spread], "spread_range": (0.0, 0.3)}
    return PublicHand(
        urdf.write(), said(tips, [*closing, "ring", "pinky", flexion], 1.0, **more), 20, 9
    )


def ability(folder: Path) -> PublicHand:
    """PSYONIC Ability Hand: outer joints with an offset, a thumb that closes downwards."""
    urdf = Urdf("ability_hand_right", folder, effort=3.0, velocity=8.0)
    urdf.palm("base", (0.025, 0.08, 0.1), 0.02)
    tips = []
    for name, y in (("index", 0.033), ("middle", 0.011), ("ring", -0.011), ("pinky", -0.033)):
        outer = (f"{name}_q1", 1.05851325, 0.72349539)
        bones = [
            Bone(f"{name}_q1", (0.0, 2.0943951), 0.0385),
            Bone(f"{name}_q2", (0.0, 2.9403), 0.04, mimic=outer),
        ]
        tips.append(urdf.finger("base", (0, y, 0), ALONG, 0.008, bones, f"{name}_anchor"))
    bones = [
        Bone("thumb_q1", (-2.0943951, 0.0), 0.03, "1 0 0"),
        Bone("thumb_q2", (-2.0943951, 0.0), 0.065, "0 -1 0"),
    ]
    tips.append(urdf.finger("base", (0.01, 0, -0.08), FROM_BELOW, 0.008, bones, "thumb_anchor"))
    closing = [f"{name}_q1" for name in ("index", "middle", "ring", "pinky")]
    opened = {"thumb_q1": 0.0, "thumb_q2": 0.0}
    return PublicHand(
        urdf.write(), said(tips, [*closing, "thumb_q2"], 1.0, open_angles=opened), 10, 6
    )


def inspire(folder: Path) -> PublicHand:
    """Inspire RH56: the end of the thumb follows its middle, which follows its root."""
    urdf = Urdf("inspire_hand_right", folder, effort=1.0, velocity=0.5)
    urdf.palm("hand_base_link", (0.03, 0.08, 0.1), 0.02)
    tips = []
    for name, y in (("index", 0.033), ("middle", 0.011), ("ring", -0.011), ("pinky", -0.033)):
        root = f"{name}_proximal_joint"
        bones = [
            Bone(root, (0.0, 1.7), 0.035),
            Bone(f"{name}_intermediate_joint", (0.0, 1.7), 0.045, mimic=(root, 1.0, 0.0)),
        ]
        tips.append(urdf.finger("hand_base_link", (0, y, 0), ALONG, 0.008, bones, f"{name}_tip"))
    root, middle = "thumb_proximal_pitch_joint", "thumb_intermediate_joint"
    bones = [
        Bone("thumb_proximal_yaw_joint", (-0.1, 1.3), 0.0, "0 0 1"),
        Bone(root, (-0.1, 0.6), 0.045),
        Bone(middle, (-0.16, 0.96), 0.03, mimic=(root, 1.6, 0.0)),
        Bone("thumb_distal_joint", (-0.24, 1.44), 0.03, mimic=(middle, 1.5, 0.0)),
    ]
    place = (0.01, 0, -0.08)
    tips.append(urdf.finger("hand_base_link", place, FROM_BELOW, 0.008, bones, "thumb_tip"))
    closing = [f"{name}_proximal_joint" for name in ("index", "middle", "ring", "pinky")]
    more = {"open_angles": {"thumb_proximal_yaw_joint": 0.0, root: 0.0}}
    return PublicHand(urdf.write(), said(tips, [*closing, root], 0.8, **more), 12, 6)


def panda(folder: Path) -> PublicHand:
    """Franka's gripper: two slides that open upwards, one follows the other; no inertia at all."""
    urdf = Urdf("panda_gripper", folder, effort=20, velocity=0.2, mass=0.0)
    body, missing = '<box size="0.04 0.2 0.06"/>', '<mesh filename="hand.glb"/>'
    urdf.link("panda_hand", body, (0, 0, 0.03), missing)
    motor = "panda_finger_joint1"
    for joint, link, side, mimic in (
        (motor, "panda_leftfinger", 1, None),
        ("panda_finger_joint2", "panda_rightfinger", -1, (motor, 1.0, 0.0)),
    ):
        urdf.link(link, '<box size="0.02 0.012 0.054"/>', (0, side * 0.006, 0.027))
        rest = urdf.moved(f"0 {side} 0", (0.0, 0.04), mimic)
        urdf.joint(joint, "prismatic", "panda_hand", link, (0, 0, 0.0584), rest=rest)
    more = {"open_angles": {motor: 0.04}, "closing_speed": 0.05, "palm": 0.06}
    tips = ["panda_leftfinger", "panda_rightfinger"]
    return PublicHand(urdf.write(), said(tips, [motor], 20.0, **more), 2, 1, True)


PUBLIC_HANDS: dict[str, Callable[[Path], PublicHand]] = {
    "Allegro": allegro,
    "LEAP": leap,
    "Shadow": shadow,
    "Robotiq 3F": robotiq,
    "SVH": svh,
    "Ability": ability,
    "Inspire": inspire,
    "Panda": panda,
}
