"""The objects to be grasped: rigid bodies with mass, and the sets that they come from."""

import hashlib
import math
import warnings
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from importlib.metadata import version
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from gfo_env.cache import cache_folder
from gfo_env.checks import is_number
from gfo_env.digests import digest
from gfo_env.exceptions import MeshError, MeshWarning, ObjectSetError
from solvers.exceptions import (
    MissingDependencyError,
    UnreadableFileError,
    UnwritableFileError,
)
from solvers.files import read_json, write_json

from .decomposition import require_coacd
from .meshes import SUPPORTED_SUFFIXES, load_body, needs_decomposition

DENSITY = 2000.0
"""Density of every object, kg/m3: between solid plastics (about 1,200) and glass or aluminium
(about 2,600). It gives nine in ten `random_urdfs` 0.06 to 0.45 kg, as things on a table weigh."""

RANDOM_URDFS = "random_urdfs"

RANDOM_URDFS_SCALE = 0.015
"""Metres per unit of the files. Ref: `scale` of the mesh in each of the thousand URDF files."""

_GRASPABLE = (0.005, 0.5)
"""m: objects whose longest edge is not between these are in another unit, in all likelihood."""

RESCALE = (
    "scale (--scale) says how many metres a unit of the files is, 0.001 for millimetres; "
    "target_size (--target-size) makes all objects equally long."
)
"""What to do about the size of objects."""

_MOST_NAMED = 3
"""Files that a warning names."""

_READING = (digest("objects"), *(version(name) for name in ("manifold3d", "numpy", "trimesh")))
"""What decides whether a file is a solid, beside its content."""

RANDOM_URDFS_SPLITS = ("train", "test", "all")

_THIN = "only {} mm thick: fingers 19 mm thick cannot close on less than 10 mm"

RANDOM_URDFS_EXCLUDED = {
    "167": _THIN.format("8.0"),
    "168": "no vertex is a finite number",
    "178": _THIN.format("7.8"),
    "292": _THIN.format("8.6"),
    "295": _THIN.format("0.3"),
    "297": _THIN.format("0.5"),
    "350": _THIN.format("9.9"),
    "357": _THIN.format("9.5"),
    "507": _THIN.format("8.6"),
    "578": _THIN.format("9.0"),
    "602": _THIN.format("1.3"),
    "824": _THIN.format("0.3"),
}
"""Objects of `random_urdfs` that no split has, and why. Thickness: least distance between a face of
the convex hull and the corner furthest behind it; that of every other object is over 12 mm."""


@dataclass(frozen=True, eq=False)
class GraspObject:
    """A rigid body to be grasped, in its object frame.

    The object frame has its origin at the centre of mass and the axes of the file, in metres.

    Attributes:
        object_id: name of the object in its set.
        solid: watertight mesh: the true surface, and the source of the mass properties.
        parts: convex meshes of few vertices that collide in its stead.
        mass: kg.
        inertia: (3, 3) about the centre of mass along the object frame's axes, kg m2.
    """

    object_id: str
    solid: trimesh.Trimesh
    parts: tuple[trimesh.Trimesh, ...]
    mass: float
    inertia: NDArray[np.float64]

    @property
    def volume(self) -> float:
        """Volume of the solid, m3."""
        return float(self.solid.volume)

    @property
    def radius(self) -> float:
        """Largest distance of a surface point from the centre of mass, m."""
        return float(np.linalg.norm(self.solid.vertices, axis=1).max())

    def with_mass(self, mass: float) -> "GraspObject":
        """The same shape with another mass [kg], still of uniform density.

        Raises:
            MeshError: the mass is not a positive number.
        """
        if not (np.isfinite(mass) and mass > 0):
            raise MeshError(f"Mass must be a positive number of kilograms, not {mass!r}.")
        return replace(self, mass=float(mass), inertia=self.inertia * (mass / self.mass))


