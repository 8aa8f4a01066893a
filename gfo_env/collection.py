"""Collecting grasps: many seeded attempts over an object set, in parallel, resumable after a kill.

Attempt k has its own random generator, made from the seed and k, and its own place in the result,
so the grasps do not depend on the number of workers nor on interruptions.
"""

import hashlib
import json
import math
import shutil
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Parallel, delayed, parallel_config
from rich.progress import Progress

from solvers import GraspForceError

from .acquisition import MAX_CONTACTS, Grasp, Outcome, attempt
from .contacts import Contacts
from .grasps import COLUMNS, GraspTable, GraspTableError
from .hand import BARRETT_BH8_280
from .objects import GraspObject, ObjectSet
from .pose import Pose
from .simulation import Simulation

CHUNK = 25
"""Attempts that a worker makes with one simulator before it reports."""

_CHUNKS_AT_ONCE = 20

_LEAST_YIELD = 0.05
_LEAST_ATTEMPTS = 200
"""A set whose yield is less after so many attempts is not collected from any further."""


class CollectionError(GraspForceError, ValueError):
    """What is to be collected, or how, makes no sense."""


@dataclass(frozen=True, eq=False)
class CollectionReport:
    """How a collection went.

    Args:
        grasps: collected.
        attempts: made for them.
        outcomes: attempts by outcome, the values of `gfo_env.acquisition.Outcome`.
        objects_tried: distinct objects among the attempts.
        objects_grasped: of these, with one grasp at least.
        attempt_ms: (attempts,) time of each attempt on its worker, loading the object excluded.
        seconds: wall time of the whole collection.
    """

    grasps: int
    attempts: int
    outcomes: dict[str, int]
    objects_tried: int
    objects_grasped: int
    attempt_ms: np.ndarray
    seconds: float

    def summary(self) -> dict[str, float | int | dict[str, int]]:
        """The figures of the report, as JSON has them."""
        return {
            "grasps": self.grasps,
            "attempts": self.attempts,
            "yield": self.outcomes.get(Outcome.GRASP.value, 0) / self.attempts,
            "outcomes": self.outcomes,
            "objects_tried": self.objects_tried,
            "objects_grasped": self.objects_grasped,
            "object_yield": self.objects_grasped / self.objects_tried,
            "attempt_ms_median": float(np.median(self.attempt_ms)),
            "attempt_ms_p95": float(np.percentile(self.attempt_ms, 95)),
            "ms_per_grasp_one_core": float(self.attempt_ms.sum() / max(self.grasps, 1)),
            "seconds": self.seconds,
            "grasps_per_second": self.grasps / self.seconds,
        }


@dataclass(frozen=True, eq=False)
class _Chunk:
    """What a worker reports of one chunk of attempts."""

    first: int
    table: GraspTable
    outcomes: list[str]
    object_ids: list[str]
    milliseconds: list[float]


@dataclass(frozen=True)
class CollectionPlan:
    """What to collect; it determines the grasps to the last bit.

    Args:
        objects: where the objects come from.
        grasps: how many.
        seed: of all random choices.

    Raises:
        CollectionError: the number is not positive, or the seed negative.
    """

    objects: ObjectSet
    grasps: int
    seed: int
    _order: dict[int, list[str]] = field(default_factory=dict, compare=False, repr=False)

    def __post_init__(self) -> None:
        if self.grasps < 1:
            raise CollectionError(f"grasps is {self.grasps}; it must be 1 or more")
        if self.seed < 0:
            raise CollectionError(f"seed is {self.seed}; it must be 0 or more")

    def object_id(self, number: int) -> str:
        """The object of an attempt: every object once a round, in a new random order each round."""
        ids = self.objects.object_ids
        turn, place = divmod(number, len(ids))
        if turn not in self._order:
            order = np.random.default_rng([self.seed, turn, 1]).permutation(len(ids))
            self._order[turn] = [ids[i] for i in order]
        return self._order[turn][place]


