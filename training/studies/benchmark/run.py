"""Everything that the benchmark measures, in one object."""

from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray
from rich.progress import Progress

from gfo_env.grasps import GraspTable
from gfo_env.workers import bar
from solvers import GraspForceProblem, available_solvers
from training.measuring.machine import cuda_is_there
from training.measuring.timing import usable_cores

from . import gpu, polygons
from .batches import SIZES, BatchResults, BatchTimes, batch_times, repetitions
from .conic import BenchmarkError
from .entrants import EntrantFacts, absent, own_entrants, peer_entrants
from .gpu import DeviceThroughput
from .measure import Results, measure
from .network_accuracy import NetworkAccuracy, network_accuracy
from .polygons import PolygonErrors
from .problem_sets import (
    CONTACT_SETS,
    LOAD_FACTORS,
    MIX,
    ProblemSet,
    at_factor,
    draw,
    edge_problems,
    judged_set,
    scaled_sets,
    with_contacts,
)

PACKAGES = ("numpy", "scipy", "numba", "torch", "clarabel")
"""Whose versions decide how fast it is."""

BLOCK = 64
"""Problems that are solved in one call, or one after the other, between two looks at the clock."""

_AUDITED = (0.9, 0.99, 0.999, 1.001, 1.01, 1.1)
_LARGEST_BATCH = 128
"""Batches are at most this many times the number of grasps."""


@dataclass(frozen=True)
class BenchmarkPlan:
    """How much to measure.

    Args:
        grasps: problems of the mix; all other counts follow from it.
        seed: of all draws.
        table: file of held-out grasps; they are collected if there is none.
        train_table: file of grasps of training objects; likewise.
        workers: processes that collect.

    Raises:
        BenchmarkError: there are no grasps, no worker, or a negative seed.
    """

    grasps: int = 512
    seed: int = 0
    table: Path | None = None
    train_table: Path | None = None
    workers: int = 1

    def __post_init__(self) -> None:
        if self.grasps < 1:
            raise BenchmarkError(f"grasps is {self.grasps}; it must be 1 or more")
        if self.seed < 0:
            raise BenchmarkError(f"seed is {self.seed}; it must be 0 or more")
        if self.workers < 1:
            raise BenchmarkError(f"workers is {self.workers}; it must be 1 or more")

    @property
    def batch_sizes(self) -> tuple[int, ...]:
        """The batch sizes that are worth it."""
        return tuple(size for size in SIZES if size <= max(1, _LARGEST_BATCH * self.grasps))


@dataclass(frozen=True, eq=False)
class SetFacts:
    """What a page says of a problem set.

    Args:
        contacts: the fewest and the most of a problem.
        feasible: (P,) which problems have a solution.
        known: share of the problems for which that is certain.
    """

    contacts: tuple[int, int]
    feasible: NDArray[np.bool_]
    known: float

    @classmethod
    def of(cls, problem_set: ProblemSet) -> Self:
        """Those of a set."""
        counts = problem_set.problems.contact_mask.sum(axis=-1)
        known = float(np.mean(problem_set.known))
        return cls((int(counts.min()), int(counts.max())), problem_set.feasible, known)


@dataclass(frozen=True, eq=False)
class Benchmark:
    """The results of a benchmark; see the modules that make them.

    Args:
        plan: that made them.
        grasps, objects: how many are held out.
        entrants: who took part.
        absent: who could not.
        sets: the problem sets by name: contacts, mix, scaled limits, loads.
        results: by set, then by entrant's key.
        edge_tried: grasps whose largest load was looked for.
        edge_kept: of these, how many are used.
        batches: by entrant's key and batch size.
        network: its accuracy; None where there is no network.
        polygons: of the audit, by set.
        device: figures on a GPU, empty without one.
    """

    plan: BenchmarkPlan
    grasps: int
    objects: int
    entrants: list[EntrantFacts]
    absent: list[str]
    sets: dict[str, SetFacts]
    results: dict[str, Results]
    edge_tried: int
    edge_kept: int
    batches: BatchResults
    network: NetworkAccuracy | None
    polygons: dict[str, list[PolygonErrors]]
    device: list[DeviceThroughput]

    def batch(self, key: str, size: int) -> BatchTimes | None:
        """Times of an entrant at a batch size; None if it has none."""
        return self.batches.get(key, {}).get(size)


