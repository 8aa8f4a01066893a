"""Convex parts that together stand for a concave mesh, made once and kept in the user's cache.

CoACD (Wei et al. 2022) makes them, in a process of its own (`decomposer.py`), since there are
closed meshes on which it aborts or never ends. Where it fails, it is asked for less; then V-HACD
(Mamou 2016) is asked, and at last the convex hull stands for the mesh. Whatever comes after CoACD's
first answer is named in a warning.
"""

import hashlib
import io
import json
import os
import subprocess
import sys
import zipfile
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import manifold3d
import numpy as np
from numpy.typing import NDArray

from gfo_env.cache import cache_folder
from solvers.arrays import Array
from solvers.exceptions import (
    MissingDependencyError,
    UnreadableFileError,
    UnwritableFileError,
)
from solvers.files import read_arrays, write_arrays

Corners = list[NDArray[np.float64]]

_SCRIPT = Path(__file__).with_name("decomposer.py")


@dataclass(frozen=True)
class _Attempt:
    """A way to decompose.

    Args:
        name: for the warning.
        package: whose version decides the parts.
        method: of `decomposer.py`.
        settings: of the method.
        seconds: of the processor, that it may take.
    """

    name: str
    package: str
    method: str
    settings: dict[str, Any]
    seconds: int


_FINE = _Attempt(
    "CoACD",
    "coacd",
    "coacd",
    # CoACD's own default concavity, relative to the mesh's size (section 5); a quarter of its
    # default search and samples, which takes 2.5 times as long for parts that are no better
    {"threshold": 0.05, "mcts_iterations": 40, "resolution": 500, "seed": 0},
    10,
)
_COARSE = _Attempt(
    "CoACD with coarser settings",
    "coacd",
    "coacd",
    {"threshold": 0.1, "mcts_iterations": 20, "mcts_max_depth": 2, "resolution": 500, "seed": 0},
    4,
)
_OTHER = _Attempt("V-HACD", "pybullet", "vhacd", {}, 10)
_HULL = "its convex hull"

_LARGE = 50_000
"""Triangles of a mesh from which on coarser settings are the first, to end within seconds."""

_MANY = 2_000
"""Triangles above which details of 0.1 % of the mesh's size are left out before, or more."""

_ROUGHEST = 0.01
"""Of the mesh's size: the largest details that are."""

_COVERED = 0.9
"""Share of the mesh's volume that the parts must have; less is no decomposition of it."""


@dataclass(frozen=True, eq=False)
class Decomposition:
    """Convex parts.

    Args:
        points: corners (m_i, 3) of each.
        made_by: what made them, if it is not what should have made them; else "".
    """

    points: Corners
    made_by: str = ""


def decompose(shape: manifold3d.Manifold) -> Decomposition:
    """Convex parts of a closed mesh.

    Raises:
        MissingDependencyError: CoACD is not installed.
    """
    require_coacd()
    attempts = [_COARSE, _OTHER] if shape.num_tri() > _LARGE else [_FINE, _COARSE, _OTHER]
    mesh = _simplified(shape).to_mesh64()
    vertices = np.array(mesh.vert_properties, dtype=np.float64)[:, :3]
    faces = np.array(mesh.tri_verts, dtype=np.int64)
    cached = cache_folder("convex_parts") / f"{_digest(vertices, faces, attempts)}.npz"
    known = _read(cached)
    if known is not None:
        return known
    made = _first(vertices, faces, attempts, _COVERED * shape.volume())
    with suppress(UnwritableFileError):  # costs time at the next use, no more
        write_arrays(cached, _arrays(made), compressed=True)
    return made


def require_coacd() -> None:
    """Find out whether there is CoACD.

    Raises:
        MissingDependencyError: CoACD is not installed.
    """
    try:
        import coacd  # noqa: F401
    except ImportError as error:
        raise MissingDependencyError(
            "A concave mesh needs CoACD to become convex parts: "
            "pip install 'graspforce[decomposition]'."
        ) from error


def _simplified(shape: manifold3d.Manifold) -> manifold3d.Manifold:
    size = float(np.ptp(np.reshape(shape.bounding_box(), (2, 3)), axis=0).max())
    tolerance, simple = 1e-3, shape
    while simple.num_tri() > _MANY and tolerance <= _ROUGHEST:
        simple = shape.simplify(tolerance * size)
        tolerance *= 2
    return simple


def _digest(vertices: Array, faces: NDArray[np.int64], attempts: list[_Attempt]) -> str:
    content = hashlib.sha256(repr([(a, version(a.package)) for a in attempts]).encode())
    content.update(_SCRIPT.read_bytes())
    content.update(vertices.tobytes())
    content.update(faces.tobytes())
    return content.hexdigest()


def _first(
    vertices: Array, faces: NDArray[np.int64], attempts: list[_Attempt], volume: float
) -> Decomposition:
    """The parts of the first attempt that has some of this volume."""
    for attempt in attempts:
        points = _run(vertices, faces, attempt)
        if points and sum(manifold3d.Manifold.hull_points(p).volume() for p in points) >= volume:
            return Decomposition(points, "" if attempt is attempts[0] else attempt.name)
    return Decomposition([vertices], _HULL)


def _run(vertices: Array, faces: NDArray[np.int64], attempt: _Attempt) -> Corners:
    """What an attempt comes to, in a process of its own; nothing if it fails."""
    content = io.BytesIO()
    np.savez(content, vertices=vertices, faces=faces)
    command = [sys.executable, "-P", str(_SCRIPT), attempt.method]
    command += [json.dumps(attempt.settings), str(attempt.seconds), str(os.getpid())]
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    ended = subprocess.run(
        command,
        input=content.getvalue(),
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=os.environ | threads,
        check=False,
    )
    if ended.returncode != 0:
        return []
    try:
        with np.load(io.BytesIO(ended.stdout)) as arrays:
            made = _made(arrays)
    except (EOFError, KeyError, ValueError, zipfile.BadZipFile):  # it ended too soon
        return []
    return made.points if made else []


def _read(path: Path) -> Decomposition | None:
    """A decomposition from the cache, or None if there is none or it is damaged."""
    try:
        return _made(read_arrays(path))
    except (FileNotFoundError, UnreadableFileError, KeyError, TypeError, ValueError):
        return None


def _made(arrays: Mapping[str, NDArray[Any]]) -> Decomposition | None:
    """The decomposition in arrays of `_arrays`, or None if they hold none."""
    points = np.split(arrays["points"], arrays["ends"][:-1])
    made_by = str(arrays["made_by"]) if "made_by" in arrays else ""
    good = all(
        part.shape[1:] == (3,) and len(part) > 3 and np.isfinite(part).all() for part in points
    )
    return Decomposition(points, made_by) if good else None


def _arrays(made: Decomposition) -> dict[str, NDArray[Any]]:
    return {
        "points": np.concatenate(made.points),
        "ends": np.cumsum([len(corners) for corners in made.points]),
        "made_by": np.array(made.made_by),
    }
