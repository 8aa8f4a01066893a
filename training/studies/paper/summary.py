"""The figures of a reproduction that decide on its targets, for a JSON file."""

from typing import Any

import numpy as np

from gfo_env.synthesis import Improvement
from solvers.arrays import Array
from training.reports.numbers import relative

from .reproduction import Reproduction
from .synthesis import SynthesisResult, solved_mask


def summary(result: Reproduction) -> dict[str, Any]:
    """The figures that decide on the targets; None where there is nothing to take them from."""
    gains = _gains(result.synthesis, [r.bmi for r in result.synthesis])
    solved = solved_mask(result.synthesis)
    better = [r.bmi.after.quality > r.real for r in result.synthesis]
    return {
        "benchmark_network_error": relative(
            result.benchmark.network_objective, result.benchmark.optimum
        ).tolist(),
        "benchmark_ode_error": float(
            relative(result.benchmark.ode_objective, result.benchmark.optimum)
        ),
        "lmi_mismatches": result.inequality.mismatches,
        "routes": {
            name: {
                "objective_error_median": float(np.median(route.objective_error)),
                "objective_error_max": float(np.max(route.objective_error)),
                "force_error_median": float(np.median(route.force_error)),
                "force_error_max": float(np.max(route.force_error)),
                "optimal": int(np.sum(route.status == "optimal")),
                "problems": len(route.status),
            }
            for name, route in result.routes.items()
        },
        "synthesis_objects": len(result.synthesis),
        "synthesis_solved": float(np.mean(solved)),
        "synthesis_better": float(np.mean(np.array(better)[solved])) if solved.any() else None,
        "synthesis_gain_median": float(np.median(gains)) if len(gains) else None,
    }


def _gains(results: list[SynthesisResult], moves: list[Improvement]) -> Array:
    """Relative gains of q_lrw over the real grasps, of those in force closure."""
    return np.array(
        [m.after.quality / r.real - 1.0 for r, m in zip(results, moves, strict=True) if r.real > 0]
    )
