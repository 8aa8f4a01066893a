"""What happens beside learning: evaluation on held-out objects, and checkpoints."""

import os
import shutil
from pathlib import Path

import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback, EvalCallback
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

EVALUATIONS = "evaluations.npz"
MODEL = "model.zip"
NORMALIZATION = "vecnormalize.pkl"
REPLAY = "replay_buffer.pkl"
TENSORBOARD = "tensorboard"

_PREFIX = "checkpoint_"
_HELD_OUT_SEED = 1_000_003
"""Of the evaluations' episodes, the same for every run."""


class HeldOutEvaluation(EvalCallback):
    """`EvalCallback` on the same episodes every time, from before the first step on.

    Args:
        env: of the held-out objects.
        output: folder of `evaluations.npz`; what lies there is gone on with.
        every: steps of all environments together.
        episodes: of each evaluation.
    """

    def __init__(self, env: VecEnv, output: Path, every: int, episodes: int) -> None:
        super().__init__(env, n_eval_episodes=episodes, log_path=str(output), verbose=0)
        self._every = every
        self._file = output / EVALUATIONS

    def _on_training_start(self) -> None:
        count = self.training_env.num_envs
        self.eval_freq = max(1, self._every // count)
        self.n_calls = self.num_timesteps // count
        if self.num_timesteps > 0:
            self._restore()
        else:
            self._on_step()

    def _on_step(self) -> bool:
        if self.n_calls % self.eval_freq == 0:
            self.eval_env.seed(_HELD_OUT_SEED)
        return super()._on_step()

    def _restore(self) -> None:
        """Take up the evaluations up to the checkpoint; later ones are made again."""
        if not self._file.exists():
            return
        with np.load(self._file) as saved:
            kept = int(np.sum(saved["timesteps"] <= self.num_timesteps))
            self.evaluations_timesteps = saved["timesteps"][:kept].tolist()
            self.evaluations_results = saved["results"][:kept].tolist()
            self.evaluations_length = saved["ep_lengths"][:kept].tolist()
            if "successes" in saved:
                self.evaluations_successes = saved["successes"][:kept].tolist()


class Checkpoints(BaseCallback):
    """Writes checkpoints between rollouts, each the beginning of a new segment of the run.

    At a checkpoint all environments are reset and all random generators seeded anew, from the
    run's seed and the number of steps. So nothing that a checkpoint does not hold matters to what
    follows, and a run that was killed ends like one that was not.

    Args:
        output: folder of the run.
        every: steps between checkpoints, at least.
        seed: of the run.
    """

    def __init__(self, output: Path, every: int, seed: int) -> None:
        super().__init__()
        self._output = output
        self._every = every
        self._seed = seed
        self._last = 0

    def _on_training_start(self) -> None:
        self._last = self.num_timesteps

    def _on_rollout_start(self) -> None:
        if self.num_timesteps - self._last >= self._every:
            self._last = self.num_timesteps
            save_checkpoint(self._output, self.model)
            begin_segment(self.model, self._seed)

    def _on_step(self) -> bool:
        return True


def begin_segment(model: BaseAlgorithm, seed: int) -> None:
    """Reset all environments and seed everything from the run's seed and the steps done."""
    assert model.env is not None
    rng = np.random.default_rng([seed, model.num_timesteps])
    model.set_random_seed(int(rng.integers(2**31 - 1 - model.env.num_envs)))
    model._last_obs = model.env.reset()  # type: ignore[assignment]
    model._last_episode_starts = np.ones(model.env.num_envs, dtype=bool)
    if isinstance(model.env, VecNormalize):
        model._last_original_obs = model.env.get_original_obs()


def save_checkpoint(output: Path, model: BaseAlgorithm) -> None:
    """Write a checkpoint whole or not at all, and delete those before it."""
    folder = output / f"{_PREFIX}{model.num_timesteps}"
    partial = output / f"partial_{_PREFIX}{model.num_timesteps}"
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    save_model(partial, model)
    if isinstance(model, OffPolicyAlgorithm):
        model.save_replay_buffer(partial / REPLAY)
    earlier = [path for path in output.glob(f"{_PREFIX}*") if path != folder]
    if not folder.exists():
        os.replace(partial, folder)
    for path in (*earlier, partial):
        shutil.rmtree(path, ignore_errors=True)


def last_checkpoint(output: Path) -> Path | None:
    """The folder of the checkpoint with the most steps, if there is any."""
    folders = output.glob(f"{_PREFIX}*")
    return max(folders, key=lambda path: int(path.name.removeprefix(_PREFIX)), default=None)


def save_model(folder: Path, model: BaseAlgorithm) -> None:
    """Write a model and the normalisation of its observations."""
    model.save(folder / MODEL)
    if isinstance(model.env, VecNormalize):
        model.env.save(str(folder / NORMALIZATION))