class ObjectSet:
    """A named set of objects, or a folder of meshes; objects are loaded when asked for.

    `random_urdfs` are the thousand unions of convex parts that come with PyBullet. Ids that end
    in 0 are the split `test`, the others `train`, as in PyBullet's own
    `kuka_diverse_object_gym_env`; both lack the objects of `RANDOM_URDFS_EXCLUDED`. 58 of them
    are hollow, walls about 1 mm thick, and so weigh 2 to 72 g.

    In a folder, every file below it with a suffix of `meshes.SUPPORTED_SUFFIXES` is an object, or
    those that a pattern chooses, where datasets have several files for an object. Its id is the
    path within the folder, suffix included. A folder has no splits. Every file is examined when the
    set is made, and what is no solid is left out, with a `MeshWarning`; the verdict on a file is
    kept in the user's cache, in `graspforce/solids`.

    Args:
        name_or_path: "random_urdfs" or a folder.
        split: "train", "test" or "all". For a folder "train", the default, means "all".
        object_ids: if given, only these objects of the split.
        target_size: if given, every object is scaled so that the longest edge of the smallest
            box around it (of any orientation) is this long, m.
        scale: of a folder's files, metres per unit: 0.001 for files in millimetres. None for
            files in metres.
        pattern: which files of a folder are objects, as `pathlib.Path.glob` understands it:
            "**/nontextured.ply". None for all.

    Attributes:
        name: "random_urdfs" or the folder, as given.
        split: "train", "test" or "all".
        target_size, scale: as given.
        object_ids: ids of the objects, sorted.
        excluded: id and reason of each object of this split that was left out.

    Raises:
        ObjectSetError: there is no such set, folder, split or object, the folder has no such
            meshes, or the arguments contradict each other.
        MeshError: no file of the folder is a solid, or one of `object_ids` is none.
        MissingDependencyError: a mesh of the folder is concave, and CoACD is not installed.

    Example:
        >>> objects = ObjectSet("random_urdfs", split="test")
        >>> objects["010"].mass > 0
        True
    """

    def __init__(
        self,
        name_or_path: str | Path,
        split: str = "train",
        *,
        object_ids: Collection[str] | None = None,
        target_size: float | None = None,
        scale: float | None = None,
        pattern: str | None = None,
    ) -> None:
        if not isinstance(name_or_path, str | PathLike):
            raise ObjectSetError(
                f"An object set is {RANDOM_URDFS!r} or the path of a folder, not {name_or_path!r}."
            )
        if not isinstance(split, str):
            raise ObjectSetError(f"split must be a name, not {split!r}.")
        if not (pattern is None or isinstance(pattern, str)):
            raise ObjectSetError(f"pattern must be a text such as '**/*.stl', not {pattern!r}.")
        _require_positive("target_size", "length in metres", target_size)
        _require_positive("scale", "number of metres per unit of the files", scale)
        if target_size is not None and scale is not None:
            raise ObjectSetError(
                "Give scale, which keeps the sizes of objects, or target_size, which makes them "
                "all the same, not both."
            )
        self.name = str(name_or_path)
        self.target_size, self.scale = target_size, scale
        self.object_ids: tuple[str, ...]
        self.excluded: dict[str, str]
        if self.name == RANDOM_URDFS:
            if split not in RANDOM_URDFS_SPLITS:
                raise ObjectSetError(
                    f"{RANDOM_URDFS} has no split {split!r}; "
                    f"choose one of {', '.join(RANDOM_URDFS_SPLITS)}."
                )
            if scale is not None or pattern is not None:
                raise ObjectSetError(
                    f"scale and pattern are for folders of meshes, not for {RANDOM_URDFS}."
                )
            self.split = split
            self._folder, self._scale = _random_urdfs_folder(), RANDOM_URDFS_SCALE
            members = [i for i in (f"{n:03d}" for n in range(1000)) if _in_split(i, split)]
            self.object_ids = tuple(i for i in members if i not in RANDOM_URDFS_EXCLUDED)
            self.excluded = {i: why for i, why in RANDOM_URDFS_EXCLUDED.items() if i in members}
        else:
            if split not in ("train", "all"):
                raise ObjectSetError(
                    f"A folder of meshes has no split {split!r}: leave it out, or use 'all'."
                )
            self.split = "all"
            self._folder = Path(name_or_path).expanduser().resolve()
            self._scale = 1.0 if scale is None else float(scale)
            self.object_ids, self.excluded = _meshes_below(self._folder, self.name, pattern), {}
        self._members = frozenset(self.object_ids)
        if object_ids is not None:
            chosen = _ids(object_ids)
            for object_id in chosen:
                self._path(object_id)
            self.object_ids = chosen
            self._members = frozenset(self.object_ids)
        if self.name != RANDOM_URDFS:
            self._leave_out_what_is_no_solid(strict=object_ids is not None)

    def __len__(self) -> int:
        return len(self.object_ids)

    def __iter__(self) -> Iterator[str]:
        return iter(self.object_ids)

    def __contains__(self, object_id: object) -> bool:
        return object_id in self._members

    def __repr__(self) -> str:
        return f"ObjectSet({self.name!r}, split={self.split!r}, objects={len(self)})"

    def __getitem__(self, object_id: str) -> GraspObject:
        """Load an object, or take it from memory.

        Raises:
            ObjectSetError: this set and split have no such object.
            MeshError: its file cannot become a rigid body.
            MissingDependencyError: its mesh is concave, and CoACD is not installed.
        """
        path = self._path(object_id)
        return _load(path, _changed(path), object_id, self._scale, self.target_size)

    def fingerprint(self) -> str:
        """Hex digest of all that makes the objects what they are: ids, sizes, content of files.

        The files of `random_urdfs` are not read: they are part of PyBullet, whose version says
        what they are.

        Raises:
            MeshError: a file is gone since the set was made.
        """
        content = hashlib.sha256(repr((self.target_size, self._scale, DENSITY)).encode())
        for object_id in self.object_ids:
            content.update(f"\0{object_id}\0".encode())
            if self.name != RANDOM_URDFS:
                path = self._path(object_id)
                content.update(_file_digest(path, _changed(path)))
        return content.hexdigest()

    def advice_on_size(self) -> str:
        """What to do if the objects are too large or too small for any hand; else "".

        Raises:
            MeshError: a file has changed since the set was made, and is no solid any more.
        """
        some = self.object_ids[:: max(1, len(self) // 5)]
        lengths = [float(np.max(self[object_id].solid.extents)) for object_id in some]
        if _GRASPABLE[0] <= np.median(lengths) <= _GRASPABLE[1]:
            return ""
        return (
            f"Objects of {self.name} are {min(lengths):.3g} to {max(lengths):.3g} m long, if files "
            f"are in units of {self._scale:g} m. {RESCALE}"
        )

    def _leave_out_what_is_no_solid(self, strict: bool) -> None:
        """Examine the files; raise if none is a solid, or, if strict, one is none."""
        verdicts = {i: _verdict(self._folder / i, _changed(self._folder / i)) for i in self}
        self.excluded = {i: verdict.refusal for i, verdict in verdicts.items() if verdict.refusal}
        self.object_ids = tuple(i for i in self if i not in self.excluded)
        self._members = frozenset(self.object_ids)
        if self.excluded and (strict or not self.object_ids):
            count = len(self.excluded)
            others = f" (and {count - 1} more files are no solids)" if count > 1 else ""
            raise MeshError(next(iter(self.excluded.values())) + others)
        if self.excluded:
            reasons = "; ".join(list(self.excluded.values())[:_MOST_NAMED])
            warnings.warn(
                f"{self.name}: {len(self.excluded)} of {len(verdicts)} files are left out, because "
                f"they are no solids: {reasons}"
                + (" ..." if len(self.excluded) > _MOST_NAMED else ""),
                MeshWarning,
                stacklevel=3,
            )
        if any(verdict.concave for verdict in verdicts.values()):
            require_coacd()

    def _path(self, object_id: str) -> Path:
        if object_id in self.excluded and self.name != RANDOM_URDFS:
            raise MeshError(self.excluded[object_id])
        if object_id in self.excluded:
            raise ObjectSetError(
                f"Object {object_id!r} of {self.name} is excluded: {self.excluded[object_id]}."
            )
        if object_id not in self._members:
            raise ObjectSetError(
                f"{self.name} (split {self.split!r}) has no object {object_id!r}; it has "
                f"{len(self)}, from {self.object_ids[0]!r} to {self.object_ids[-1]!r}."
            )
        path = self._folder / object_id
        return path / f"{object_id}.obj" if self.name == RANDOM_URDFS else path


def _ids(given: Any) -> tuple[str, ...]:
    """The ids that are given, sorted, each once."""
    several = isinstance(given, Collection) and not isinstance(given, str | bytes | Mapping)
    if not (several and len(given) and all(isinstance(one, str) for one in given)):
        raise ObjectSetError(
            f"object_ids must be a list, a tuple, a set or an array of ids, which are texts, not "
            f"{given!r}."
        )
    return tuple(sorted({str(one) for one in given}))


def _changed(path: Path) -> int:
    """When a file was last changed, ns."""
    try:
        return path.stat().st_mtime_ns
    except OSError as error:
        raise MeshError(f"{path} is gone since the set was made; make it anew.") from error


@cache
def _file_digest(path: Path, changed: int) -> bytes:
    """Digest of a file's content; `changed` [ns] is in the key so that an edit is noticed."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").digest()


@dataclass(frozen=True)
class _Verdict:
    """Why a file is no solid, or "", and whether its solid is concave."""

    refusal: str
    concave: bool


@cache
def _verdict(path: Path, changed: int) -> _Verdict:
    """Examine a mesh file, or remember what came of it; `changed` [ns] as in `_file_digest`.

    What is kept in the user's cache is of the file's content, without its place.
    """
    try:
        content = _file_digest(path, changed)
    except OSError as error:
        return _Verdict(f"{path} cannot be read ({error}).", concave=False)
    key = hashlib.sha256(repr((path.suffix.lower(), _READING)).encode() + content).hexdigest()
    kept = cache_folder("solids") / f"{key}.json"
    with suppress(FileNotFoundError, UnreadableFileError, TypeError, KeyError):
        known = read_json(kept)
        return _Verdict(f"{path}{known['refusal']}" if known["refusal"] else "", known["concave"])
    try:
        verdict = _Verdict("", needs_decomposition(path))
    except MeshError as error:
        verdict = _Verdict(str(error), concave=False)
    refusal = verdict.refusal.removeprefix(str(path))
    with suppress(UnwritableFileError):  # costs time at the next use, no more
        write_json(kept, {"refusal": refusal, "concave": verdict.concave})
    return verdict


@lru_cache(maxsize=1024)
def _load(
    path: Path, changed: int, object_id: str, scale: float, target_size: float | None
) -> GraspObject:
    """Load an object; `changed` [ns] is in the key so that an edited file is read again."""
    body = load_body(path, scale)
    if target_size is not None:
        body = body.scaled(target_size / body.extent)
    inertia = body.inertia_per_density * DENSITY
    return GraspObject(object_id, body.solid, body.parts, DENSITY * body.volume, inertia)


def _in_split(object_id: str, split: str) -> bool:
    return split == "all" or object_id.endswith("0") == (split == "test")


def _random_urdfs_folder() -> Path:
    try:
        import pybullet_data
    except ImportError as error:
        raise MissingDependencyError(
            f"{RANDOM_URDFS} comes with PyBullet, which is not installed: pip install pybullet."
        ) from error
    folder = Path(pybullet_data.getDataPath()) / RANDOM_URDFS
    if not folder.is_dir():
        raise ObjectSetError(
            f"{folder} is missing; reinstall PyBullet: pip install --force-reinstall pybullet."
        )
    return folder


def _require_positive(name: str, what: str, value: float | None) -> None:
    if value is not None and not (is_number(value) and 0 < value < math.inf):
        raise ObjectSetError(f"{name} must be a positive {what}, not {value!r}.")


def _meshes_below(folder: Path, name: str, pattern: str | None) -> tuple[str, ...]:
    """Sorted paths, relative to the folder, of the mesh files at any depth; hidden ones apart."""
    if not folder.is_dir():
        raise ObjectSetError(
            f"There is no object set or folder {name!r}; "
            f"use {RANDOM_URDFS!r} or a folder of mesh files."
        )
    try:
        paths = list(folder.glob("**/*" if pattern is None else pattern))
        files = {
            path.relative_to(folder)
            for path in paths
            if path.suffix.lower() in SUPPORTED_SUFFIXES and path.is_file()
        }
    except (TypeError, ValueError, NotImplementedError) as error:
        raise ObjectSetError(
            f"pattern must name files below the folder, as '**/*.stl' does, not {pattern!r}."
        ) from error
    ids = sorted(
        file.as_posix() for file in files if not any(part.startswith(".") for part in file.parts)
    )
    if not ids:
        chosen = "" if pattern is None else f" that match {pattern!r}"
        raise ObjectSetError(
            f"{name!r} has no mesh files{chosen}; the formats read are "
            f"{', '.join(SUPPORTED_SUFFIXES)}."
        )
    return tuple(ids)
