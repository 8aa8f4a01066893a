"""The page docs/paper.md: a text with gaps, the numbers that fill them, pictures."""

from base64 import b64decode, b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Self

import numpy as np

from gfo_env.hand import BARRETT_BH8_280
from gfo_env.synthesis import EDGES, Improvement
from solvers.arrays import Array
from solvers.synthesis import GRASP_MATRIX_FLOOR, SynthesisStatus
from training.demonstration import draw
from training.reports import pages
from training.reports.numbers import drop, percent, relative, scientific, spread, yes
from training.reports.results import Run
from training.reports.tables import table

from .agreement import LONGER, RouteErrors
from .examples import GRASP, HORIZON
from .pictures import PictureData, figures, shown_synthesis
from .quality import (
    EDGE_COUNTS,
    arbitrary_forces,
    closure,
    conventions,
    force_scale_for,
    hull,
    length_for,
    quality,
    strongest_scale,
)
from .reproduction import Reproduction
from .summary import summary
from .synthesis import FRICTION, SynthesisResult, solved_mask

RESTED = 1e-6
"""Size of the field at which the ODE counts as at rest."""

_NETWORK_GOAL = 1e-3
_MU_ROWS = (0.0, 0.3, 0.4, 0.7)

Fields = dict[str, str]


@dataclass(frozen=True, eq=False)
class PaperStudy:
    """Everything that the page is made of.

    Args:
        texts: what fills the template, by name.
        summary: the figures that decide on the targets.
        pictures: what the figures show.
        rendered: the picture of the held grasp, a PNG in base64.
    """

    texts: dict[str, str]
    summary: dict[str, Any]
    pictures: PictureData
    rendered: str

    @classmethod
    def of(cls, result: Reproduction) -> Self:
        """From the results."""
        texts = {
            **_forms(result),
            **_examples(result),
            **_agreement(result),
            **_synthesis(result),
            **_quality(result),
        }
        with TemporaryDirectory() as folder:
            path = Path(folder) / "grasp.png"
            draw([result.shown], "clarabel", result.plan.seed, path)
            rendered = b64encode(path.read_bytes()).decode()
        return cls(texts, summary(result), PictureData.of(result), rendered)


def write_page(run: Run[PaperStudy], path: Path) -> str:
    """Write the page, and its pictures beside it; a word on the synthesis.

    Args:
        run: what it is about.
        path: of the Markdown file.
    """
    study = run.results
    fields = study.texts | {"command": run.command}
    pages.write_page(path, __package__, fields, figures(study.pictures))
    path.with_name(f"{path.stem}_grasp.png").write_bytes(b64decode(study.rendered))
    solved, gain = study.summary["synthesis_solved"], study.summary["synthesis_gain_median"]
    count = study.summary["synthesis_objects"]
    text = f"Contact synthesis: {solved:.0%} of {count} objects at rank one"
    return text if gain is None else f"{text}, median gain of q_lrw {gain:+.0%}"


def _forms(result: Reproduction) -> Fields:
    check, paths = result.inequality, result.paths
    at_ten = np.median(paths.force_errors[np.searchsorted(paths.times, HORIZON)])
    counts = result.problems.contact_mask.sum(axis=-1)
    return {
        "phi_difference": scientific(result.field_difference),
        "lmi_draws": str(check.draws),
        "lmi_inside": str(check.inside),
        "lmi_mismatches": str(check.mismatches),
        "lmi_verdict": "does not hold" if check.mismatches else "holds",
        "ode_rested": str(int(np.sum(paths.residuals[-1] < RESTED))),
        "ode_end": f"{paths.times[-1]:.0f}",
        "ode_at_ten": f"{at_ten:.0%}",
        "ode_floor": f"{np.median(paths.force_errors[-1]):.0e}",
        "problem_count": str(len(result.problems)),
        "contacts_least": str(int(counts.min())),
        "contacts_most": str(int(counts.max())),
    }


