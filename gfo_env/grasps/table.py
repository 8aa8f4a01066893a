"""Tables of acquired grasps: what collection writes, and training and evaluation read."""

import json
import struct
import zipfile
import zlib
from dataclasses import dataclass, fields
from pathlib import Path
from typing import IO, Any, Self

import numpy as np
from numpy.typing import NDArray

from gfo_env.cache import write_atomically
from gfo_env.hand import BARRETT_BH8_280
from solvers import GraspForceError

_FORMAT = "graspforce-grasps-2"
_HEADER = (
    "object_set",
    "split",
    "target_size",
    "seed",
    "hand",
    "fingertips",
    "max_torque",
    "scale",
)

# what numpy, zipfile and json raise for files that are cut short, overwritten or something else
_UNREADABLE = (
    EOFError,
    KeyError,
    OSError,
    RuntimeError,
    TypeError,
    ValueError,
    struct.error,
    zipfile.BadZipFile,
    zlib.error,
)


class GraspTableError(GraspForceError, ValueError):
    """A file of grasps is missing, is something else, or holds no grasp."""


@dataclass(frozen=True, eq=False, kw_only=True)
class GraspTable:
    """N grasps as arrays, contacts padded to a common number n; SI units.

    Args:
        object_set: name or path of the objects' set.
        split: of the set.
        target_size: m, to which every object was scaled, or None.
        scale: m, unit of the objects' files, or None where nobody said.
        seed: that the grasps were made with.
        hand: name of the hand.
        fingertips: whether only fingertips touch.
        max_torque: (n_tau,) N·m, the hand's torque limits of either sign.
        object_id: (N,) names in the set.
        attempt: (N,) number of the attempt, unique in the table.
        object_radius: (N,) m, largest distance of the surface from the centre of mass.
        object_mass: (N,) kg, at the set's density.
        object_position: (N, 3) m, centre of mass in the hand frame.
        object_rotation: (N, 3, 3) columns are the object's axes in the hand frame.
        joint_angles: (N, n_tau) rad.
        positions: (N, n, 3) m, contacts in the object frame.
        frames: (N, n, 3, 3) contact frames t1, t2, n as columns, object frame.
        links: (N, n) index of the hand's link, -1 for the palm.
        normal_forces: (N, n) N, in the simulator at the end of the acquisition.
        contact_mask: (N, n) False at padding.
        grasp_map: (N, 6, 3n) G.
        hand_jacobian: (N, 3n, n_tau) J_h, m.
        gravity_map: (N, n_tau, 3) torques that carry the hand's links, per gravity in the hand
            frame.
    """

    object_set: str
    split: str
    seed: int
    max_torque: NDArray[np.float64]
    object_id: NDArray[np.str_]
    attempt: NDArray[np.int64]
    object_radius: NDArray[np.float64]
    object_mass: NDArray[np.float64]
    object_position: NDArray[np.float64]
    object_rotation: NDArray[np.float64]
    joint_angles: NDArray[np.float64]
    positions: NDArray[np.float64]
    frames: NDArray[np.float64]
    links: NDArray[np.int64]
    normal_forces: NDArray[np.float64]
    contact_mask: NDArray[np.bool_]
    grasp_map: NDArray[np.float64]
    hand_jacobian: NDArray[np.float64]
    gravity_map: NDArray[np.float64]
    target_size: float | None = None
    scale: float | None = None
    hand: str = BARRETT_BH8_280.name
    fingertips: bool = False

    def __len__(self) -> int:
        return len(self.object_id)

    def __getitem__(self, index: Any) -> Self:
        """The grasps at a slice, an index array or a mask."""
        rows: dict[str, Any] = {name: getattr(self, name)[index] for name in COLUMNS}
        return type(self)(**self._header(), **rows)

    def save(self, path: str | Path) -> None:
        """Write the table as a compressed .npz, whole or not at all; same table, same bytes."""
        write_atomically(Path(path), self.write)

    def write(self, stream: IO[bytes], **extra: NDArray[Any]) -> None:
        """Write the table, and arrays of other names with it, as a compressed .npz."""
        header = self._header()
        header["max_torque"] = self.max_torque.tolist()
        if self.scale is None:  # as tables were that knew none
            del header["scale"]
        text = json.dumps({"format": _FORMAT, **header}, sort_keys=True)
        columns: dict[str, Any] = {name: getattr(self, name) for name in COLUMNS}
        np.savez_compressed(stream, header=np.array(text), allow_pickle=False, **columns, **extra)

    @classmethod
    def load(cls, path: str | Path) -> "GraspTable":
        """Read what `save` wrote.

        Raises:
            GraspTableError: if the file is missing, is no such table, or is empty.
        """
        table, _ = cls.read(path)
        if not len(table):
            raise GraspTableError(f"{path} holds no grasp; collect with more attempts")
        return table

    @classmethod
    def read(
        cls, path: str | Path, extra: tuple[str, ...] = ()
    ) -> tuple["GraspTable", dict[str, NDArray[Any]]]:
        """Read what `write` wrote: a table, empty perhaps, and the arrays of these other names.

        Raises:
            GraspTableError: if the file is missing, or is no such table.
        """
        try:
            # np.load leaves a broken file open if it opened it itself
            with Path(path).open("rb") as stream:
                _verify(stream)
                with np.load(stream) as archive:
                    header = dict(json.loads(str(archive["header"])))
                    columns = {name: archive[name] for name in COLUMNS}
                    others = {name: archive[name] for name in extra}
        except FileNotFoundError as error:
            raise GraspTableError(
                f"no grasps at {path}; make them with scripts/collect.py --output {path}"
            ) from error
        except _UNREADABLE as error:
            raise GraspTableError(
                f"{path} is not a table of grasps; make one with scripts/collect.py"
            ) from error
        header.setdefault("scale", None)
        if header.pop("format", None) != _FORMAT or header.keys() != set(_HEADER):
            raise GraspTableError(f"{path} is of another format than {_FORMAT}; collect it anew")
        header["max_torque"] = np.array(header["max_torque"])
        if len({len(column) for column in columns.values()}) > 1:
            raise GraspTableError(f"the columns of {path} differ in length; collect it anew")
        return cls(**header, **columns), others

    @classmethod
    def concatenate(cls, tables: list["GraspTable"]) -> "GraspTable":
        """One table out of several of the same set, split and seed."""
        rows: dict[str, Any] = {
            name: np.concatenate([getattr(t, name) for t in tables]) for name in COLUMNS
        }
        return cls(**tables[0]._header(), **rows)

    def _header(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in _HEADER}


def _verify(stream: IO[bytes]) -> None:
    """Compare checksums, because numpy may raise anything when it reads damaged content."""
    with zipfile.ZipFile(stream) as archive:
        if archive.testzip() is not None:
            raise zipfile.BadZipFile("wrong checksum")
    stream.seek(0)


COLUMNS: tuple[str, ...] = tuple(
    field.name for field in fields(GraspTable) if field.name not in _HEADER
)
