"""Solve every problem of the study by every method, and keep what is finished."""

import hashlib
import json
import math
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from joblib import delayed
from rich.progress import Progress

from gfo_env.grasps.collection import CollectionPlan, collect
from gfo_env.objects import ObjectSet
from gfo_env.workers import bar, worker_pool
from solvers import GraspForceProblem, Solver, Status
from solvers.exact.dual_newton import DualNewtonSolver
from solvers.files import make_folder, write_text
from solvers.max_quality.learned import DEFAULT_QUALITY_WEIGHTS, QualitySolver
from solvers.max_quality.network import QualityNetwork
from solvers.max_quality.preload import effort
from solvers.max_quality.search import QualitySearchSolver
from solvers.max_quality.uniform import UniformPreloadSolver
from solvers.solution import Candidate

from .plan import QualityStudyError, QualityStudyPlan
from .problems import StudyProblems, study_problems
from .squeeze import NearestSqueezeSolver

REFERENCE, NETWORK, FLOW = "quality_search", "quality", "untrained"
EVEN, SQUEEZE, LEAST = "uniform_preload", "nearest_squeeze", "least_norm"
METHODS = (LEAST, SQUEEZE, EVEN, FLOW, NETWORK, REFERENCE)

PRICED = (EVEN, FLOW, NETWORK)
"""Methods that are asked where effort has a price; the reference would take minutes each."""

_AT_ONCE = 2
_ROWS, _PLAN = "rows.jsonl", "plan.json"

Row = dict[str, Any]


class LeastNormSolver(Solver):
    """The forces of least norm, whatever the budget allows beyond them."""

    objectives = ("max_quality",)

    def propose(self, problem: GraspForceProblem) -> Candidate:
        """As `dual_newton`."""
        return DualNewtonSolver().propose(problem.constraints())


@dataclass(frozen=True)
class Job:
    """Problems of one set.

    Args:
        number: of the set, in the order of the plan.
        first: index of the first problem.
        problems: two, at the budget of the least-norm forces.
    """

    number: int
    first: int
    problems: StudyProblems


def run_study(plan: QualityStudyPlan, progress: Progress | None = None) -> list[Row]:
    """One row for each problem, budget or price, and method.

    Raises:
        QualityStudyError: if the folder holds another study, or a set has no problem.
        GraspTableError, MeshError: from the acquisition.
    """
    done = _resume(plan)
    jobs = []
    for number, (name, split) in enumerate(plan.sets):
        objects = ObjectSet(name, split=split)
        table, _ = collect(
            CollectionPlan(objects, plan.grasps, plan.seed), workers=plan.workers, progress=progress
        )
        posed = study_problems(table, plan.seed)
        for first in range(0, len(posed.owners), _AT_ONCE):
            rows = np.arange(first, min(first + _AT_ONCE, len(posed.owners)))
            jobs.append(Job(number, first, StudyProblems(posed.problem[rows], posed.owners[rows])))
    left = [job for job in jobs if (job.number, job.first) not in done]
    step = bar(progress, "compare", len(jobs))
    step(len(jobs) - len(left))
    with worker_pool(plan.workers) as pool, (plan.output / _ROWS).open("a") as kept:
        for rows in pool(delayed(answer_job)(plan, job) for job in left):
            kept.write(json.dumps(rows) + "\n")
            kept.flush()
            step()
    lines = (plan.output / _ROWS).read_text().splitlines()
    return [row for line in lines for row in json.loads(line)]


def answer_job(plan: QualityStudyPlan, job: Job) -> list[Row]:
    """The rows of a job."""
    posed = job.problems
    rows = []
    for times in plan.times:
        problem = posed.budget(times)
        for method in METHODS:
            rows += _rows(job, plan, problem, method, times, 0.0)
    for price in plan.prices:
        problem = posed.budget(max(plan.times)).derived(
            effort_weight=np.full(len(posed.owners), price)
        )
        for method in PRICED:
            rows += _rows(job, plan, problem, method, max(plan.times), price)
    return rows


def _rows(
    job: Job,
    plan: QualityStudyPlan,
    problem: GraspForceProblem,
    method: str,
    times: float,
    price: float,
) -> list[Row]:
    solution = _solver(method, plan).solve(problem)
    candidate_effort = effort(np.nan_to_num(np.asarray(solution.forces)))
    verdict = solution.verdict
    lower, upper = verdict.quality_lower, verdict.quality_upper
    assert lower is not None
    assert upper is not None
    least = problem.effort_budget / times
    name, split = plan.sets[job.number]
    return [
        {
            "set": job.number,
            "objects": name,
            "split": split,
            "object": str(job.problems.owners[index]),
            "problem": job.first + index,
            "method": method,
            "times": times,
            "price": price,
            "feasible": bool(
                solution.status[index] in (Status.FEASIBLE.value, Status.OPTIMAL.value)
            ),
            "effort": float(candidate_effort[index] / least[index]),
            "least_effort": float(least[index]),
            "lower": _number(lower[index]),
            "upper": _number(upper[index]),
            "worth": _number(-solution.objective[index]),
            "bound": _number(-solution.dual_bound[index]) if method == REFERENCE else None,
        }
        for index in range(len(problem))
    ]


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _solver(method: str, plan: QualityStudyPlan) -> Solver:
    if method == FLOW:
        return QualitySolver(untrained())
    makers: dict[str, Any] = {
        LEAST: LeastNormSolver,
        SQUEEZE: NearestSqueezeSolver,
        EVEN: UniformPreloadSolver,
        NETWORK: QualitySolver,
        REFERENCE: lambda: QualitySearchSolver(rounds=plan.rounds),
    }
    return makers[method]()


def untrained() -> QualityNetwork:
    """The network with its first weights: the flow, and a random change of it, at every step."""
    import torch

    torch.manual_seed(0)
    return QualityNetwork()


def _resume(plan: QualityStudyPlan) -> set[tuple[int, int]]:
    """The jobs that the folder has already.

    Raises:
        QualityStudyError: if they are another plan's, or of other weights.
    """
    make_folder(plan.output)
    kept = ("folders", "grasps", "times", "prices", "rounds", "seed")
    asked = {name: getattr(plan, name) for name in kept}
    weights = hashlib.sha256(DEFAULT_QUALITY_WEIGHTS.read_bytes()).hexdigest()
    text = json.dumps({**asked, "weights": weights}, default=str, sort_keys=True)
    known = plan.output / _PLAN
    if known.exists() and known.read_text() != text:
        raise QualityStudyError(
            f"{plan.output} holds a study of other settings or weights: choose another folder, "
            "or delete it"
        )
    write_text(known, text)
    rows = plan.output / _ROWS
    if not rows.exists():
        return set()
    found = {}
    for line in rows.read_text(errors="replace").splitlines():
        # a line that a kill cut short, or that is damaged, is measured anew
        with suppress(ValueError, TypeError, KeyError, IndexError, RecursionError):
            first = json.loads(line)[0]
            found[first["set"], first["problem"]] = line
    write_text(rows, "".join(f"{line}\n" for line in found.values()))
    return set(found)
