"""Policies on the same episodes: how often the object is held, at which reward, effort, quality."""

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Protocol

import gymnasium
import numpy as np
from joblib import delayed
from numpy.typing import NDArray
from rich.progress import Progress

from gfo_env.mdp.reward import RewardWeights
from gfo_env.policy import SolverPolicy
from gfo_env.workers import bar, worker_pool
from solvers import make_solver
from solvers.problem import MAX_QUALITY
from training.evaluation.solvers import ALONE, NETWORK
from training.networks.settings import TrainingError
from training.reports.aggregate import over_runs
from training.reports.intervals import Interval

from .actions import grasp_force_env
from .environments import make_environment
from .planning import PreloadPolicy
from .quality_policy import QualityPolicy
from .reactive import ReactivePolicy
from .runs import load_agent, run_groups, training_minutes
from .settings import RlSettings, key_values

RANDOM, REACTIVE = "random", "reactive"
"""Policies beside solvers: uniform actions, and `training.rl.reactive`."""

METRICS = ("hold_rate", "reward", "effort", "q_lrw")

GAIN = "gain"
"""Reward less that of another policy on the same episodes: a metric where one is named."""

_AT_ONCE = 20
"""Episodes of a job."""

Row = dict[str, Any]


class Policy(Protocol):
    """What stable-baselines3 evaluates."""

    def predict(
        self,
        observation: Any,
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[Any], tuple[NDArray[Any], ...] | None]:
        """An action, and the state to hand over with the next observation."""


@dataclass(frozen=True)
class PolicyPlan:
    """What to evaluate.

    Args:
        env: registered environment.
        env_kwargs: its arguments as key:value.
        policies: names of solvers, alone or with newtons of preload more, as in "dual_newton+2";
            "random", "reactive".
        runs: folders of reinforcement learning runs.
        splits: of the objects.
        episodes: in each split, the same ones for every policy.
        seed: of the first episode; the others follow.
        against: that among the policies whose rewards are taken from those of all.
    """

    env: str
    env_kwargs: tuple[str, ...]
    policies: tuple[str, ...]
    runs: tuple[Path, ...]
    splits: tuple[str, ...]
    episodes: int
    seed: int
    against: str | None = None

    def __post_init__(self) -> None:
        if self.episodes < 1:
            raise TrainingError(f"episodes is {self.episodes}; it must be 1 or more")
        if self.seed < 0:
            raise TrainingError(f"seed is {self.seed}; it must be 0 or more")
        if not self.policies and not self.runs:
            raise TrainingError("there is nothing to evaluate: name a policy or a run")
        if self.against is not None and self.against not in self.policies:
            raise TrainingError(f"against is {self.against!r}; it must be one of the policies")

    def environment(self, split: str) -> gymnasium.Env[Any, Any]:
        """The environment at a split of its objects."""
        return make_environment(self.env, key_values(self.env_kwargs) | {"split": split})


@dataclass(frozen=True)
class Played:
    """What became of one episode."""

    object_id: str
    hold_rate: float
    """1 if it ended in success, else 0."""
    reward: float
    """Sum over its steps."""
    effort: float
    """N, mean over its steps of the commanded forces' 2-norm."""
    q_lrw: float
    """N, mean over its steps of the lowest resisted wrench of the commanded normal forces."""
    steps: int


class RandomPolicy:
    """Uniform actions."""

    def __init__(self, space: gymnasium.Space[Any]) -> None:
        self._space = space

    def predict(
        self,
        observation: Any,
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[Any], tuple[NDArray[Any], ...] | None]:
        """An action that knows nothing of the observation."""
        return self._space.sample(), state


def play(env: gymnasium.Env[Any, Any], policy: Policy, seed: int) -> Played:
    """One episode from this seed."""
    env.action_space.seed(seed)
    observation, info = env.reset(seed=seed)
    state, start = None, np.ones(1, dtype=np.bool_)
    total, efforts, qualities, done = 0.0, [], [], False
    while not done:
        action, state = policy.predict(observation, state, start, True)
        observation, reward, terminated, truncated, info = env.step(action)
        done, start = terminated or truncated, np.zeros(1, dtype=np.bool_)
        total += float(reward)
        efforts.append(info.get("effort", np.nan))
        qualities.append(info.get("q_lrw", np.nan))
    held, means = float(info["is_success"]), (float(np.mean(efforts)), float(np.mean(qualities)))
    return Played(info["object_id"], held, total, *means, len(efforts))


