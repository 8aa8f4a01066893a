"""Everything that the paper's reproduction measures, in one object."""

from contextlib import closing
from dataclasses import dataclass

import numpy as np
from rich.progress import Progress

from gfo_env.conditions import PRELOAD
from gfo_env.grasps.collection import CollectionPlan, collect
from gfo_env.holding import ShakeProtocol, shake
from gfo_env.objects import RANDOM_URDFS, ObjectSet
from gfo_env.simulation import Simulation
from gfo_env.workers import bar
from solvers import GraspForceError, GraspForceProblem, solve
from solvers.kkt import grasp_program
from solvers.paper.instance_network import InstanceFit, fit
from training.demonstration import Shown
from training.problems.tasks import Task, pose_problem

from .agreement import OdePaths, RouteErrors, carrying_problems, compare, ode_paths
from .examples import BenchmarkSolutions, GraspSolutions, solve_benchmark, solve_grasp_program
from .forms import InequalityCheck, check_inequality, field_difference
from .synthesis import SynthesisResult, compare_routes
from .three_fingers import PaperGrasp, acquire

ODE_END = 1000.0
"""Time to which the ODE is drawn."""

_ODE_POINTS = 80
_SPARE = 2.0
"""Grasps are collected for this many times as many problems as are wanted."""


class ReproductionError(GraspForceError, ValueError):
    """What is to be reproduced makes no sense."""


@dataclass(frozen=True)
class ReproductionPlan:
    """How much to reproduce.

    Args:
        grasps: real grasp problems on which the formulations must agree.
        objects: held-out objects on which contacts are synthesised.
        seed: of everything.

    Raises:
        ReproductionError: there are none of either, more objects than the set has, or a negative
            seed.
    """

    grasps: int = 50
    objects: int = 30
    seed: int = 0

    def __post_init__(self) -> None:
        most = len(ObjectSet(RANDOM_URDFS, "test"))
        if self.grasps < 1:
            raise ReproductionError(f"grasps is {self.grasps}; it must be 1 or more")
        if not 1 <= self.objects <= most:
            raise ReproductionError(f"objects is {self.objects}; it must be between 1 and {most}")
        if self.seed < 0:
            raise ReproductionError(f"seed is {self.seed}; it must be 0 or more")


@dataclass(frozen=True, eq=False)
class Reproduction:
    """The results of a reproduction; see the modules that make them.

    Args:
        plan: that made them.
        benchmark: the LP of equation 39.
        grasp_program: the LP of equation 40.
        field_difference: of the conic field from the paper's phi.
        problems: (grasps,) real grasp problems, without preload.
        inequality: D(x) >= 0 against the cones.
        paths: the ODE on `problems`.
        routes: every formulation on `problems`.
        barrett: the per-instance network of the first of them.
        objects: of the synthesis.
        synthesis: contact synthesis, one result an object.
        paper_grasp: a grasp as in the paper.
        shown: the same, held in the simulator with exact forces.
    """

    plan: ReproductionPlan
    benchmark: BenchmarkSolutions
    grasp_program: GraspSolutions
    field_difference: float
    problems: GraspForceProblem
    inequality: InequalityCheck
    paths: OdePaths
    routes: dict[str, RouteErrors]
    barrett: InstanceFit
    objects: ObjectSet
    synthesis: list[SynthesisResult]
    paper_grasp: PaperGrasp
    shown: Shown


def reproduce(
    plan: ReproductionPlan, *, workers: int = 1, progress: Progress | None = None
) -> Reproduction:
    """Measure everything; minutes.

    Args:
        plan: how much.
        workers: processes.
        progress: bars are added to it.
    """
    objects = ObjectSet(RANDOM_URDFS, "test")
    count = max(int(_SPARE * plan.grasps), int(_SPARE * plan.objects))
    table, _ = collect(
        CollectionPlan(objects, count, plan.seed), workers=workers, progress=progress
    )
    problems = carrying_problems(table, plan.seed, plan.grasps)
    done = bar(progress, "printed examples", 3)
    benchmark = solve_benchmark(tuple(range(plan.seed, plan.seed + 3)))
    done()
    grasp_program_ = solve_grasp_program(plan.seed)
    done()
    first = problems[:1].to_torch()[0].without_padding()
    barrett = fit(grasp_program(first), seed=plan.seed)
    done()
    paper_grasp = acquire(plan.seed)
    return Reproduction(
        plan=plan,
        benchmark=benchmark,
        grasp_program=grasp_program_,
        field_difference=field_difference(plan.seed),
        problems=problems,
        inequality=check_inequality(problems, plan.seed),
        paths=ode_paths(problems, ODE_END, _ODE_POINTS, workers=workers, progress=progress),
        routes=compare(problems, workers=workers, progress=progress),
        barrett=barrett,
        objects=objects,
        synthesis=compare_routes(objects, table, plan.objects, workers=workers, progress=progress),
        paper_grasp=paper_grasp,
        shown=_hold(paper_grasp),
    )


def _hold(paper_grasp: PaperGrasp) -> Shown:
    """Shake the paper's grasp with exact forces, as the demonstration does."""
    task = Task(paper_grasp.mass, paper_grasp.friction, paper_grasp.gravity)
    problem = pose_problem(paper_grasp.grasp, task, ShakeProtocol(), PRELOAD)
    solution = solve(problem, "clarabel")
    forces = np.nan_to_num(solution.forces)
    with closing(Simulation()) as simulation:
        outcome = shake(
            simulation,
            paper_grasp.grasp,
            paper_grasp.grasp_object.with_mass(task.mass),
            forces,
            task.gravity,
            friction=task.friction,
        )
    return Shown(
        number=paper_grasp.attempt,
        grasp=paper_grasp.grasp,
        grasp_object=paper_grasp.grasp_object,
        task=task,
        solutions={"clarabel": solution},
        quality={},
        held={"clarabel": outcome.held},
    )
