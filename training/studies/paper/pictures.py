"""The pictures of the report, drawn from the results."""

import numpy as np
from matplotlib.figure import Figure

from training.reports.figures import (
    Mark,
    loss_figure,
    path_figure,
    residual_figure,
    synthesis_figure,
)

from .examples import GRASP
from .quality import hull
from .reproduction import Reproduction
from .solid_figures import contacts_figure, hull_figure
from .synthesis import SynthesisResult, is_solved, solved_mask


def figures(result: Reproduction) -> dict[str, Figure]:
    """Every figure of the report but the rendered one, by name."""
    losses = {
        "eq. 39, benchmark": result.benchmark.fits[0].losses,
        'eq. 40, "grasp"': result.grasp_program.fit.losses,
        "a Barrett grasp": result.barrett.losses,
    }
    program = result.grasp_program
    flipped = np.array([float(value) for value in GRASP.point]) * ([-1.0] + [1.0] * 8)
    label = "printed, sign of $x_{11}$ changed"
    path = path_figure(
        program.path.times.numpy(),
        program.path.x.numpy(),
        program.path_slack,
        [Mark(label, program.nearest_time, flipped, program.flipped_slack)],
        names=[f"$x_{{{i}{j}}}$" for i in (1, 2, 3) for j in (1, 2, 3)],
    )
    paths = result.paths
    results = result.synthesis
    before = np.array([r.real for r in results])
    after = np.array([r.bmi.after.quality for r in results])
    one = shown_synthesis(results)
    solid = result.objects[one.object_id].solid
    plans = (one.bmi.before, one.bmi.after)
    contacts = contacts_figure(
        np.asarray(solid.vertices),
        np.asarray(solid.faces),
        np.stack([plan.positions for plan in plans]),
        np.stack([plan.normals for plan in plans]),
        np.ones((2, one.contacts)),
        np.array([plan.quality for plan in plans]),
    )
    return {
        "losses": loss_figure(losses),
        "path": path,
        "ode": residual_figure(paths.times, paths.residuals, paths.force_errors),
        "synthesis": synthesis_figure(before, after, solved_mask(results)),
        "contacts": contacts,
        "hull": hull_figure(hull(result.paper_grasp)),
    }


def shown_synthesis(results: list[SynthesisResult]) -> SynthesisResult:
    """The result that is drawn: of the solved with closure before, the one of median gain."""
    able = [r for r in results if r.bmi.before.quality > 0 and is_solved(r)] or results
    ranked = sorted(able, key=lambda r: r.bmi.after.quality / max(r.bmi.before.quality, 1e-12))
    return ranked[len(ranked) // 2]