def collect(
    plan: CollectionPlan,
    *,
    workers: int = 1,
    output: Path | None = None,
    progress: Progress | None = None,
) -> tuple[GraspTable, CollectionReport]:
    """Attempt grasps until the plan's number is reached.

    Args:
        plan: what to collect.
        workers: processes.
        output: where the table goes. Finished chunks are kept beside it, in a folder of its name
            with `.parts` appended, until it is written; an interrupted collection of the same plan
            goes on from there.
        progress: a bar is added to it.

    Raises:
        CollectionError: if there is no worker, or the output is a folder.
        GraspTableError: if the objects yield next to no grasps.
        MeshError: if an object of the set cannot be read.
    """
    if workers < 1:
        raise CollectionError(f"workers is {workers}; it must be 1 or more")
    if output is not None and output.is_dir():
        raise CollectionError(f"{output} is a folder; name a file to write the grasps to")
    started = time.perf_counter()
    store = _ChunkStore(output, plan)
    task = progress.add_task("grasps", total=plan.grasps) if progress else None
    chunks: list[_Chunk] = []
    found = 0
    with (
        parallel_config(backend="loky", inner_max_num_threads=1),
        Parallel(n_jobs=workers, return_as="generator") as pool,
    ):
        while found < plan.grasps:
            wanted = math.ceil((plan.grasps - found) / CHUNK)
            numbers = range(len(chunks), len(chunks) + min(wanted, _CHUNKS_AT_ONCE * workers))
            ready = {number: store.read(number) for number in numbers}
            missing = [number for number in numbers if ready[number] is None]
            made = pool(delayed(_run_chunk)(plan, number * CHUNK) for number in missing)
            for number, chunk in zip(missing, made, strict=True):
                store.write(number, chunk)
                ready[number] = chunk
                if progress is not None and task is not None:
                    progress.advance(task, len(chunk.table))
            fresh = [chunk for number in numbers if (chunk := ready[number]) is not None]
            chunks += fresh
            found += sum(len(chunk.table) for chunk in fresh)
            if progress is not None and task is not None:
                progress.update(task, completed=min(found, plan.grasps))
            attempts = len(chunks) * CHUNK
            if attempts >= _LEAST_ATTEMPTS and found < _LEAST_YIELD * attempts:
                raise GraspTableError(
                    f"only {found} grasps in {attempts} attempts on {plan.objects!r}: are the "
                    "objects of graspable size, 3 to 20 cm? Scale them with a target size"
                )
    table, report = _assemble(plan, chunks, started)
    if output is not None:
        table.save(output)
    store.remove()
    return table, report


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


def _run_chunk(plan: CollectionPlan, first: int) -> _Chunk:
    simulation = Simulation(BARRETT_BH8_280)
    rows: list[dict[str, np.ndarray]] = []
    outcomes, object_ids, milliseconds = [], [], []
    try:
        for number in range(first, first + CHUNK):
            grasp_object = plan.objects[plan.object_id(number)]
            rng = np.random.default_rng([plan.seed, number])
            begin = time.perf_counter()
            result = attempt(grasp_object, simulation, rng)
            milliseconds.append(1e3 * (time.perf_counter() - begin))
            outcomes.append(result.outcome.value)
            object_ids.append(grasp_object.object_id)
            if result.grasp is not None:
                rows.append(_row(result.grasp, grasp_object, number))
    finally:
        simulation.close()
    return _Chunk(first, _table(plan, rows), outcomes, object_ids, milliseconds)


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
        "grasp_map": padded(contacts.grasp_map(), axis=1, times=3),
        "hand_jacobian": padded(contacts.jacobian, times=3),
        "gravity_map": grasp.gravity_map,
    }