def evaluate_policies(
    plan: PolicyPlan, *, workers: int = 1, progress: Progress | None = None
) -> list[Row]:
    """One row a policy and split; runs that differ in nothing but the seed share a row.

    Args:
        plan: what to evaluate.
        workers: processes.
        progress: a bar is added to it.

    Raises:
        TrainingError, GraspForceError: before any episode is played.
    """
    env = plan.environment(plan.splits[0])
    entrants: list[str | Path] = [*plan.policies, *plan.runs]
    for entrant in entrants:
        _entrant(entrant, env)
    env.close()
    groups = run_groups(plan.runs)
    firsts = range(plan.seed, plan.seed + plan.episodes, _AT_ONCE)
    end = plan.seed + plan.episodes
    chunks = [range(first, min(first + _AT_ONCE, end)) for first in firsts]
    jobs: list[tuple[str | Path, str, range]] = [
        (entrant, split, chunk) for split in plan.splits for entrant in entrants for chunk in chunks
    ]
    step = bar(progress, "episodes", sum(len(job[2]) for job in jobs))
    played: dict[tuple[str | Path, str], list[Played]] = {}
    with worker_pool(workers) as pool:
        results = pool(delayed(_play_all)(plan, *job) for job in jobs)
        for (entrant, split, _), made in zip(jobs, results, strict=True):
            played.setdefault((entrant, split), []).extend(made)
            step(len(made))
    rows = []
    for split in plan.splits:
        other = played[plan.against, split] if plan.against is not None else None
        rows += [_row(plan, name, split, [played[name, split]], other) for name in plan.policies]
        for name, folders in groups.items():
            row = _row(plan, name, split, [played[folder, split] for folder in folders], other)
            row["training_steps"] = RlSettings.load(folders[0]).steps
            row["training_minutes"] = float(np.mean([training_minutes(one) for one in folders]))
            rows.append(row)
    return rows


@cache
def _untrained_policy(name: str, weights: RewardWeights) -> Policy:
    if name == REACTIVE:
        return ReactivePolicy()
    solver, plus, preload = name.partition("+")
    settings = ALONE if solver == NETWORK else {}
    made = make_solver(solver, **settings)
    if MAX_QUALITY in made.objectives:
        return QualityPolicy(made, weights)
    if not plus:
        return SolverPolicy(made)
    try:
        return PreloadPolicy(made, float(preload))
    except ValueError as error:
        raise TrainingError(
            f"{name!r} is no policy: a solver with more preload is like dual_newton+2, in newtons"
        ) from error


def _entrant(
    entrant: str | Path, env: gymnasium.Env[Any, Any]
) -> tuple[gymnasium.Env[Any, Any], Policy]:
    """The environment as the entrant sees it, and the entrant."""
    if isinstance(entrant, Path):
        agent = load_agent(entrant)
        return agent.wrap(env), agent
    if entrant == RANDOM:
        return env, RandomPolicy(env.action_space)
    return env, _untrained_policy(entrant, grasp_force_env(env).reward_weights)


def _play_all(plan: PolicyPlan, entrant: str | Path, split: str, seeds: range) -> list[Played]:
    env, policy = _entrant(entrant, plan.environment(split))
    try:
        return [play(env, policy, seed) for seed in seeds]
    finally:
        env.close()


def _row(
    plan: PolicyPlan, name: str, split: str, runs: list[list[Played]], other: list[Played] | None
) -> Row:
    """One row: of the episodes, (runs, episodes), and of those of the policy to compare with."""
    objects = np.array([one.object_id for one in runs[0]])
    row: Row = {
        "policy": name,
        "env": plan.env,
        "env_kwargs": list(plan.env_kwargs),
        "split": split,
        "seed": plan.seed,
        "runs": len(runs),
        "episodes": len(objects),
        "objects": len(np.unique(objects)),
        "steps": float(np.mean([[one.steps for one in run] for run in runs])),
    }
    measured = {
        metric: np.array([[getattr(one, metric) for one in run] for run in runs])
        for metric in METRICS
    }
    if other is not None:
        measured[GAIN] = measured["reward"] - np.array([one.reward for one in other])
        row["against"] = plan.against
    for metric, values in measured.items():
        result: Interval | None = None
        if np.isfinite(values).all():
            alone = len(runs) == 1
            result = Interval.of(values[0], objects) if alone else over_runs(values, objects)
        row[metric] = result.value if result else None
        row[f"{metric}_ci"] = result.ends if result else None
    return row
