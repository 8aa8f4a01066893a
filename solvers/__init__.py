"""Grasp force optimisation: problems, certified answers, and the solvers that find them."""

from .base import Solver
from .exceptions import (
    GraspForceError,
    MissingDependencyError,
    ProblemError,
    SolverError,
    UnknownSolverError,
)
from .judge import Status, Verdict, judge
from .problem import OBJECTIVES, GraspForceProblem, Multipliers
from .registry import available_solvers, make_solver, solve
from .solution import Candidate, GraspForceSolution

__all__ = [
    "OBJECTIVES",
    "Candidate",
    "GraspForceError",
    "GraspForceProblem",
    "GraspForceSolution",
    "MissingDependencyError",
    "Multipliers",
    "ProblemError",
    "Solver",
    "SolverError",
    "Status",
    "UnknownSolverError",
    "Verdict",
    "available_solvers",
    "judge",
    "make_solver",
    "solve",
]
