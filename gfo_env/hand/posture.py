"""Where the hand's links are: point Jacobians and what carries the links' own weight.

From the frames that the engine reports in one call, instead of one call for each contact and axis.
"""

from dataclasses import dataclass
from functools import cached_property
from types import ModuleType

import numpy as np
from numba import njit
from numpy.typing import NDArray

from solvers.arrays import Array, Indices


@dataclass(frozen=True, eq=False)
class Tree:
    """What a posture does not change: the engine's links and joints, all of them, fixed ones too.

    The engine's link i is moved by its joint i; -1 is the base. The hand counts moving joints only,
    and a link that is fixed to another as part of it.

    Args:
        parents: (links,) index of each link's parent.
        columns: (links,) column of the hand Jacobian for each joint, -1 for fixed joints.
        slides: (links,) whether the joint is prismatic.
        axes: (links, 3) joint axes in the frames of their links.
        masses: (links,) kg.
        joints: (n_tau,) the engine's number of the joint of each column of the hand Jacobian.
        bodies: (links + 1,) number of the hand's link that each link is part of; the last entry is
            that of the base, -1.
    """

    parents: Indices
    columns: Indices
    slides: NDArray[np.bool_]
    axes: Array
    masses: Array
    joints: Indices
    bodies: Indices

    @cached_property
    def numbers(self) -> Indices:
        """(n_tau + 1,) the engine's number of each of the hand's links; the last is the base's."""
        return np.append(self.joints, -1)


def read_tree(bullet: ModuleType, client: int, hand: int, joint_names: tuple[str, ...]) -> Tree:
    """The tree of a loaded hand.

    Args:
        bullet: the pybullet module.
        client: physicsClientId.
        hand: bodyUniqueId.
        joint_names: of the columns of the hand Jacobian.
    """
    numbers = range(bullet.getNumJoints(hand, physicsClientId=client))
    joints = [bullet.getJointInfo(hand, i, physicsClientId=client) for i in numbers]
    dynamics = [bullet.getDynamicsInfo(hand, i, physicsClientId=client) for i in numbers]
    names = [joint[1].decode() for joint in joints]
    known = {name: column for column, name in enumerate(joint_names)}
    columns = np.array([known.get(name, -1) for name in names], dtype=np.int64)
    parents = np.array([joint[16] for joint in joints], dtype=np.int64)
    bodies = np.append(columns, -1)
    for link in numbers:
        if bodies[link] < 0:
            bodies[link] = bodies[parents[link]]
    return Tree(
        parents=parents,
        columns=columns,
        slides=np.array([joint[2] == bullet.JOINT_PRISMATIC for joint in joints]),
        # the engine has them in the frames of the links' inertia
        axes=np.array(
            [
                bullet.rotateVector(entry[4], joint[13])
                for entry, joint in zip(dynamics, joints, strict=True)
            ]
        ),
        masses=np.array([entry[0] for entry in dynamics]),
        joints=np.array([names.index(name) for name in joint_names], dtype=np.int64),
        bodies=bodies,
    )


@dataclass(frozen=True, eq=False)
class Posture:
    """The hand's links as they are now, hand frame.

    Args:
        tree: of the hand.
        origins: (links, 3) m, of the links' frames, which their joints' axes pass through.
        orientations: (links, 4) of the links' frames: x, y, z, w.
        centres: (links, 3) m, centres of mass.
    """

    tree: Tree
    origins: Array
    orientations: Array
    centres: Array

    def jacobians(self, points: Array, links: Indices) -> Array:
        """(k, 3, n_tau) m: velocity per joint speed of points (k, 3) that move with their links.

        Links are numbered as the hand's. A point of the base, link -1, is moved by no joint. For a
        prismatic joint it is 1.
        """
        tree = self.tree
        return point_jacobians(
            points, tree.numbers[links], self.origins, self.orientations,
            tree.parents, tree.columns, tree.slides, tree.axes, len(tree.joints),
        )  # fmt: skip

    def gravity_map(self) -> Array:
        """(n_tau, 3): joint torques that carry the links at rest, per gravity vector.

        Times gravity (m/s2, hand frame) this gives N·m, or N for a prismatic joint.
        """
        tree = self.tree
        return gravity_map_of(
            self.centres, tree.masses, self.origins, self.orientations,
            tree.parents, tree.columns, tree.slides, tree.axes, len(tree.joints),
        )  # fmt: skip


@njit(cache=True)
def point_jacobians(
    points: Array,
    links: Indices,
    origins: Array,
    orientations: Array,
    parents: Indices,
    columns: Indices,
    slides: NDArray[np.bool_],
    axes: Array,
    n_tau: int,
) -> Array:
    """`Posture.jacobians` for compiled code, with the engine's numbers of links."""
    count = len(origins)
    turned = np.empty((count, 3))
    for link in range(count):
        x, y, z, w = orientations[link]
        a, b, c = axes[link]
        # v + 2 w (q x v) + 2 q x (q x v)
        s, t, u = y * c - z * b, z * a - x * c, x * b - y * a
        turned[link, 0] = a + 2.0 * (w * s + y * u - z * t)
        turned[link, 1] = b + 2.0 * (w * t + z * s - x * u)
        turned[link, 2] = c + 2.0 * (w * u + x * t - y * s)
    result = np.zeros((len(points), 3, n_tau))
    for k in range(len(points)):
        joint = links[k]
        while joint >= 0:
            column = columns[joint]
            if column >= 0:
                a, b, c = turned[joint]
                if slides[joint]:
                    result[k, 0, column], result[k, 1, column], result[k, 2, column] = a, b, c
                else:
                    x = points[k, 0] - origins[joint, 0]
                    y = points[k, 1] - origins[joint, 1]
                    z = points[k, 2] - origins[joint, 2]
                    result[k, 0, column] = b * z - c * y
                    result[k, 1, column] = c * x - a * z
                    result[k, 2, column] = a * y - b * x
            joint = parents[joint]
    return result


@njit(cache=True)
def gravity_map_of(
    centres: Array,
    masses: Array,
    origins: Array,
    orientations: Array,
    parents: Indices,
    columns: Indices,
    slides: NDArray[np.bool_],
    axes: Array,
    n_tau: int,
) -> Array:
    """`Posture.gravity_map` for compiled code."""
    every = np.arange(len(masses))
    motion = point_jacobians(
        centres, every, origins, orientations, parents, columns, slides, axes, n_tau
    )
    # the weight of a link does work m g·v, which the joints must supply: tau = -sum m J' g
    carried = np.zeros((n_tau, 3))
    for link in range(len(masses)):
        for axis in range(3):
            for column in range(n_tau):
                carried[column, axis] -= masses[link] * motion[link, axis, column]
    return carried
