"""Where episodes get their grasps: a table of collected ones, or attempts kept in the user's cache.

The cache is `graspforce/grasps/<digest>` below $XDG_CACHE_HOME or ~/.cache, where the digest tells
of everything that the grasps depend on but the processor. It only saves time: on one machine a
grasp has the same bits whether it was there or is made anew.
"""

import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gfo_env.cache import cache_folder
from gfo_env.exceptions import AcquisitionError
from gfo_env.hand import HandDescription
from gfo_env.objects import ObjectSet

from .acquisition import Grasp, Outcome
from .attempts import CHUNK, Attempts, Chunk, ChunkStore, grasp_of, make_chunk
from .table import GraspTable, GraspTableError

SEED = 0
"""Of the attempts in the cache."""

LEAST_SLOTS = 2048
LEAST_ROUNDS = 2
"""The cache has so many slots, and so many attempts at every object, at least."""

_MAX_DRAWS = 200
_HOPELESS = 200
"""After so many attempts without one grasp there is no use in making more."""


@dataclass(frozen=True, eq=False)
class StoredGrasp:
    """A grasp to begin an episode with.

    Args:
        grasp: of an object at the set's density.
        radius: m, largest distance of the object's surface from its centre of mass.
    """

    grasp: Grasp
    radius: float


