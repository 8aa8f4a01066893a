"""The pictures of the report: what they show, taken from the results, and how it is drawn."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from solvers.arrays import Array
from training.reports.figures import (
    Mark,
    loss_figure,
    path_figure,
    residual_figure,
    synthesis_figure,
)

from .examples import GRASP
from .quality import Hull, hull
from .reproduction import Reproduction
from .solid_figures import contacts_figure, hull_figure
from .synthesis import SynthesisResult, is_solved, solved_mask


@dataclass(frozen=True, eq=False)
class PictureData:
    """What the pictures show; see the functions that draw them for shapes and units.

    Args:
        losses: of three networks, by name.
        path_times, path, path_slack: the ODE of the printed grasp program.
        nearest_time: when it comes closest to the printed point, one sign changed.
        flipped, flipped_slack: that point, and the constraint there.
        ode_times, residuals, force_errors: the ODE on real grasps.
        before, after: q_lrw of contacts that were acquired, and of those that were moved.
        solved: of which that succeeded.
        vertices, faces: of one object.
        positions, normals, qualities: its contacts before and after.
        hull: of the wrenches of a grasp.
    """

    losses: dict[str, Array]
    path_times: Array
    path: Array
    path_slack: Array
    nearest_time: float
    flipped: Array
    flipped_slack: float
    ode_times: Array
    residuals: Array
    force_errors: Array
    before: Array
    after: Array
    solved: NDArray[np.bool_]
    vertices: Array
    faces: NDArray[np.int64]
    positions: Array
    normals: Array
    qualities: Array
    hull: Hull

    @classmethod
    def of(cls, result: Reproduction) -> Self:
        """From the results."""
        program, paths, moved = result.grasp_program, result.paths, result.synthesis
        one = shown_synthesis(moved)
        solid = result.objects[one.object_id].solid
        plans = (one.bmi.before, one.bmi.after)
        return cls(
            losses={
                "eq. 39, benchmark": result.benchmark.fits[0].losses,
                'eq. 40, "grasp"': program.fit.losses,
                "a Barrett grasp": result.barrett.losses,
            },
            path_times=program.path.times.numpy(),
            path=program.path.x.numpy(),
            path_slack=program.path_slack,
            nearest_time=program.nearest_time,
            flipped=np.array([float(value) for value in GRASP.point]) * ([-1.0] + [1.0] * 8),
            flipped_slack=program.flipped_slack,
            ode_times=paths.times,
            residuals=paths.residuals,
            force_errors=paths.force_errors,
            before=np.array([r.real for r in moved]),
            after=np.array([r.bmi.after.quality for r in moved]),
            solved=solved_mask(moved),
            vertices=np.asarray(solid.vertices),
            faces=np.asarray(solid.faces),
            positions=np.stack([plan.positions for plan in plans]),
            normals=np.stack([plan.normals for plan in plans]),
            qualities=np.array([plan.quality for plan in plans]),
            hull=hull(result.paper_grasp),
        )


def figures(data: PictureData) -> dict[str, Figure]:
    """Every figure of the report but the rendered one, by name."""
    label = "printed, sign of $x_{11}$ changed"
    mark = Mark(label, data.nearest_time, data.flipped, data.flipped_slack)
    names = [f"$x_{{{i}{j}}}$" for i in (1, 2, 3) for j in (1, 2, 3)]
    pressing = np.ones(data.positions.shape[:2])
    return {
        "losses": loss_figure(data.losses),
        "path": path_figure(data.path_times, data.path, data.path_slack, [mark], names=names),
        "ode": residual_figure(data.ode_times, data.residuals, data.force_errors),
        "synthesis": synthesis_figure(data.before, data.after, data.solved),
        "contacts": contacts_figure(
            data.vertices, data.faces, data.positions, data.normals, pressing, data.qualities
        ),
        "hull": hull_figure(data.hull),
    }


def shown_synthesis(results: list[SynthesisResult]) -> SynthesisResult:
    """The result that is drawn: of the solved with closure before, the one of median gain."""
    able = [r for r in results if r.bmi.before.quality > 0 and is_solved(r)] or results
    ranked = sorted(able, key=lambda r: r.bmi.after.quality / max(r.bmi.before.quality, 1e-12))
    return ranked[len(ranked) // 2]