def _table(plan: CollectionPlan, rows: list[dict[str, np.ndarray]]) -> GraspTable:
    n_tau = len(BARRETT_BH8_280.joint_names)
    n = MAX_CONTACTS
    shapes = {
        "object_position": (3,),
        "object_rotation": (3, 3),
        "joint_angles": (n_tau,),
        "positions": (n, 3),
        "frames": (n, 3, 3),
        "grasp_map": (6, 3 * n),
        "hand_jacobian": (3 * n, n_tau),
        "gravity_map": (n_tau, 3),
        **dict.fromkeys(("links", "normal_forces", "contact_mask"), (n,)),
    }
    kinds = {
        "object_id": np.str_,
        "contact_mask": np.bool_,
        **dict.fromkeys(("attempt", "links"), np.int64),
    }
    columns: dict[str, Any] = {
        name: np.array([row[name] for row in rows], dtype=kinds.get(name, np.float64)).reshape(
            (len(rows), *shapes.get(name, ()))
        )
        for name in COLUMNS
    }
    return GraspTable(
        object_set=plan.objects.name,
        split=plan.objects.split,
        seed=plan.seed,
        max_torque=np.array(BARRETT_BH8_280.max_torque),
        **columns,
    )


def _assemble(
    plan: CollectionPlan, chunks: list[_Chunk], started: float
) -> tuple[GraspTable, CollectionReport]:
    table = GraspTable.concatenate([chunk.table for chunk in chunks])[: plan.grasps]
    attempts = int(table.attempt[-1]) + 1
    outcomes = [outcome for chunk in chunks for outcome in chunk.outcomes][:attempts]
    object_ids = [object_id for chunk in chunks for object_id in chunk.object_ids][:attempts]
    times = [value for chunk in chunks for value in chunk.milliseconds][:attempts]
    report = CollectionReport(
        grasps=len(table),
        attempts=attempts,
        outcomes=dict(Counter(outcomes).most_common()),
        objects_tried=len(set(object_ids)),
        objects_grasped=len(set(table.object_id.tolist())),
        attempt_ms=np.array(times),
        seconds=time.perf_counter() - started,
    )
    return table, report


class _ChunkStore:
    """Finished chunks on disk beside the output, or nowhere if there is none."""

    def __init__(self, output: Path | None, plan: CollectionPlan) -> None:
        self._folder = None
        if output is None:
            return
        objects = plan.objects
        key = [objects.name, objects.split, objects.target_size, list(objects.object_ids)]
        digest = hashlib.sha256(json.dumps([*key, plan.seed, CHUNK]).encode()).hexdigest()[:16]
        # a plan of other objects or seed has a folder of its own, so parts never mix
        self._folder = Path(f"{output}.parts") / digest
        self._folder.mkdir(parents=True, exist_ok=True)

    def read(self, number: int) -> _Chunk | None:
        if self._folder is None or not self._log(number).exists():
            return None
        try:
            log = json.loads(self._log(number).read_text())
            return _Chunk(table=GraspTable.load(self._grasps(number)), **log)
        except (GraspTableError, ValueError):
            return None  # damaged, say by a full disk: made anew

    def write(self, number: int, chunk: _Chunk) -> None:
        if self._folder is None or not len(chunk.table):
            return
        chunk.table.save(self._grasps(number))
        log = {
            "first": chunk.first,
            "outcomes": chunk.outcomes,
            "object_ids": chunk.object_ids,
            "milliseconds": chunk.milliseconds,
        }
        # the log is written last and moved into place: where it exists, the chunk is complete
        partial = self._log(number).with_suffix(".partial")
        partial.write_text(json.dumps(log))
        partial.replace(self._log(number))

    def remove(self) -> None:
        if self._folder is not None:
            shutil.rmtree(self._folder)
            if not any(self._folder.parent.iterdir()):
                self._folder.parent.rmdir()

    def _log(self, number: int) -> Path:
        assert self._folder is not None
        return self._folder / f"{number:06d}.json"

    def _grasps(self, number: int) -> Path:
        assert self._folder is not None
        return self._folder / f"{number:06d}.npz"
