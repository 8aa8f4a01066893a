"""Tables of acquired grasps: what collection writes, and training and evaluation read."""

import json
from dataclasses import dataclass, fields
from pathlib import Path
from typing import IO, Any, Self

import numpy as np
from numpy.typing import NDArray

from gfo_env.hand import BARRETT_BH8_280
from solvers import GraspForceError
from solvers.exceptions import UnreadableFileError
from solvers.files import read_arrays, write_atomically

_FORMAT = "graspforce-grasps-2"
_HEADER: dict[str, tuple[type, ...]] = {
    "object_set": (str,),
    "split": (str,),
    "target_size": (float, int, type(None)),
    "seed": (int,),
    "hand": (str,),
    "fingertips": (bool,),
    "max_torque": (list,),
    "scale": (float, int, type(None)),
}


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
        """Write the table as a compressed .npz, whole or not at all; same table, same bytes.

        Raises:
            UnwritableFileError: if the system refuses; what lay there before still does.
        """
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
            arrays = read_arrays(Path(path))
            header = dict(json.loads(str(arrays["header"])))
            columns: dict[str, Any] = {name: arrays[name] for name in COLUMNS}
            others = {name: arrays[name] for name in extra}
        except FileNotFoundError as error:
            raise GraspTableError(
                f"no grasps at {path}; make them with scripts/collect.py --output {path}"
            ) from error
        # the last four: a header that is none, and columns that are missing
        except (UnreadableFileError, KeyError, TypeError, ValueError, RecursionError) as error:
            raise GraspTableError(
                f"{path} is not a table of grasps; make one with scripts/collect.py"
            ) from error
        header.setdefault("scale", None)
        if header.pop("format", None) != _FORMAT or header.keys() != set(_HEADER):
            raise GraspTableError(f"{path} is of another format than {_FORMAT}; collect it anew")
        wrong = [name for name, kinds in _HEADER.items() if type(header[name]) not in kinds]
        if wrong := wrong or _misfits(columns, header["max_torque"]):
            raise GraspTableError(f"{', '.join(wrong)} of {path} cannot be; collect it anew")
        header["max_torque"] = np.array(header["max_torque"], dtype=np.float64)
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


COLUMNS: tuple[str, ...] = tuple(
    field.name for field in fields(GraspTable) if field.name not in _HEADER
)


def column_shapes(contacts: int, joints: int) -> dict[str, tuple[int, ...]]:
    """The shape of a row of each column, for so many contacts, padding included, and joints."""
    n, n_tau = contacts, joints
    return {
        **dict.fromkeys(("object_id", "attempt", "object_radius", "object_mass"), ()),
        "object_position": (3,),
        "object_rotation": (3, 3),
        "joint_angles": (n_tau,),
        "positions": (n, 3),
        "frames": (n, 3, 3),
        "links": (n,),
        "normal_forces": (n,),
        "contact_mask": (n,),
        "grasp_map": (6, 3 * n),
        "hand_jacobian": (3 * n, n_tau),
        "gravity_map": (n_tau, 3),
    }


COLUMN_KINDS: dict[str, type[np.generic]] = {
    **dict.fromkeys(COLUMNS, np.float64),
    **dict.fromkeys(("attempt", "links"), np.int64),
    "object_id": np.str_,
    "contact_mask": np.bool_,
}
"""The type of each column."""


def _misfits(columns: dict[str, NDArray[Any]], max_torque: list[Any]) -> list[str]:
    """Names of columns whose shape, type or numbers cannot be those of a table."""
    mask, jacobian = columns["contact_mask"], columns["hand_jacobian"]
    if mask.ndim != 2 or jacobian.ndim != 3:
        return ["contact_mask", "hand_jacobian"]
    wrong = [
        name
        for name, shape in column_shapes(mask.shape[1], jacobian.shape[2]).items()
        if columns[name].shape != (len(mask), *shape)
        or not np.issubdtype(columns[name].dtype, COLUMN_KINDS[name])
        or (COLUMN_KINDS[name] is np.float64 and not np.isfinite(columns[name]).all())
    ]
    limits = [limit for limit in max_torque if type(limit) in (float, int) and limit >= 0]
    if len(limits) != jacobian.shape[2] or len(limits) != len(max_torque):
        wrong.append("max_torque")
    return wrong