class GraspSource:
    """Grasps that episodes begin with: rows of a table, or attempts made when first asked for.

    Attempts are seeded: on one machine slot k of an object set and a hand always holds the same
    grasp, or the same failure; on another processor nearly always. The first use of one makes 25 of
    them, in a simulator that is then closed, and keeps them in the user's cache, which any number
    of processes may fill at once. What is in the cache needs no simulator. A source can be pickled.

    Args:
        objects: to be grasped.
        hand: that grasps.
        fingertips: whether only fingertips touch.
        path: of a table of `scripts/collect.py`; None for the cache.

    Raises:
        GraspTableError: the table cannot be read, or is not of this hand, of these objects, or of
            such contacts.
        MeshError: a mesh of the set is gone.
    """

    def __init__(
        self,
        objects: ObjectSet,
        hand: HandDescription,
        *,
        fingertips: bool = False,
        path: Path | None = None,
    ) -> None:
        self._table: GraspTable | None = None
        self._known: dict[int, StoredGrasp | None] = {}
        self.attempts = Attempts(objects, SEED, hand, fingertips)
        self.store = ChunkStore(None, self.attempts)
        self._outcomes: dict[int, tuple[str, ...]] = {}
        self._warned = False
        if path is not None:
            self._table = GraspTable.load(path)
            _check(self._table, path, self.attempts)
            self._length = len(self._table)
        else:
            self.store = ChunkStore(cache_folder("grasps"), self.attempts)
            rounds = max(LEAST_ROUNDS, -(-LEAST_SLOTS // len(objects)))
            self._length = rounds * len(objects)

    def __len__(self) -> int:
        """Slots; of those of the cache, some are attempts that failed."""
        return self._length

    def __getstate__(self) -> dict[str, Any]:
        # what has been read or made is read or made again where it is needed
        return self.__dict__ | {"_known": {}, "_outcomes": {}}

    def grasp(self, number: int) -> StoredGrasp | None:
        """The grasp in a slot, or None if that attempt failed.

        Raises:
            IndexError: there is no such slot.
            MeshError: a mesh of the set cannot become a rigid body.
        """
        try:
            return self._known[number]
        except KeyError:
            pass
        if not 0 <= number < len(self):
            raise IndexError(f"there is no grasp {number}: the source has {len(self)} slots")
        if self._table is not None:
            self._known[number] = _stored(self._table, number)
        else:
            self._load(number // CHUNK)
        return self._known[number]

    def draw(
        self,
        rng: np.random.Generator,
        accept: Callable[[StoredGrasp], bool] = lambda stored: True,
    ) -> tuple[int, StoredGrasp]:
        """A slot, uniform among those that hold a grasp that is accepted, and its grasp.

        Args:
            rng: source of the choice.
            accept: whether a grasp will do.

        Raises:
            AcquisitionError: 200 draws held nothing acceptable, or 200 attempts not one grasp.
        """
        counts: Counter[str] = Counter()
        tried: Counter[str] = Counter()
        chunks: set[int] = set()
        for _ in range(_MAX_DRAWS):
            number = int(rng.integers(len(self)))
            stored = self.grasp(number)
            if stored is not None and accept(stored):
                return number, stored
            if stored is not None:
                counts["a grasp that the settings rule out"] += 1
                continue
            chunk, place = divmod(number, CHUNK)
            counts[self._outcomes[chunk][place]] += 1
            if chunk not in chunks:
                chunks.add(chunk)
                tried.update(self._outcomes[chunk])
            # whole chunks are known anyway: enough to tell without making many more
            if tried.total() >= _HOPELESS and not tried[Outcome.GRASP]:
                raise AcquisitionError(self._failure(tried))
        raise AcquisitionError(self._failure(counts))

    def _failure(self, counts: Counter[str]) -> str:
        reasons = ", ".join(f"{count} x {reason}" for reason, count in counts.most_common())
        return (
            f"None of {counts.total()} attempts to grasp objects of {self.attempts.objects.name} "
            f"succeeded ({reasons}): use objects 3 to 15 cm across, thicker than 1 cm, and "
            f"max_contacts=8. {self.attempts.objects.advice_on_size()}".rstrip()
        )

    def _load(self, number: int) -> None:
        """Take a chunk from the cache, or make it and leave it there."""
        chunk = self.store.read(number)
        if chunk is None:
            chunk = make_chunk(self.attempts, number)
            self._keep(chunk)
        first = number * CHUNK
        self._outcomes[number] = chunk.outcomes
        slots: dict[int, StoredGrasp | None] = dict.fromkeys(range(first, first + CHUNK))
        for row, attempt in enumerate(chunk.table.attempt.tolist()):
            slots[attempt] = _stored(chunk.table, row)
        # the last chunk may reach beyond the last slot
        self._known |= {slot: slots[slot] for slot in slots if slot < len(self)}

    def _keep(self, chunk: Chunk) -> None:
        try:
            self.store.write(chunk)
        except OSError as error:
            if not self._warned:
                self._warned = True
                warnings.warn(
                    f"Grasps cannot be kept in {self.store.folder} ({error}), so every "
                    "process makes its own, which takes time: set XDG_CACHE_HOME to a folder that "
                    "can be written.",
                    stacklevel=2,
                )


def _stored(table: GraspTable, row: int) -> StoredGrasp:
    return StoredGrasp(grasp_of(table, row), float(table.object_radius[row]))


def _check(table: GraspTable, path: Path, attempts: Attempts) -> None:
    """Raise unless a table holds grasps of these objects by this hand in this way."""
    objects, hand = attempts.objects, attempts.hand
    if table.hand != hand.name or not np.array_equal(table.max_torque, hand.max_torque):
        raise GraspTableError(
            f"the grasps in {path} are by the hand {table.hand!r}, of {len(table.max_torque)} "
            f"joints and other torque limits perhaps, not by {hand.name!r}; collect them anew"
        )
    if table.joint_angles.shape[1:] != (len(hand.joint_names),):
        raise GraspTableError(
            f"the grasps in {path} are of another number of joints than the "
            f"{len(hand.joint_names)} of {hand.name!r}; collect them anew"
        )
    if table.fingertips != attempts.fingertips:
        kinds = {True: "fingertips", False: "hand"}
        raise GraspTableError(
            f"the grasps in {path} were collected with --contacts {kinds[table.fingertips]}; "
            f"collect them with --contacts {kinds[attempts.fingertips]}, or ask for theirs"
        )
    if table.target_size != objects.target_size:
        raise GraspTableError(
            f"the grasps in {path} are of objects with target_size={table.target_size}, "
            f"not {objects.target_size}"
        )
    if table.scale != objects.scale:
        raise GraspTableError(
            f"the grasps in {path} are of objects with scale={table.scale}, not {objects.scale}"
        )
    strangers = sorted(set(table.object_id.tolist()) - set(objects.object_ids))
    if strangers:
        raise GraspTableError(
            f"{path} has grasps of {table.object_set} (split {table.split!r}) with "
            f"{len(strangers)} objects that are not in {objects!r}, {strangers[0]!r} for one; "
            "name the object set and split that they were collected from"
        )
