"""Objects as the physics engine reads them: OBJ files along the principal axes of inertia."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gfo_env.objects import DENSITY, Body, GraspObject
from solvers.arrays import Array
from solvers.files import writing


@dataclass(frozen=True, eq=False)
class EngineMesh:
    """A file of an object's convex parts in the frame that the engine wants.

    Args:
        path: of the OBJ, one group a part.
        axes: (3, 3) principal axes of inertia as columns, object frame: the axes of the file.
        parts: whose file it is; kept so that their identity stays theirs.
    """

    path: Path
    axes: Array
    parts: object

    def moments(self, grasp_object: GraspObject) -> Array:
        """(3,) principal moments of an object of this shape and of any mass, kg m2."""
        return np.asarray(np.diagonal(self.axes.T @ grasp_object.inertia @ self.axes))


def write_engine_mesh(grasp_object: GraspObject, path: Path) -> EngineMesh:
    """Write the convex parts of an object to `path`.

    The engine wants bodies in the frame of their principal axes, and loads every group of an OBJ as
    a convex hull.
    """
    # of the shape, at the density of every set: the last digits must not depend on the mass of
    # whichever object of this shape happens to come first
    shape = Body(grasp_object.solid, grasp_object.parts)
    _, axes = np.linalg.eigh(shape.inertia_per_density * DENSITY)
    axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
    lines: list[str] = []
    count = 1
    for number, part in enumerate(grasp_object.parts):
        lines.append(f"o part{number}")
        lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in part.vertices @ axes]
        lines += [f"f {a} {b} {c}" for a, b, c in part.faces + count]
        count += len(part.vertices)
    with writing(path):
        path.write_text("\n".join(lines) + "\n")
    return EngineMesh(path, axes, grasp_object.parts)
