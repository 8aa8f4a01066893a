"""Do all formulations agree? One set of real grasp problems, solved in every way that there is."""

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from rich.progress import Progress

from gfo_env.grasps import GraspTable
from gfo_env.holding import ShakeProtocol
from solvers import GraspForceProblem, make_solver, solve
from solvers.arrays import Array
from solvers.kkt import grasp_program
from solvers.paper.kkt_ode import integrate, residual
from solvers.problem import force_scale
from training.measuring.jobs import run_all
from training.problems.tasks import make_problems, make_task

LONGER = "instance_network, T = 100"
"""The network that is fitted to a longer part of the ODE."""

LONGER_COUNT = 10
"""Problems, at most, that it is fitted to."""

ROUTES: dict[str, tuple[str, dict[str, Any]]] = {
    "clarabel": ("clarabel", {}),
    "lmi, clarabel": ("lmi", {"backend": "clarabel"}),
    "lmi, scs": ("lmi", {"backend": "scs"}),
    "kkt_ode": ("kkt_ode", {}),
    "instance_network": ("instance_network", {}),
    LONGER: ("instance_network", {"horizon": 100.0}),
}
"""The formulations by name: solver and settings. The first is the reference."""

_CHUNK = 5
_PATH_TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False)
class RouteErrors:
    """How one formulation did on every problem.

    Args:
        status: (B,) by the judge.
        objective_error: (B,) |objective - optimum| / optimum, feasible or not.
        force_error: (B,) |f - f*| / |f*|, f* the reference's forces.
        balance_error: (B,) equilibrium residual over the size of the forces.
        milliseconds: per problem, judging included.
    """

    status: NDArray[np.str_]
    objective_error: Array
    force_error: Array
    balance_error: Array
    milliseconds: float


@dataclass(frozen=True, eq=False)
class OdePaths:
    """The KKT ODE of every problem, from zero.

    Args:
        times: (T,).
        residuals: (T, B) size of the field.
        force_errors: (T, B) |f - f*| / |f*|.
    """

    times: Array
    residuals: Array
    force_errors: Array


def carrying_problems(table: GraspTable, seed: int, count: int) -> GraspForceProblem:
    """(count,) problems of carrying an object's weight, as the paper has them: without preload.

    The first of the table that have a solution; mass, friction and orientation are drawn.
    """
    tasks = [make_task(seed, int(number)) for number in table.attempt]
    problems = make_problems(table, tasks, ShakeProtocol(), 0.0)[:, 0]
    feasible = solve(problems, "clarabel").status == "optimal"
    return problems[np.flatnonzero(feasible)[:count]]


def compare(
    problems: GraspForceProblem, *, workers: int = 1, progress: Progress | None = None
) -> dict[str, RouteErrors]:
    """Every route of `ROUTES` on every problem (B,), judged alike; `LONGER` on the first few.

    Args:
        problems: one batch dimension.
        workers: processes.
        progress: a bar is added to it.
    """
    calls = [
        (name, part)
        for name in ROUTES
        for part in _parts(problems[:LONGER_COUNT] if name == LONGER else problems)
    ]
    made = run_all(_solve, calls, title="formulations", workers=workers, progress=progress)
    solved = {
        name: [answer for (route, _), answer in zip(calls, made, strict=True) if route == name]
        for name in ROUTES
    }
    reference = np.concatenate([forces for forces, *_ in solved["clarabel"]])
    size = np.linalg.norm(reference, axis=1)
    figures = {}
    for name, answers in solved.items():
        forces = np.concatenate([forces for forces, *_ in answers])
        count = len(forces)
        figures[name] = RouteErrors(
            status=np.concatenate([status for _, status, *_ in answers]),
            objective_error=np.abs((np.linalg.norm(forces, axis=1) / size[:count]) ** 2 - 1.0),
            force_error=np.linalg.norm(forces - reference[:count], axis=1) / size[:count],
            balance_error=np.concatenate([error for *_, error, _ in answers]) / size[:count],
            milliseconds=1e3 * sum(seconds for *_, seconds in answers) / count,
        )
    return figures


def ode_paths(
    problems: GraspForceProblem,
    end: float,
    points: int,
    *,
    workers: int = 1,
    progress: Progress | None = None,
) -> OdePaths:
    """The ODE's way to the optimum, at `points` times up to `end`, spaced by their logarithm.

    Args:
        problems: one batch dimension.
        end: last time.
        points: how many times, zero among them.
        workers: processes.
        progress: a bar is added to it.
    """
    times = np.concatenate([[0.0], np.geomspace(1e-2, end, points - 1)])
    calls = [(part, times) for part in _parts(problems)]
    found = run_all(_path, calls, title="paths of the ODE", workers=workers, progress=progress)
    sizes, errors = (np.concatenate(parts, axis=1) for parts in zip(*found, strict=True))
    return OdePaths(times, sizes, errors)


def _parts(problems: GraspForceProblem) -> list[GraspForceProblem]:
    return [problems[start : start + _CHUNK] for start in range(0, len(problems), _CHUNK)]


def _path(problems: GraspForceProblem, times: Array) -> tuple[Array, Array]:
    """(T, B) sizes of the field, and errors of the forces."""
    program = grasp_program(problems.to_torch())
    with torch.no_grad():
        path = integrate(program, torch.from_numpy(times), tolerance=_PATH_TOLERANCE)
        sizes = torch.stack([residual(program, x, u) for x, u in zip(path.x, path.u, strict=True)])
    exact = solve(problems, "clarabel").forces
    forces = path.x.numpy() * force_scale(problems)[:, None]
    return sizes.numpy(), np.linalg.norm(forces - exact, axis=-1) / np.linalg.norm(exact, axis=-1)


def _solve(name: str, problems: GraspForceProblem) -> tuple[Array, NDArray[np.str_], Array, float]:
    solver, settings = ROUTES[name]
    made = make_solver(solver, **settings)
    started = time.perf_counter()
    solution = made.solve(problems)
    seconds = time.perf_counter() - started
    residuals = np.asarray(solution.verdict.equilibrium_residual)
    return np.asarray(solution.forces), solution.status, residuals, seconds
