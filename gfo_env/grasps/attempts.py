"""Seeded attempts to grasp, numbered from 0 on, made 25 at a time and kept on disk.

Attempt k has its own random generator, made from the seed and k, so grasps do not depend on which
process makes them, in which order, nor on what was kept from before.
"""

import hashlib
import platform
import time
from contextlib import closing
from dataclasses import dataclass, field, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from gfo_env.contacts import Contacts
from gfo_env.digests import digest
from gfo_env.hand import BARRETT_BH8_280, HandDescription
from gfo_env.objects import GraspObject, ObjectSet
from gfo_env.pose import Pose
from gfo_env.simulation import Simulation
from solvers.files import write_atomically

from .acquisition import FINGERTIPS, MAX_CONTACTS, WHOLE_HAND, Grasp, Outcome, attempt
from .table import COLUMN_KINDS, GraspTable, GraspTableError, column_shapes

CHUNK = 25
"""Attempts that are made with one simulator."""

_LIBRARIES = ("coacd", "manifold3d", "numba", "numpy", "pybullet", "scipy", "trimesh")

# of the files as they are when they are imported, not later: they may be edited under a long run
_CODE = digest("contacts", "grasps", "hand", "objects", "pose", "simulation")


@dataclass(frozen=True)
class Attempts:
    """An endless numbered row of attempts; it determines their grasps to the last bit.

    Args:
        objects: where the objects come from.
        seed: of all random choices.
        hand: that grasps.
        fingertips: whether only fingertips may touch.
    """

    objects: ObjectSet
    seed: int
    hand: HandDescription = BARRETT_BH8_280
    fingertips: bool = False
    _order: dict[int, list[str]] = field(default_factory=dict, compare=False, repr=False)

    def object_id(self, number: int) -> str:
        """The object of an attempt: every object once a round, in a new random order each round."""
        ids = self.objects.object_ids
        turn, place = divmod(number, len(ids))
        if turn not in self._order:
            order = np.random.default_rng([self.seed, turn, 1]).permutation(len(ids))
            self._order[turn] = [ids[i] for i in order]
        return self._order[turn][place]

    def digest(self) -> str:
        """Hex digest of everything that the grasps depend on: settings, files, code, versions."""
        hand = replace(self.hand, urdf=Path(self.hand.urdf.name))
        versions = {name: _version(name) for name in _LIBRARIES}
        key = [
            self.objects.name,
            self.objects.fingerprint(),
            self.seed,
            self.fingertips,
            hand,
            [hashlib.sha256(file.read_bytes()).hexdigest() for file in _files(self.hand.urdf)],
            _CODE,
            versions,
            platform.machine(),
        ]
        return hashlib.sha256(repr(key).encode()).hexdigest()[:24]


def _files(urdf: Path) -> list[Path]:
    """A URDF and the meshes that it names, wherever PyBullet may look for them."""
    named = [
        mesh.get("filename", "").split("://")[-1] for mesh in ElementTree.parse(urdf).iter("mesh")
    ]
    folders = urdf.resolve().parents[:5]
    places = dict.fromkeys(folder / name for name in named if name for folder in folders)
    return [urdf, *(place for place in places if place.is_file())]


def _version(library: str) -> str | None:
    try:
        return version(library)
    except PackageNotFoundError:
        return None


@dataclass(frozen=True, eq=False)
class Chunk:
    """`CHUNK` successive attempts.

    Args:
        number: of the chunk; its first attempt is number `CHUNK` times that.
        table: grasps, none perhaps; the column `attempt` says which attempts they are.
        outcomes: of each attempt, values of `Outcome`.
        milliseconds: that each attempt took, loading the object excluded; empty when the chunk
            comes from disk.
    """

    number: int
    table: GraspTable
    outcomes: tuple[str, ...]
    milliseconds: tuple[float, ...] = ()


def make_chunk(attempts: Attempts, number: int) -> Chunk:
    """Make the attempts of a chunk, in a simulator that is closed afterwards."""
    style = FINGERTIPS if attempts.fingertips else WHOLE_HAND
    rows: list[dict[str, np.ndarray]] = []
    outcomes, milliseconds = [], []
    with closing(Simulation(attempts.hand)) as simulation:
        for k in range(number * CHUNK, (number + 1) * CHUNK):
            grasp_object = attempts.objects[attempts.object_id(k)]
            rng = np.random.default_rng([attempts.seed, k])
            begin = time.perf_counter()
            result = attempt(grasp_object, simulation, rng, style=style)
            milliseconds.append(1e3 * (time.perf_counter() - begin))
            outcomes.append(result.outcome.value)
            if result.grasp is not None:
                rows.append(_row(result.grasp, grasp_object, k))
    return Chunk(number, _table(attempts, rows), tuple(outcomes), tuple(milliseconds))


