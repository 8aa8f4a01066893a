"""How far the environment's q_lrw is from refined hulls, and what pyramids of few edges give."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gfo_env.contacts import Contacts, lowest_resisted_wrench, quality_estimate
from gfo_env.env import GraspForceEnv
from gfo_env.exceptions import QualityError
from gfo_env.mdp.observation import unpack
from gfo_env.policy import SolverPolicy
from solvers.arrays import Array

from .recording import SOLVER

WIDTH = 0.01
"""Relative width of the intervals that refined hulls give."""

EDGES = (4, 8)


@dataclass(frozen=True)
class Deviation:
    """Relative deviations from refined hulls, and what a value costs.

    Args:
        median, p90, p99, largest: of the size of the deviation, where q_lrw is positive.
        microseconds: median time of a value.
    """

    median: float
    p90: float
    p99: float
    largest: float
    microseconds: float


@dataclass(frozen=True)
class EstimateErrors:
    """q_lrw of the forces of one kind.

    Args:
        forces: what they are.
        grasps: that were measured.
        undecided: left out, because refinement found no interval of 1 %.
        zero: share of grasps whose q_lrw is 0.
        disagreeing: grasps for which only one of estimate and hull is 0.
        estimate: how far it is above the lower end of the interval, 1 % of its width included.
        four, eight: how far pyramids of so many edges are below the upper end.
        refined_microseconds: median time of an interval.
    """

    forces: str
    grasps: int
    undecided: int
    zero: float
    disagreeing: int
    estimate: Deviation
    four: Deviation
    eight: Deviation
    refined_microseconds: float


LEAST_NORM, RANDOM = "least-norm forces", "random normal forces"


@dataclass(frozen=True, eq=False)
class _Case:
    """One grasp with its forces.

    Args:
        lower, upper: N, of the refined hull; NaN if refinement did not end.
        values: (3,) N, of the estimate and of the pyramids.
        seconds: (4,) of these, and of the refined hull.
    """

    lower: float
    upper: float
    values: Array
    seconds: Array


def accuracy(
    count: int, seed: int, table: Path | None, step: Callable[[], None]
) -> list[EstimateErrors]:
    """Compare on held-out grasps, each under a load of its own, with two kinds of forces.

    Args:
        count: grasps, drawn with replacement.
        seed: of the draws.
        table: of held-out grasps; None for the user's cache.
        step: called after each grasp.
    """
    env = GraspForceEnv(split="test", mode="static", grasps=table)
    most = env.settings.max_force
    policy = SolverPolicy(SOLVER)
    rng = np.random.default_rng(seed)
    found: dict[str, list[_Case]] = {LEAST_NORM: [], RANDOM: []}
    env.reset(seed=seed)
    for _ in range(count):
        observation, info = env.reset()
        action, _ = policy.predict(observation)
        stored = env.grasps.grasp(info["grasp"])
        assert stored is not None
        contacts = stored.grasp.contacts.strongest(env.settings.max_contacts)
        friction = unpack(observation)["friction"][: len(contacts)]
        solved = most * np.maximum(action[2::3][: len(contacts)].astype(np.float64), 0.0)
        drawn = rng.uniform(0.0, most, len(contacts))
        found[LEAST_NORM].append(_case(contacts, friction, solved, stored.radius))
        found[RANDOM].append(_case(contacts, friction, drawn, stored.radius))
        step()
    env.close()
    return [_figures(kind, cases) for kind, cases in found.items()]


def _case(contacts: Contacts, friction: Array, forces: Array, length: float) -> _Case:
    def hull(edges: int, width: float | None = None) -> tuple[float, float]:
        found = lowest_resisted_wrench(
            contacts.positions,
            contacts.normals,
            friction,
            normal_forces=forces,
            length=length,
            edges=edges,
            relative_width=width,
        )
        return found.lower, found.upper

    times = [time.perf_counter()]
    values = [quality_estimate(contacts.grasp_map, friction, forces, length)]
    times.append(time.perf_counter())
    for edges in EDGES:
        values.append(hull(edges)[0])
        times.append(time.perf_counter())
    try:
        lower, upper = hull(4, WIDTH)
    except QualityError:
        lower = upper = np.nan
    times.append(time.perf_counter())
    return _Case(lower, upper, np.array(values), np.diff(times))


def _figures(kind: str, cases: list[_Case]) -> EstimateErrors:
    decided = [case for case in cases if np.isfinite(case.upper)]
    lower = np.array([case.lower for case in decided])
    upper = np.array([case.upper for case in decided])
    values = np.array([case.values for case in decided]).reshape(-1, 1 + len(EDGES))
    micro = 1e6 * np.median([case.seconds for case in cases], axis=0)
    positive = lower > 0.0
    # the estimate is an upper bound, pyramids are lower bounds: each from the far end
    above = values[positive, 0] / lower[positive] - 1.0
    below = 1.0 - values[positive, 1:] / upper[positive, None]
    return EstimateErrors(
        forces=kind,
        grasps=len(cases),
        undecided=len(cases) - len(decided),
        zero=float(np.mean(upper == 0.0)) if decided else 0.0,
        disagreeing=int(np.sum((values[:, 0] == 0.0) != (upper == 0.0))),
        estimate=_deviation(above, micro[0]),
        four=_deviation(below[:, 0], micro[1]),
        eight=_deviation(below[:, 1], micro[2]),
        refined_microseconds=float(micro[-1]),
    )


def _deviation(sizes: Array, microseconds: float) -> Deviation:
    quantiles = np.percentile(sizes, [50, 90, 99, 100]) if len(sizes) else np.zeros(4)
    median, p90, p99, largest = map(float, quantiles)
    return Deviation(median, p90, p99, largest, float(microseconds))
