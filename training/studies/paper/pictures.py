"""The pictures of the report, drawn from the results."""

from pathlib import Path

import numpy as np

from training.demonstration import draw
from training.reports.figures import (
    Mark,
    loss_figure,
    path_figure,
    residual_figure,
    save,
    synthesis_figure,
)

from .examples import GRASP
from .quality import hull
from .reproduction import Reproduction
from .solid_figures import contacts_figure, hull_figure
from .synthesis import SynthesisResult, is_solved, solved_mask


def draw_figures(result: Reproduction, folder: Path) -> None:
    """Write every figure of the report into a folder."""
    save(
        loss_figure(
            {
                "eq. 39, benchmark": result.benchmark.fits[0].losses,
                'eq. 40, "grasp"': result.grasp_program.fit.losses,
                "a Barrett grasp": result.barrett.losses,
            }
        ),
        folder / "paper_losses.png",
    )
    figures = result.grasp_program
    flipped = np.array([float(value) for value in GRASP.point]) * ([-1.0] + [1.0] * 8)
    save(
        path_figure(
            figures.path.times.numpy(),
            figures.path.x.numpy(),
            figures.path_slack,
            [
                Mark(
                    "printed, sign of $x_{11}$ changed",
                    figures.nearest_time,
                    flipped,
                    figures.flipped_slack,
                )
            ],
            names=[f"$x_{{{i}{j}}}$" for i in (1, 2, 3) for j in (1, 2, 3)],
        ),
        folder / "paper_path.png",
    )
    paths = result.paths
    save(
        residual_figure(paths.times, paths.residuals, paths.force_errors), folder / "paper_ode.png"
    )
    results = result.synthesis
    before = np.array([r.real for r in results])
    after = np.array([r.bmi.after.quality for r in results])
    save(synthesis_figure(before, after, solved_mask(results)), folder / "paper_synthesis.png")
    one = shown_synthesis(results)
    solid = result.objects[one.object_id].solid
    plans = (one.bmi.before, one.bmi.after)
    save(
        contacts_figure(
            np.asarray(solid.vertices),
            np.asarray(solid.faces),
            np.stack([plan.positions for plan in plans]),
            np.stack([plan.normals for plan in plans]),
            np.ones((2, one.contacts)),
            np.array([plan.quality for plan in plans]),
        ),
        folder / "paper_contacts.png",
    )
    save(hull_figure(hull(result.paper_grasp)), folder / "paper_hull.png")
    draw([result.shown], "clarabel", result.plan.seed, folder / "paper_grasp.png")


def shown_synthesis(results: list[SynthesisResult]) -> SynthesisResult:
    """The result that is drawn: of the solved with closure before, the one of median gain."""
    able = [r for r in results if r.bmi.before.quality > 0 and is_solved(r)] or results
    ranked = sorted(able, key=lambda r: r.bmi.after.quality / max(r.bmi.before.quality, 1e-12))
    return ranked[len(ranked) // 2]
