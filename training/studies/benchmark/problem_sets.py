"""The problem sets: by number of contacts, a mix, scaled limits, and loads near the edge."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from gfo_env.grasps import GraspTable
from solvers import GraspForceProblem, judge, make_solver
from solvers.arrays import Array, Mask
from solvers.judge import FARKAS_TOLERANCE
from training.problems.sampling import sample_problems

from .accuracy import is_accurate
from .load_factor import load_factors

LOAD_FACTORS = (0.5, 0.9, 0.99, 0.999, 0.9999, 0.99999, 1.00001, 1.0001, 1.001, 1.01, 1.1, 2.0)
"""Multiples of the largest load that a grasp can carry."""

SCALES = (0.3, 3.0)
"""Factors on friction and on torque limits."""

MIX = "mix"
CONTACT_SETS = {"3": (3, 3), "4-5": (4, 5), "6-8": (6, 8)}
"""Least and most contacts, by the set's name."""

_SPARE_EDGES = 2.0
"""Largest loads are looked for on this many times as many grasps as are wanted."""


@dataclass(frozen=True, eq=False)
class ProblemSet:
    """Problems with what is known of them.

    Args:
        name: short and unique.
        problems: one batch, numpy.
        feasible: (P,) whether forces exist.
        known: (P,) whether `feasible` is certain: by Clarabel's answer, or by the load.
        optimum: (P,) the least objective; NaN unless feasible and known.
    """

    name: str
    problems: GraspForceProblem
    feasible: Mask
    known: Mask
    optimum: Array

    def __len__(self) -> int:
        return len(self.problems)


def draw(table: GraspTable, count: int, rng: np.random.Generator) -> GraspForceProblem:
    """`count` problems on grasps of a table, each grasp as often as any other, or once more."""
    rows = np.concatenate([rng.permutation(len(table)) for _ in range(-(-count // len(table)))])
    return sample_problems(table[rows[:count]], rng)


def with_contacts(table: GraspTable, name: str) -> GraspTable | None:
    """The grasps of a contact set, or all for the mix; None if the table has none."""
    if name == MIX:
        return table
    least, most = CONTACT_SETS[name]
    counts = table.contact_mask.sum(axis=1)
    rows = np.flatnonzero((counts >= least) & (counts <= most))
    return table[rows] if len(rows) else None


def judged_set(name: str, problems: GraspForceProblem) -> ProblemSet:
    """A set whose truth is Clarabel's answer at 1e-10, where dual bound or proof confirms it."""
    candidate = make_solver("clarabel").propose(problems)
    verdict = judge(problems, candidate.forces, candidate.multipliers)
    feasible = is_accurate(problems, candidate.forces, verdict.dual_bound)
    proven = ~feasible & (verdict.farkas_value > FARKAS_TOLERANCE)
    return ProblemSet(
        name=name,
        problems=problems,
        feasible=feasible,
        known=feasible | proven,
        optimum=np.where(feasible, verdict.dual_bound, np.nan),
    )


def scaled_sets(problems: GraspForceProblem) -> list[ProblemSet]:
    """The same problems with friction, and with torque limits, scaled by each of `SCALES`."""
    sets = []
    for factor in SCALES:
        slippery: dict[str, Any] = {"friction": factor * problems.friction}
        weak = {name: factor * getattr(problems, name) for name in ("torque_min", "torque_max")}
        for field, changes in (("friction", slippery), ("torque", weak)):
            sets.append(judged_set(f"{field} x{factor:g}", problems.replace(**changes)))
    return sets


def bounded(problems: GraspForceProblem, max_torque: Array) -> GraspForceProblem:
    """The problems with the hand's own limits where a torque limit is missing."""
    limits = {
        "torque_min": np.where(np.isfinite(problems.torque_min), problems.torque_min, -max_torque),
        "torque_max": np.where(np.isfinite(problems.torque_max), problems.torque_max, max_torque),
    }
    return problems.replace(**limits)


def edge_problems(
    table: GraspTable, count: int, rng: np.random.Generator
) -> tuple[GraspForceProblem, int]:
    """Up to `count` problems loaded with the largest multiple of their load, and how many tried.

    Left out are grasps that carry no multiple (the preload alone breaks a torque limit, say), whose
    largest is not proven to `load_factor.ACCURACY`, or that need some load to be feasible.
    """
    tried = draw(table, int(_SPARE_EDGES * count), rng)
    tried = bounded(tried, table.max_torque)
    factors = load_factors(tried)
    usable = np.isfinite(factors.largest) & (factors.least < 0.5 * factors.largest)
    rows = np.flatnonzero(usable)[:count]
    load = factors.largest[rows, None] * tried.external_wrench[rows]
    return tried[rows].replace(external_wrench=load), len(tried)


def at_factor(edge: GraspForceProblem, factor: float) -> ProblemSet:
    """The set of loads at a multiple of the largest; the truth is known from the multiple."""
    problems = edge.replace(external_wrench=factor * edge.external_wrench)
    certain = np.full(len(edge), True)
    return ProblemSet(
        name=f"load x{factor:g}",
        problems=problems,
        feasible=certain if factor < 1.0 else ~certain,
        known=certain,
        optimum=np.full(len(edge), np.nan),
    )