def _examples(result: Reproduction) -> Fields:
    bench, grasp = result.benchmark, result.grasp_program
    error = relative(bench.network_objective, bench.optimum)
    reached = int(np.sum(error <= _NETWORK_GOAL))
    bench_rows = [
        ("HiGHS, the optimum", f"{bench.optimum:.6f}", "-"),
        (
            "the ODE at rest, torchdiffeq",
            f"{bench.ode_objective:.6f}",
            scientific(relative(bench.ode_objective, bench.optimum)),
        ),
        (
            "the ODE at rest, scipy",
            f"{bench.scipy_objective:.6f}",
            scientific(relative(bench.scipy_objective, bench.optimum)),
        ),
        (
            "the ODE at t = 10",
            f"{bench.at_horizon:.6f}",
            scientific(relative(bench.at_horizon, bench.optimum)),
        ),
        *(
            (f"network at t = 10, seed {result.plan.seed + index}", f"{value:.6f}", scientific(e))
            for index, (value, e) in enumerate(zip(bench.network_objective, error, strict=True))
        ),
        (
            "printed point",
            f"{bench.printed_objective:.6f}",
            scientific(relative(bench.printed_objective, bench.optimum)),
        ),
    ]
    network = grasp.network_end
    largest = max(abs(float(value)) for value in GRASP.point)
    strongest = max(BARRETT_BH8_280.max_torque)
    grasp_rows = [
        ("printed point", f"{sum(map(float, GRASP.point)):.2f}", f"{grasp.printed_slack:.3f}"),
        (
            "the same, sign of x₁₁ changed",
            f"{sum(map(float, GRASP.point)) - 2 * float(GRASP.point[0]):.2f}",
            f"{grasp.flipped_slack:.3f}",
        ),
        ("the ODE at t = 10", f"{grasp.at_horizon.sum():.2f}", _slack(grasp.at_horizon)),
        (
            f"the ODE at t = {grasp.path.times[-1]:.0f}",
            f"{float(grasp.path.x[-1].sum()):.2f}",
            f"{grasp.path_slack[-1]:.3f}",
        ),
        ("network at t = 10", f"{network.sum():.2f}", _slack(network)),
    ]
    return {
        "bench_optimum": f"{bench.optimum:.2f}",
        "bench_printed": (
            f"{bench.printed_objective:.4f}, "
            f"{relative(bench.printed_objective, bench.optimum):.2%} above it"
        ),
        "bench_table": table(("", "objective", "relative error"), bench_rows, "lr"),
        "bench_loss_drop": drop(bench.fits[0].losses),
        "bench_verdict": (
            f"reproduced: objective within 0.1 % for {reached} of {len(error)} seeds"
        ),
        "bench_end": ", ".join(f"{value:.3f}" for value in bench.ode_end),
        "printed_distance": f"{bench.printed_distance:.2f}",
        "printed_edge": f"{bench.edge_distance:.4f}",
        "seeds": str(len(bench.fits)),
        "grasp_slack": f"{grasp.printed_slack:.1f}",
        "grasp_flipped": f"{grasp.flipped_slack:+.3f}",
        "grasp_loss_drop": drop(grasp.fit.losses),
        "grasp_loss_verdict": "the curve decreases; the printed point cannot come from T = 10",
        "grasp_table": table(("point", "Σ x_ij", "a'x + 600"), grasp_rows, "lr"),
        "mu_needed": " / ".join(f"{value:.2f}" for value in grasp.friction_needed),
        "torque_size": f"{largest:.1f}",
        "torque_limit": f"{strongest:g}",
        "torque_ratio": f"{largest / strongest:.0f}",
        "wall_time": f"{grasp.wall_time:.1f}",
        "ray": ", ".join(str(value) for value in grasp.ray),
        "ray_cost": str(grasp.ray_cost),
        "ray_slope": str(grasp.ray_slope),
        "highs": grasp.highs_status,
        "drift": f"{grasp.drift:.4f}",
        "exact_drift": f"{grasp.exact_drift:.4f}",
        "nearest_time": f"{grasp.nearest_time:.1f}",
        "nearest_distance": f"{grasp.nearest_distance:.1f}",
    }


