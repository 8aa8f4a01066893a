"""Cut a concave mesh into convex parts, in a process of its own: CoACD may abort it or never end.

`gfo_env.objects.decomposition` runs this file as a script. It reads an .npz with `vertices` and
`faces` from its standard input and writes one with `points` of all parts and their `ends` to its
standard output.
"""

import argparse
import ctypes
import io
import json
import os
import resource
import signal
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Corners = list[NDArray[np.float64]]

_MEMORY = 3 * 2**30
"""Bytes, of addresses: what the libraries reserve without use counts, too."""


def main() -> None:
    """Decompose, within limits that hold when nobody is left to end this process."""
    parser = argparse.ArgumentParser()
    parser.add_argument("method", choices=_METHODS)
    parser.add_argument("settings", type=json.loads)
    parser.add_argument("seconds", type=int, help="of the processor; by the clock five times that")
    parser.add_argument("parent", type=int)
    arguments = parser.parse_args()
    _limit(arguments.seconds, arguments.parent)
    # what libraries print must not get into the answer
    answer = os.fdopen(os.dup(1), "wb")
    silence = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silence, 1)
    os.dup2(silence, 2)
    with np.load(io.BytesIO(sys.stdin.buffer.read())) as mesh:
        vertices, faces = mesh["vertices"], mesh["faces"]
    points = _METHODS[arguments.method](vertices, faces, arguments.settings)
    with answer:
        np.savez(answer, points=np.concatenate(points), ends=np.cumsum([len(p) for p in points]))


def _limit(seconds: int, parent: int) -> None:
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    signal.alarm(5 * seconds)
    if sys.platform == "linux":
        death_of_parent = 1  # Ref: PR_SET_PDEATHSIG in prctl(2)
        ctypes.CDLL(None).prctl(death_of_parent, signal.SIGKILL)
        if os.getppid() != parent:
            sys.exit(1)


def _coacd(vertices: Any, faces: Any, settings: dict[str, Any]) -> Corners:
    import coacd

    coacd.set_log_level("off")
    parts = coacd.run_coacd(coacd.Mesh(vertices, faces), **settings)
    return [np.asarray(corners, dtype=np.float64) for corners, _ in parts]


def _vhacd(vertices: Any, faces: Any, settings: dict[str, Any]) -> Corners:
    """Mamou's V-HACD, as PyBullet has it: from an OBJ file to one with a group a part."""
    import pybullet

    low, size = vertices.min(axis=0), np.ptp(vertices, axis=0).max()
    with tempfile.TemporaryDirectory() as folder:
        given, made, log = (str(Path(folder, name)) for name in ("in.obj", "out.obj", "log.txt"))
        lines = [f"v {x:.17g} {y:.17g} {z:.17g}" for x, y, z in (vertices - low) / size]
        lines += [f"f {a} {b} {c}" for a, b, c in faces + 1]
        Path(given).write_text("\n".join(lines) + "\n")
        pybullet.vhacd(given, made, log, **settings)
        groups = Path(made).read_text().split("\no ")
    rows = [[line.split()[1:4] for line in g.splitlines() if line.startswith("v ")] for g in groups]
    return [low + size * np.array(row, dtype=np.float64) for row in rows if row]


_METHODS = {"coacd": _coacd, "vhacd": _vhacd}

if __name__ == "__main__":
    main()