def run_benchmark(plan: BenchmarkPlan, progress: Progress) -> Benchmark:
    """Measure everything.

    Args:
        plan: how much.
        progress: bars are added to it.

    Raises:
        GraspTableError: for a table that cannot be read.
        MeshError: if grasps must be collected and an object cannot be read.
    """
    rng = np.random.default_rng(plan.seed)
    table = _grasps(plan, plan.table, "test", progress)
    wants_network = "conditioned" in available_solvers()
    train = _grasps(plan, plan.train_table, "train", progress) if wants_network else None
    cores = len(usable_cores())
    entrants = [*peer_entrants(cores), *own_entrants(cores)]

    step = bar(progress, "problem sets", 4)
    half, quarter = -(-plan.grasps // 2), -(-plan.grasps // 4)
    sets = {MIX: judged_set(MIX, draw(table, plan.grasps, rng))}
    for name in CONTACT_SETS:
        part = with_contacts(table, name)
        if part is not None:
            sets[name] = judged_set(name, draw(part, half, rng))
    step()
    sets |= {each.name: each for each in scaled_sets(draw(table, quarter, rng))}
    step()
    edge, tried = edge_problems(table, min(BLOCK, -(-plan.grasps // 8)), rng)
    if len(edge):
        sets |= {each.name: each for each in (at_factor(edge, f) for f in LOAD_FACTORS)}
    step()
    network = None
    if train is not None:
        network = network_accuracy(
            judged_set(MIX, draw(table, 4 * plan.grasps, rng)),
            judged_set(MIX, draw(train, 4 * plan.grasps, rng)),
        )
    step()

    blocks = sum(-(-len(each) // BLOCK) for each in sets.values())
    step = bar(progress, "solvers on problem sets", blocks)
    results = {name: measure(entrants, each, BLOCK, step) for name, each in sets.items()}
    draws = sum(repetitions(size, len(sets[MIX])) for size in plan.batch_sizes)
    step = bar(progress, "batch sizes", draws)
    batches = batch_times(entrants, sets[MIX], table, plan.batch_sizes, rng, step)
    audited = [sets[MIX], *(at_factor(edge, f) for f in _AUDITED if len(edge))]
    step = bar(progress, "polygons for cones", len(audited))
    audits = {}
    for each in audited:
        audits[each.name] = polygons.audit(each)
        step()
    return Benchmark(
        plan=plan,
        grasps=len(table),
        objects=len(np.unique(table.object_id)),
        entrants=[each.facts for each in entrants],
        absent=absent(),
        sets={name: SetFacts.of(each) for name, each in sets.items()},
        results=results,
        edge_tried=tried,
        edge_kept=len(edge),
        batches=batches,
        network=network,
        polygons=audits,
        device=_device_throughput(plan, table, rng),
    )


def _device_throughput(
    plan: BenchmarkPlan, table: GraspTable, rng: np.random.Generator
) -> list[DeviceThroughput]:
    if not cuda_is_there() or "dual_newton_torch" not in available_solvers():
        return []

    def problems(count: int) -> GraspForceProblem:
        return draw(table, count, rng)

    sizes = [size for size in gpu.SIZES if size in plan.batch_sizes]
    return gpu.device_throughput(problems, sizes)


def _grasps(plan: BenchmarkPlan, path: Path | None, split: str, progress: Progress) -> GraspTable:
    if path is not None:
        return GraspTable.load(path)
    # the world is needed only here: with a table the benchmark runs where there is no simulator
    from gfo_env.grasps.collection import CollectionPlan, collect
    from gfo_env.objects import RANDOM_URDFS, ObjectSet

    objects = ObjectSet(RANDOM_URDFS, split)
    wanted = CollectionPlan(objects, plan.grasps, plan.seed)
    return collect(wanted, workers=plan.workers, progress=progress)[0]
