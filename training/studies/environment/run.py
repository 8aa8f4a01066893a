"""Everything that is measured of the environment, in one object."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from rich.progress import Progress

from gfo_env.env import GraspForceEnv
from gfo_env.grasps.attempts import CHUNK, Attempts, make_chunk
from gfo_env.grasps.collection import fill_cache
from gfo_env.mdp.episode import SUBSTEPS
from gfo_env.objects import RANDOM_URDFS, ObjectSet
from gfo_env.simulation import Simulation
from gfo_env.workers import bar
from training.measuring.timing import pinned, usable_cores

from .accuracy import EstimateErrors, accuracy
from .memory import MemoryUse, memory
from .parallel import DYNAMIC, STATIC, plain_rate, vector_rate
from .peer import PeerTimes, check_peer, measure_peer
from .plan import SpeedPlan
from .recording import BareTime, PlayTime, play, play_bare, play_static, record, record_static
from .stages import stage_times


@dataclass(frozen=True)
class StepTimes:
    """The dynamic environment beside the bare simulator; medians over repeats.

    Args:
        episodes: that were played again and again.
        steps: of control in them.
        substeps: simulation steps of a control step.
        env: control steps per second of the environment.
        bare: of the bare simulator under the same commands.
        physics: of its `stepSimulation` alone.
        ratio: env over bare, a median of ratios.
        physics_ratio: env over physics, likewise.
        identical: share of episodes that end in the same bits in the bare simulator.
    """

    episodes: int
    steps: int
    substeps: int
    env: float
    bare: float
    physics: float
    ratio: float
    physics_ratio: float
    identical: float


@dataclass(frozen=True)
class ResetTimes:
    """Resets of the dynamic environment, grasps and objects loaded before; ms.

    Args:
        per_second: one over the mean.
        median, p95: of a reset.
        reload: median of loading hand and object into the simulator alone.
        chunk: median of making a chunk of the grasp cache, objects new to the process.
        attempts: to grasp, in a chunk.
    """

    per_second: float
    median: float
    p95: float
    reload: float
    chunk: float
    attempts: int


@dataclass(frozen=True)
class StaticTimes:
    """One-step episodes on a core, resets included; the median of repeats."""

    episodes_per_second: float
    microseconds: float


@dataclass(frozen=True)
class WorkerRates:
    """Rates of several processes, resets included; medians over repeats.

    Args:
        workers: processes.
        kind: `PLAIN` or `VECTOR`.
        steps_per_second: of the dynamic environment, all processes together.
        episodes_per_second: of the static one.
    """

    workers: int
    kind: str
    steps_per_second: float
    episodes_per_second: float


PACKAGES = ("pybullet", "gymnasium", "numpy", "scipy", "numba")
"""Whose versions decide how fast it is."""

PLAIN, VECTOR = "plain processes", "make_vec, async"


@dataclass(frozen=True, eq=False)
class SpeedReport:
    """What was found.

    Args:
        plan: how much was measured.
        steps: of the dynamic environment.
        stages: us of a control step that each of its parts takes.
        resets: of the dynamic environment.
        static: one-step episodes.
        workers: several processes.
        peer: panda-gym, the median run by its steps; None if it was left out.
        accuracy: of q_lrw.
        memory: over many resets.
    """

    plan: SpeedPlan
    steps: StepTimes
    stages: dict[str, float]
    resets: ResetTimes
    static: StaticTimes
    workers: list[WorkerRates]
    peer: PeerTimes | None
    accuracy: list[EstimateErrors]
    memory: MemoryUse


def measure(plan: SpeedPlan, progress: Progress) -> SpeedReport:
    """Measure everything.

    Args:
        plan: how much.
        progress: bars are added to it.

    Raises:
        EnvSpeedError: the plan cannot be met, panda-gym cannot run, or a process failed.
        GraspTableError: a table of grasps cannot be read.
    """
    plan.check()
    if plan.peer_python is not None:
        check_peer(plan.peer_python)
    env = GraspForceEnv(grasps=plan.table)
    held_out = GraspForceEnv(split="test", mode="static", grasps=plan.held_out_table)
    for each, table in ((env, plan.table), (held_out, plan.held_out_table)):
        if table is None:
            fill_cache(each.grasps, workers=len(usable_cores()), progress=progress)
    with pinned(1):
        chunk = _chunk_time(plan, bar(progress, "grasp attempts", plan.chunks))
        turns = _in_turns(plan, env, bar(progress, "environment and bare simulator", plan.repeats))
    return SpeedReport(
        plan=plan,
        steps=turns.steps(),
        stages=turns.stages,
        resets=turns.resets(chunk),
        static=turns.static(),
        workers=_workers(plan, progress),
        peer=turns.peer(),
        accuracy=accuracy(
            plan.grasps, plan.seed, plan.held_out_table, bar(progress, "q_lrw", plan.grasps)
        ),
        memory=memory(
            plan.resets,
            plan.objects,
            plan.seed,
            plan.table,
            bar(progress, "resets", plan.resets + plan.objects),
        ),
    )


@dataclass(frozen=True, eq=False)
class _Turns:
    """Times of every repeat, taken in turns."""

    episodes: int
    count: int
    plays: list[PlayTime]
    bares: list[BareTime]
    one_step: list[float]
    static_count: int
    peers: list[PeerTimes]
    stages: dict[str, float]

    def steps(self) -> StepTimes:
        env = np.array([each.steps for each in self.plays])
        bare = np.array([each.steps for each in self.bares])
        physics = np.array([each.physics for each in self.bares])
        same = sum(each.identical for each in self.bares) / (len(self.bares) * self.episodes)
        return StepTimes(
            episodes=self.episodes,
            steps=self.count,
            substeps=SUBSTEPS,
            env=self.count / float(np.median(env)),
            bare=self.count / float(np.median(bare)),
            physics=self.count / float(np.median(physics)),
            ratio=float(np.median(bare / env)),
            physics_ratio=float(np.median(physics / env)),
            identical=same,
        )

    def resets(self, chunk: float) -> ResetTimes:
        resets = 1e3 * np.array([each.resets for each in self.plays])
        loads = 1e3 * np.array([each.loads for each in self.bares])
        return ResetTimes(
            per_second=1e3 / float(np.median(resets.mean(axis=1))),
            median=float(np.median(resets)),
            p95=float(np.percentile(resets, 95)),
            reload=float(np.median(loads)),
            chunk=1e3 * chunk,
            attempts=CHUNK,
        )

    def static(self) -> StaticTimes:
        each = float(np.median(self.one_step)) / self.static_count
        return StaticTimes(1.0 / each, 1e6 * each)

    def peer(self) -> PeerTimes | None:
        ranked = sorted(self.peers, key=lambda each: each.steps_per_second)
        return ranked[len(ranked) // 2] if ranked else None


def _in_turns(plan: SpeedPlan, env: GraspForceEnv, step: Callable[[], None]) -> _Turns:
    """Environment, bare simulator, one-step episodes and panda-gym, one after the other."""
    still = GraspForceEnv(mode="static", grasps=plan.table)
    episodes = record(env, plan.seconds, plan.seed)
    actions = record_static(still, plan.seconds, plan.seed)
    count = sum(len(each.actions) for each in episodes)
    bare = Simulation(env.hand)
    # once untimed: every object is then known to both simulators
    play(env, episodes)
    play_bare(bare, episodes)
    plays, bares, one_step, peers, stages = [], [], [], [], []
    for turn in range(plan.repeats):
        plays.append(play(env, episodes))
        bares.append(play_bare(bare, episodes))
        one_step.append(play_static(still, actions, plan.seed))
        stages.append(stage_times(env, episodes))
        if plan.peer_python is not None:
            peers.append(measure_peer(plan.peer_python, plan.seconds, plan.seed + turn))
        step()
    bare.close()
    env.close()
    middle = {
        name: 1e6 * float(np.median([each[name] for each in stages])) / count for name in stages[0]
    }
    return _Turns(len(episodes), count, plays, bares, one_step, len(actions), peers, middle)


def _chunk_time(plan: SpeedPlan, step: Callable[[], None]) -> float:
    """s, median, for a chunk of the grasp cache whose objects the process has not seen."""
    times = []
    for number in range(plan.chunks):
        attempts = Attempts(ObjectSet(RANDOM_URDFS, "train"), plan.seed)
        begin = time.perf_counter()
        make_chunk(attempts, number)
        times.append(time.perf_counter() - begin)
        step()
    return float(np.median(times))


def _workers(plan: SpeedPlan, progress: Progress) -> list[WorkerRates]:
    kinds = ((PLAIN, plain_rate), (VECTOR, vector_rate))
    step = bar(progress, "processes", plan.repeats * len(plan.workers) * len(kinds))
    found: dict[tuple[int, str], list[tuple[float, float]]] = {}
    for turn in range(plan.repeats):
        for workers in plan.workers:
            for kind, rate in kinds:
                seed = plan.seed + 100 * turn
                both = [
                    rate(env_id, workers, plan.seconds, seed, plan.table)
                    for env_id in (DYNAMIC, STATIC)
                ]
                found.setdefault((workers, kind), []).append((both[0], both[1]))
                step()
    return [
        WorkerRates(workers, kind, *map(float, np.median(rates, axis=0)))
        for (workers, kind), rates in found.items()
    ]