class ChunkStore:
    """Finished chunks in a folder, or nowhere.

    Any number of processes may use a folder at once. Chunks of other attempts have another folder,
    so they never mix.

    Args:
        root: in which the folder of these attempts lies, or None: nothing is kept.
        attempts: whose chunks they are.

    Attributes:
        folder: of these attempts; it exists once something is written.
    """

    def __init__(self, root: Path | None, attempts: Attempts) -> None:
        self._attempts = attempts
        self.folder = None if root is None else root / attempts.digest()

    def read(self, number: int) -> Chunk | None:
        """A chunk, or None if there is none or it is damaged."""
        if self.folder is None:
            return None
        try:
            table, extra = GraspTable.read(self._path(number), extra=("outcomes",))
        except GraspTableError:
            return None  # missing, or damaged, say by a full disk: made anew
        outcomes = tuple(extra["outcomes"].tolist())
        places = table.attempt - number * CHUNK
        grasped = [place for place, outcome in enumerate(outcomes) if outcome == Outcome.GRASP]
        if len(outcomes) != CHUNK or places.tolist() != grasped:
            return None
        return Chunk(number, table, outcomes)

    def write(self, chunk: Chunk) -> None:
        """Keep a chunk; the same chunk gives the same bytes.

        Nothing is kept of meshes that have been edited since the store was made.

        Raises:
            UnwritableFileError: the folder cannot be written.
        """
        if self.folder is not None and self.folder.name == self._attempts.digest():
            outcomes = np.array(chunk.outcomes)
            write_atomically(
                self._path(chunk.number),
                lambda stream: chunk.table.write(stream, outcomes=outcomes),
            )

    def _path(self, number: int) -> Path:
        assert self.folder is not None
        return self.folder / f"{number:06d}.npz"


def grasp_of(table: GraspTable, index: int) -> Grasp:
    """Row `index` of a table as a grasp, padding dropped."""
    mask = table.contact_mask[index]
    rows = np.repeat(mask, 3)
    return Grasp(
        object_id=str(table.object_id[index]),
        pose=Pose(table.object_position[index], table.object_rotation[index]),
        joint_angles=table.joint_angles[index],
        contacts=Contacts(
            positions=table.positions[index, mask],
            frames=table.frames[index, mask],
            links=table.links[index, mask],
            normal_forces=table.normal_forces[index, mask],
            jacobian=table.hand_jacobian[index, rows],
        ),
        gravity_map=table.gravity_map[index],
    )


def _row(grasp: Grasp, grasp_object: GraspObject, number: int) -> dict[str, np.ndarray]:
    contacts = grasp.contacts
    extra = MAX_CONTACTS - len(contacts)

    def padded(array: np.ndarray, axis: int = 0, times: int = 1) -> np.ndarray:
        width = [(0, 0)] * array.ndim
        width[axis] = (0, times * extra)
        return np.pad(array, width)

    return {
        "object_id": np.array(grasp.object_id),
        "attempt": np.array(number),
        "object_radius": np.array(grasp_object.radius),
        "object_mass": np.array(grasp_object.mass),
        "object_position": grasp.pose.position,
        "object_rotation": grasp.pose.rotation,
        "joint_angles": grasp.joint_angles,
        "positions": padded(contacts.positions),
        "frames": padded(contacts.frames),
        "links": padded(contacts.links),
        "normal_forces": padded(contacts.normal_forces),
        "contact_mask": np.arange(MAX_CONTACTS) < len(contacts),
        "grasp_map": padded(contacts.grasp_map, axis=1, times=3),
        "hand_jacobian": padded(contacts.jacobian, times=3),
        "gravity_map": grasp.gravity_map,
    }


def _table(attempts: Attempts, rows: list[dict[str, np.ndarray]]) -> GraspTable:
    columns: dict[str, Any] = {
        name: np.array([row[name] for row in rows], dtype=COLUMN_KINDS[name]).reshape(
            (len(rows), *shape)
        )
        for name, shape in column_shapes(MAX_CONTACTS, len(attempts.hand.joint_names)).items()
    }
    objects = attempts.objects
    return GraspTable(
        object_set=objects.name,
        split=objects.split,
        target_size=objects.target_size,
        scale=objects.scale,
        seed=attempts.seed,
        hand=attempts.hand.name,
        fingertips=attempts.fingertips,
        max_torque=np.array(attempts.hand.max_torque),
        **columns,
    )