def _agreement(result: Reproduction) -> Fields:
    exact, network = result.routes["clarabel"], result.routes["instance_network"]
    longer = result.routes[LONGER]
    ode = result.routes["kkt_ode"]

    def row(name: str, route: RouteErrors) -> tuple[str, ...]:
        return (
            f"`{name}`",
            f"{int(np.sum(route.status == 'optimal'))} of {len(route.status)}",
            spread(route.objective_error),
            spread(route.force_error),
            spread(route.balance_error),
            f"{route.milliseconds / exact.milliseconds:.3g}",
        )

    convex = [result.routes[name] for name in ("lmi, clarabel", "lmi, scs")]
    return {
        "balance_error": scientific(np.max(exact.balance_error)),
        "instance_ratio": f"{network.milliseconds / exact.milliseconds:,.0f}",
        "instance_error": f"{np.median(network.force_error):.0%}",
        "routes_table": table(
            (
                "formulation",
                "judged `optimal`",
                "error of the objective",
                "error of the forces",
                "balance error",
                "time over `clarabel`'s",
            ),
            [row(name, route) for name, route in result.routes.items()],
            "lr",
        ),
        "convex_error": scientific(max(route.objective_error.max() for route in convex)),
        "ode_optimal": str(int(np.sum(ode.status == "optimal"))),
        "network_objective_error": percent(network.objective_error),
        "network_force_error": percent(network.force_error),
        "network_feasible": str(int(np.sum(np.isin(network.status, ("optimal", "feasible"))))),
        "longer_objective_error": percent(longer.objective_error),
        "longer_force_error": percent(longer.force_error),
        "longer_count": str(len(longer.status)),
    }


def _synthesis(result: Reproduction) -> Fields:
    results = result.synthesis
    solved = solved_mask(results)
    first = [r.bmi.first for r in results if r.bmi.first is not None]
    done = [one for one in first if one.status is SynthesisStatus.SOLVED]
    reach = [one.reach / one.relaxation for one in done]
    statuses = [str(one.status) for one in first]
    proven = sum(r.one_sided is SynthesisStatus.INFEASIBLE for r in results)
    real = np.array([r.real for r in results])
    after = np.array([r.bmi.after.quality for r in results])
    closed = real > 0

    def row(name: str, values: list[float], moves: Sequence[Improvement]) -> tuple[str, ...]:
        better = np.array(values)
        gain = better[closed] / real[closed] - 1.0
        return (
            name,
            f"{np.median(better):.3f}",
            f"{np.mean(better > real):.0%}",
            f"{np.median(gain):+.0%}" if len(gain) else "-",
            f"{np.median([m.seconds for m in moves]):.1f}" if moves else "-",
        )

    bmi, gradient = [r.bmi for r in results], [r.gradient for r in results]
    rows = [
        ("real grasp", f"{np.median(real):.3f}", "-", "-", "-"),
        row("put on facets", [m.before.quality for m in bmi], ()),
        row("BMI, same facets", [m.on_facets.quality for m in bmi], ()),
        row("gradient, same facets", [m.on_facets.quality for m in gradient], ()),
        row("BMI, all facets", [m.after.quality for m in bmi], bmi),
        row("gradient, all facets", [m.after.quality for m in gradient], gradient),
    ]
    one = shown_synthesis(results)
    return {
        "bmi_solved": str(int(solved.sum())),
        "bmi_count": str(len(results)),
        "bmi_ratio": scientific(max(one.eigenvalue_ratio for one in done)) if done else "-",
        "epsilon": f"{GRASP_MATRIX_FLOOR:g}",
        "synthesis_friction": f"{FRICTION:g}",
        "edges": str(EDGES),
        "synthesis_table": table(
            (
                f"{len(results)} objects",
                "q_lrw, median",
                "better than real",
                "gain, median",
                "seconds, median",
            ),
            rows,
            "lr",
        ),
        "bmi_share": f"{solved.mean():.0%}",
        "bmi_infeasible": str(statuses.count("infeasible")),
        "bmi_failed": str(statuses.count("failed")),
        "bmi_residual": scientific(max(one.residual for one in done)) if done else "-",
        "bmi_reach": f"{np.median(reach):.0%}" if done else "-",
        "bmi_better": f"{np.mean((after > real)[solved]):.0%}" if done else "-",
        "closed_count": str(int(closed.sum())),
        "open_count": str(int((~closed).sum())),
        "held_count": str(sum(r.held for r in results)),
        "one_sided_proven": str(proven),
        "synthesis_rows": table(
            (
                "mesh", "contacts", "real", "on facets", "BMI, same facets", "BMI", "gradient",
                "first SDPs", "eigenvalue ratio", "residual", "reach / bound", "hops",
            ),
            [_synthesis_row(r) for r in results],
            "llr",
        ),
        "shown_object": one.object_id,
    }  # fmt: skip


