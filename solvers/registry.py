"""The solvers by name, loaded only when asked for, so that optional packages stay optional."""

from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from typing import Any

from solvers.base import Solver
from solvers.exceptions import MissingDependencyError, SolverError, UnknownSolverError
from solvers.problem import GraspForceProblem, as_problem
from solvers.solution import GraspForceSolution


@dataclass(frozen=True)
class _Entry:
    module: str
    name: str
    needs: tuple[str, ...] = ()


_SOLVERS = {
    "dual_newton": _Entry("exact.dual_newton", "DualNewtonSolver", ("numba",)),
    "clarabel": _Entry("exact.clarabel_", "ClarabelSolver", ("clarabel",)),
    "interior_point": _Entry("exact.interior_point", "InteriorPointSolver", ("numba",)),
    "lmi": _Entry("paper.lmi", "LmiSolver", ("cvxpy", "clarabel")),
    "conditioned": _Entry("learned.conditioned", "ConditionedSolver", ("torch", "safetensors")),
    "dual_newton_torch": _Entry("exact.dual_newton_torch", "DualNewtonTorchSolver", ("torch",)),
    "kkt_ode": _Entry("paper.kkt_ode", "KktOdeSolver", ("torch", "torchdiffeq")),
    "instance_network": _Entry("paper.instance_network", "InstanceNetworkSolver", ("torch",)),
    "quality": _Entry("max_quality.learned", "QualitySolver", ("torch", "safetensors", "numba")),
    "quality_search": _Entry("max_quality.search", "QualitySearchSolver", ("numba", "clarabel")),
    "uniform_preload": _Entry("max_quality.uniform", "UniformPreloadSolver", ("numba",)),
    "pseudoinverse": _Entry("heuristics", "PseudoinverseSolver"),
    "equal_squeeze": _Entry("heuristics", "EqualSqueezeSolver"),
}


def available_solvers() -> tuple[str, ...]:
    """Names of the solvers whose packages are installed, in the order of trust."""
    return tuple(name for name, entry in _SOLVERS.items() if not _missing(entry))


def make_solver(name: str, **settings: Any) -> Solver:
    """The solver registered as `name`, with its settings.

    Raises:
        UnknownSolverError: if there is none of that name.
        MissingDependencyError: if it needs a package that is not installed.
        SolverError: if it has no such setting.
    """
    entry = _SOLVERS.get(name) if isinstance(name, str) else None
    if entry is None:
        raise UnknownSolverError(
            f"unknown solver {name!r}; available here: {', '.join(available_solvers())}"
        )
    missing = _missing(entry)
    if missing:
        raise MissingDependencyError(
            f"the solver {name!r} needs {' and '.join(missing)}; install with: "
            f"pip install {' '.join(missing)}"
        )
    factory = getattr(import_module(f".{entry.module}", __package__), entry.name)
    try:
        solver: Solver = factory(**settings)
    except TypeError as error:
        raise SolverError(f"the solver {name!r} does not take these settings: {error}") from error
    return solver


def solve(
    problem: GraspForceProblem, solver: str | Solver = "dual_newton", **settings: Any
) -> GraspForceSolution:
    """Solve one problem or a batch of them, and judge the answer.

    Args:
        problem: single or batched, numpy or torch.
        solver: a name of `available_solvers()`, or any `Solver`.
        settings: passed to the solver of that name.

    Raises:
        ProblemError: for what is no problem.
        UnknownSolverError, MissingDependencyError: see `make_solver`.
        SolverError: for settings or an objective that the solver lacks.
    """
    if isinstance(solver, str):
        solver = make_solver(solver, **settings)
    elif isinstance(solver, type) or not callable(getattr(solver, "solve", None)):
        raise SolverError(
            f"a solver is a name or an object with solve(problem), not {type(solver).__name__}"
        )
    elif settings:
        raise SolverError("settings belong to a solver's name; this solver is already made")
    return solver.solve(as_problem(problem))


def _missing(entry: _Entry) -> list[str]:
    return [package for package in entry.needs if find_spec(package) is None]
