"""See it work: grasp meshes that the network never saw, solve for the forces, hold them, draw it.

Example: python scripts/demo.py --grasps 8 --picture demo.png
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scripts._cli import bars, run_cli, write_json


@dataclass(frozen=True)
class DemoSettings:
    """Grasp meshes that the network never saw, solve for the forces, hold them, draw it."""

    grasps: int = 8
    """How many held-out meshes to grasp."""
    seed: int = 0
    """Seed of everything."""
    picture: Path = Path("demo.png")
    """Where the picture goes (PNG)."""
    json: Path | None = None
    """Write the figures here."""


_EXACT, _NETWORK = "exact", "network"
_WORST_FIRST = ("failed", "infeasible", "feasible", "optimal")
_ROWS_DRAWN = 2


def main(settings: DemoSettings) -> None:
    """Grasp, solve, hold, print, draw."""
    import numpy as np
    from rich.console import Console
    from rich.table import Table

    from gfo_env.objects import ObjectSet
    from solvers import make_solver
    from training.demonstration import demonstrate, draw

    settings.picture.parent.mkdir(parents=True, exist_ok=True)
    console = Console()
    objects = ObjectSet("random_urdfs", "test")
    solvers = {
        _EXACT: make_solver("clarabel"),
        _NETWORK: make_solver("conditioned", polish_steps=0, fallback=None),
    }
    console.print(
        f"Grasping {settings.grasps} of {len(objects)} held-out meshes with a simulated Barrett "
        "hand. Each carries its weight, then a 2 N push from six sides."
    )
    with bars(console) as progress:
        shown = demonstrate(objects, solvers, settings.grasps, settings.seed, progress)
    table = Table(title="Worst of the seven loads of each grasp")
    table.add_column("mesh", no_wrap=True)
    table.add_column("solver")
    table.add_column("status")
    for heading in ("balance\nerror N", "friction\nerror N", "gap", "q_lrw\nN", "held"):
        table.add_column(heading, justify="right")
    rows: list[dict[str, Any]] = []
    for one in shown:
        for name, solution in one.solutions.items():
            verdict = solution.verdict
            certified = bool(np.all(np.isfinite(solution.gap)))
            row = {
                "mesh": one.grasp_object.object_id,
                "contacts": len(one.grasp.contacts),
                "solver": name,
                "status": next(s for s in _WORST_FIRST if s in solution.status),
                "equilibrium_residual": float(np.max(verdict.equilibrium_residual)),
                "friction_violation": float(np.max(verdict.friction_violation)),
                "gap": float(np.max(solution.gap)) if certified else None,
                "q_lrw": one.quality[name],
                "held": one.held[name],
            }
            rows.append(row)
            first = name == _EXACT
            table.add_row(
                str(row["mesh"]) if first else f"{row['contacts']} contacts",
                name,
                str(row["status"]),
                f"{row['equilibrium_residual']:.0e}",
                f"{row['friction_violation']:.0e}",
                "-" if row["gap"] is None else f"{row['gap']:.0e}",
                f"{row['q_lrw']:.2f}",
                "[green]yes" if row["held"] else "[red]no",
                end_section=not first,
            )
    console.print(table)
    write_json(settings.json, rows)
    held = [one for one in shown if all(one.held.values())] or shown
    with console.status("drawing"):
        draw(held[:_ROWS_DRAWN], _NETWORK, settings.seed, settings.picture)
    console.print(
        "gap: a proof that no forces need less effort than these, but for this share.\n"
        "q_lrw: the least disturbance that the forces for the weight cannot resist."
    )
    console.print(f"Picture, with the network's forces: {settings.picture}")


if __name__ == "__main__":
    run_cli(DemoSettings, main)
