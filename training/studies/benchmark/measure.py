"""Measuring entrants on problem sets: interleaved times, judged answers, wrong statuses."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from solvers import GraspForceProblem
from solvers.arrays import Array, Mask
from training.measuring.timing import pinned

from .accuracy import is_accurate, relative_residuals
from .entrants import Entrant, Run
from .problem_sets import ProblemSet

FALLBACK_WORDS = "answered by"
"""Part of the message of an answer that an exact solver handed on to another."""

FAILURE_SECONDS = 1e-2
"""What an unsettled problem counts as in the shifted geometric mean: time to ask another solver."""


@dataclass(frozen=True, eq=False)
class Measured:
    """What an entrant did on a set. Times are s per problem, one a block.

    Args:
        rows: (P,) which problems of the set it was given.
        alone: (blocks,) see `entrants`.
        converted: (blocks,).
        judged: (blocks,).
        status: (P,) judged.
        gap: (P,) certified; NaN unless feasible.
        balance: (P,) equilibrium residual of the proposed forces, over the force scale.
        violation: (P,) of the proposed forces: largest violation of a cone, preload, cap (over the
            force scale) or torque limit (over scale and moment arm of the joint). Both are NaN
            where no forces exist, or none were proposed.
        wrong: (P,) the status contradicts what is known.
        fallen_back: (P,) the answer's message says that another method gave it.
        settled: (P,) proven infeasible, or answered accurately (`accuracy`) by the proposed
            forces themselves.
        penalised: (blocks,) `converted`, with `FAILURE_SECONDS` for each problem not settled.
    """

    rows: NDArray[np.intp]
    alone: Array
    converted: Array
    judged: Array
    status: NDArray[np.str_]
    gap: Array
    balance: Array
    violation: Array
    wrong: Mask
    fallen_back: Mask
    settled: Mask
    penalised: Array

    def share(self, *status: str) -> float:
        """The share of its problems that ended so."""
        return float(np.mean(np.isin(self.status, status)))


Results = dict[str, Measured]

ENOUGH = 1.5
"""s on one set, after which an entrant's remaining blocks of it are left out."""


def measure(
    entrants: Sequence[Entrant],
    problem_set: ProblemSet,
    block: int,
    advance: Callable[[], None] = lambda: None,
) -> Results:
    """Run every entrant on every block of a set, in turn, and judge.

    Args:
        entrants: who; each block begins with another of them.
        problem_set: problems, cut into blocks in their order.
        block: problems a block.
        advance: called after each block.
    """
    runs: dict[str, list[tuple[NDArray[np.intp], Run]]] = {each.key: [] for each in entrants}
    spent = dict.fromkeys(runs, 0.0)
    starts = range(0, len(problem_set), block)
    for number, start in enumerate(starts):
        rows = np.arange(start, min(start + block, len(problem_set)))
        for turn in range(len(entrants)):
            entrant = entrants[(turn + number) % len(entrants)]
            mine = rows[problem_set.feasible[rows]] if entrant.feasible_only else rows
            if len(mine) and spent[entrant.key] < ENOUGH:
                run = timed(entrant, problem_set.problems[mine])
                runs[entrant.key].append((mine, run))
                spent[entrant.key] += run.judged
        advance()
    return {key: _gather(problem_set, done) for key, done in runs.items() if done}


def timed(entrant: Entrant, problem: GraspForceProblem) -> Run:
    """One run on the entrant's number of cores, after one that pays for what a first call costs."""
    with pinned(entrant.threads):
        entrant.warm(problem)
        return entrant.run(problem)


def _gather(problem_set: ProblemSet, runs: list[tuple[NDArray[np.intp], Run]]) -> Measured:
    rows = np.concatenate([mine for mine, _ in runs])
    problems = problem_set.problems[rows]
    status = np.concatenate([run.solution.status for _, run in runs])
    forces = np.concatenate([run.candidate.forces for _, run in runs])
    message = np.concatenate([run.candidate.message for _, run in runs])
    sizes = np.array([len(mine) for mine, _ in runs])
    converted = np.array([run.converted for _, run in runs]) / sizes
    forces = np.where(problem_set.feasible[rows, None], forces, np.nan)
    balance, violation = relative_residuals(problems, forces)
    bound = np.concatenate([run.solution.verdict.dual_bound for _, run in runs])
    accurate = is_accurate(problems, forces, bound)
    settled = accurate | np.isin(status, ("optimal", "infeasible"))
    left = [1.0 - np.mean(part) for part in np.split(settled, np.cumsum(sizes)[:-1])]
    says_feasible = np.isin(status, ("optimal", "feasible"))
    contradicted = np.where(problem_set.feasible[rows], status == "infeasible", says_feasible)
    return Measured(
        rows=rows,
        alone=np.array([run.alone for _, run in runs]) / sizes,
        converted=converted,
        judged=np.array([run.judged for _, run in runs]) / sizes,
        status=status,
        gap=np.concatenate([np.asarray(run.solution.gap) for _, run in runs]),
        balance=balance,
        violation=violation,
        wrong=contradicted & problem_set.known[rows],
        fallen_back=np.char.find(message.astype(np.str_), FALLBACK_WORDS) >= 0,
        settled=settled,
        penalised=converted + FAILURE_SECONDS * np.array(left),
    )
