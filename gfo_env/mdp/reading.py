"""What a control step has led to, out of the engine in one compiled pass.

The numbers are those of `Simulation.contacts` and `posture`, `contacts.merge` and `read_contacts`,
`Posture.gravity_map`, `closure.closes` and `observation.pack` one after the other. Their compiled
code is called here from one function, because to enter it from Python and to return takes longer
than the code itself.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gfo_env.contacts import (
    POINT_NUMBERS,
    Contacts,
    Surface,
    balances,
    contact_arrays,
    contact_geometry,
    grasp_map_of,
    is_projected,
    merge_points,
    number_table,
)
from gfo_env.digests import digest
from gfo_env.grasps.problem import ForceLimits, times_transposed
from gfo_env.hand.posture import gravity_map_of
from gfo_env.pose import Pose, motion_between, turned
from gfo_env.simulation import LINK_NUMBERS, Simulation
from solvers.arrays import Array, Indices, Mask

from .observation import Observation, pack_problem, packed_parts, shapes


class Reading(NamedTuple):
    """How an object is held, and the problem of the coming step.

    Args:
        pose: of the object.
        motion: how far it is from the start, m and rad.
        contacts: strongest first.
        forces: (n, 3) N, what the hand exerts at the contacts, hand frame.
        gravity_map: (n_tau, 3), see `Posture.gravity_map`.
        wrench: (6,) N and N·m, the load in the object frame.
        torque: (n_tau,) N·m that carry the hand's links.
        packed: the fields of the problem, see `Reader.observation`.
        closes: whether an internal force was found, which proves that the contacts close. Where
            none was, `closure.closes` knows.
    """

    pose: Pose
    motion: tuple[float, float]
    contacts: Contacts
    forces: Array
    gravity_map: Array
    wrench: Array
    torque: Array
    packed: NDArray[np.float32]
    closes: bool


class Reader:
    """Reads how one object is held, as long as its simulation is not loaded anew.

    Args:
        simulation: in which hand and object are loaded.
        surface: of the object.
        start: pose that motion is measured from.
        links: numbers of the hand's links whose contacts count; None for all.
        limits: of the problems; of as many contacts as there are at most.
    """

    def __init__(
        self,
        simulation: Simulation,
        surface: Surface,
        start: Pose,
        links: Sequence[int] | None,
        limits: ForceLimits,
    ) -> None:
        self._simulation = simulation
        tree = simulation.posture().tree
        # the last entry is the base, link -1
        counts = np.full(len(tree.joints) + 1, links is None)
        if links is not None:
            counts[list(links)] = True
        layout = shapes(len(limits.contact_mask), len(tree.joints))
        self._parts, length = packed_parts(tuple(layout.items()))
        self._fixed = (
            start.position, start.rotation, surface.triangles, surface.low, surface.high,
            tree.numbers, tree.parents, tree.columns, tree.slides, tree.axes, tree.masses,
            tree.bodies, counts, limits.torque_min, limits.torque_max, limits.normal_min,
            limits.normal_max, limits.contact_mask, length,
        )  # fmt: skip

    def read(self, wrench: Array, gravity: Array, friction: float) -> Reading:
        """What the last step has led to.

        Args:
            wrench: (6,) N and N·m, the load of the coming step, hand frame.
            gravity: (3,) m/s2 in the coming step, hand frame.
            friction: coefficient in the coming step.
        """
        simulation = self._simulation
        pose = simulation.object_pose()
        (
            motion, positions, frames, links, pressing, jacobian, grasp_map, balanceable, forces,
            gravity_map, in_object, torque, packed, closes,
        ) = _look(
            number_table(simulation.link_numbers(), LINK_NUMBERS),
            number_table(simulation.contact_numbers(), POINT_NUMBERS),
            pose.position, pose.rotation, wrench, gravity, friction, *self._fixed,
        )  # fmt: skip
        contacts = Contacts.unchecked(positions, frames, links, pressing, jacobian)
        # its cached properties: they are known already
        vars(contacts).update(grasp_map=grasp_map, balanceable=balanceable)
        return Reading(
            pose, motion, contacts, forces, gravity_map, in_object, torque, packed, closes
        )

    def observation(self, reading: Reading) -> Observation:
        """What `observation.pack` makes of the problem of the coming step."""
        packed = reading.packed
        return {name: packed[part] for name, part in self._parts}


def _entry(sources: str) -> Callable[..., tuple[Any, ...]]:
    @njit(cache=True)
    def look(
        hand: Array, points: Array, position: Array, rotation: Array, wrench: Array, gravity: Array,
        friction: float, start_position: Array, start_rotation: Array, triangles: Array, low: Array,
        high: Array, links: Indices, parents: Indices, columns: Indices, slides: Mask, axes: Array,
        masses: Array, bodies: Indices, counts: Mask, torque_min: Array, torque_max: Array,
        normal_min: Array, normal_max: Array, contact_mask: Any, length: int,
    ) -> tuple[Any, ...]:  # fmt: skip
        sources  # noqa: B018 - see `digests.digest`
        limit, n_tau = len(contact_mask), len(links) - 1
        origins, orientations, centres = hand[:, :3], hand[:, 3:7], hand[:, 7:]
        places, normals, forces, owners = contact_arrays(points, bodies)
        kept = counts[owners]
        places, normals, forces, owners = merge_points(
            places[kept], normals[kept], forces[kept], owners[kept], limit
        )
        positions, frames, pressing, jacobian = contact_geometry(
            places, normals, forces, owners, position, rotation, triangles, low, high,
            origins, orientations, links, parents, columns, slides, axes,
        )  # fmt: skip
        count, grasp_map = len(positions), grasp_map_of(positions, frames)
        balanceable = count >= 2 and balances(grasp_map)
        gravity_map = gravity_map_of(
            centres, masses, origins, orientations, parents, columns, slides, axes, n_tau
        )
        in_object = turned(wrench.reshape(2, 3), rotation).reshape(6)
        torque = times_transposed(gravity.reshape(1, 3), gravity_map).reshape(n_tau)
        packed = np.zeros(length, np.float32)
        pack_problem(
            packed, limit, n_tau, grasp_map, jacobian, np.full(count, friction), torque_min,
            torque_max, torque, in_object, normal_min[:count], normal_max[:count],
            contact_mask[:count],
        )  # fmt: skip
        return (
            motion_between(start_position, start_rotation, position, rotation), positions, frames,
            owners, pressing, jacobian, grasp_map, balanceable, forces, gravity_map, in_object,
            torque, packed, balanceable and is_projected(grasp_map, friction),
        )  # fmt: skip

    return look


_look = _entry(digest("contacts", "grasps", "hand", "mdp", "pose"))