def _synthesis_row(r: SynthesisResult) -> tuple[str, ...]:
    first = r.bmi.first
    assert first is not None
    known = np.isfinite(first.reach)
    return (
        r.object_id,
        str(r.contacts),
        f"{r.real:.3f}",
        f"{r.bmi.before.quality:.3f}",
        f"{r.bmi.on_facets.quality:.3f}",
        f"{r.bmi.after.quality:.3f}",
        f"{r.gradient.after.quality:.3f}",
        f"{first.status} ({first.steps})",
        f"{first.eigenvalue_ratio:.0e}" if known else "-",
        f"{first.residual:.0e}" if known else "-",
        f"{first.reach:.3f} / {first.relaxation:.3f}" if known else "-",
        str(r.bmi.hops),
    )


def _quality(result: Reproduction) -> Fields:
    grasp = result.paper_grasp
    rows = conventions(grasp)
    shape, arbitrary = hull(grasp), arbitrary_forces(grasp)
    closed = closure(grasp, _MU_ROWS)
    agreed = [len({row.quality > 0, row.closes, row.interior_force}) == 1 for row in closed]
    commanded = quality(grasp, relative_width=0.01)
    unit = quality(grasp, forces="unit", relative_width=0.01)
    names = list(dict.fromkeys(row.length_name for row in rows))
    kinds = list(dict.fromkeys(row.forces for row in rows))
    values = {(row.forces, row.length_name, row.edges): row.lower for row in rows}
    lengths = {row.length_name: row.length for row in rows}
    return {
        "grasp_object": grasp.object_id,
        "grasp_mass": f"{grasp.mass:g}",
        "grasp_friction": f"{grasp.friction:g}",
        "grasp_held": "holds" if result.shown.held["clarabel"] else "does not hold",
        "radius": f"{1e3 * grasp.radius:.1f}",
        "q_lower": f"{commanded.lower:.4f}",
        "q_upper": f"{commanded.upper:.4f}",
        "q_unit_lower": f"{unit.lower:.4f}",
        "q_unit_upper": f"{unit.upper:.4f}",
        "q_least": f"{min(row.lower for row in rows):.2g}",
        "q_most": f"{max(row.lower for row in rows):.2g}",
        "convention_table": table(
            (
                "normal forces",
                *(
                    f"torques over {name}"
                    + ("" if name[0].isdigit() else f", {1e3 * lengths[name]:.1f} mm")
                    for name in names
                ),
            ),
            [
                (
                    kind,
                    *(
                        " / ".join(f"{values[kind, name, e]:.3g}" for e in EDGE_COUNTS)
                        for name in names
                    ),
                )
                for kind in kinds
            ],
            "lr",
        ),
        "scale_for": f"{force_scale_for(grasp):.1f}",
        "scale_limit": f"{strongest_scale(grasp):.1f}",
        "length_for": f"{1e3 * length_for(grasp):.1f}",
        "closure_table": table(
            (
                "friction",
                "q_lrw, N",
                "force closure",
                "interior internal force",
                "distance to a vertex, N",
            ),
            [
                (
                    f"{row.friction:g}",
                    f"{row.quality:.3f}",
                    yes(row.closes),
                    yes(row.interior_force),
                    f"{row.vertex_distance:.3f}",
                )
                for row in closed
            ],
            "lr",
        ),
        "closure_agreement": f"{sum(agreed)} of {len(agreed)}",
        "random_positive": str(arbitrary.positive),
        "random_count": str(arbitrary.count),
        "random_residual": f"{arbitrary.least_residual:.0%}",
        "hull_radius": f"{shape.radius:.3f}",
        "hull_force": f"{shape.force.inradius:.3f}",
        "hull_torque": f"{shape.torque.inradius:.3f}",
    }


def _slack(point: Array) -> str:
    row = np.array([float(value) for value in GRASP.row])
    return f"{float(GRASP.bound) - row @ point:.3f}"
