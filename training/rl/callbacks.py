"""What happens beside learning: evaluation on held-out objects, and checkpoints."""

import io
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback, EvalCallback
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

from solvers.exceptions import UnreadableFileError
from solvers.files import make_folder, read_arrays, write_bytes, writing
from training.networks.settings import TrainingError

from .state import save_state

EVALUATIONS = "evaluations.npz"
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
        super().__init__(env, n_eval_episodes=episodes, verbose=0)
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
        if self.n_calls % self.eval_freq != 0:
            return super()._on_step()
        self.eval_env.seed(_HELD_OUT_SEED)
        # under a path it would be written over the evaluations so far, not in their place
        content = io.BytesIO()
        self.log_path = content  # type: ignore[assignment]
        go_on = super()._on_step()
        write_bytes(self._file, content.getvalue())
        return go_on

    def _restore(self) -> None:
        """Take up the evaluations up to the checkpoint; later ones are made again."""
        if not self._file.exists():
            return
        saved = read_evaluations(self._file.parent)
        kept = int(np.sum(saved["timesteps"] <= self.num_timesteps))
        self.evaluations_timesteps = saved["timesteps"][:kept].tolist()
        self.evaluations_results = saved["results"][:kept].tolist()
        self.evaluations_length = saved["ep_lengths"][:kept].tolist()
        if "successes" in saved:
            self.evaluations_successes = saved["successes"][:kept].tolist()


def read_evaluations(output: Path) -> dict[str, NDArray[Any]]:
    """`timesteps` (k,), and of each evaluation `results` and `ep_lengths` (k, episodes).

    Where episodes can succeed, `successes` (k, episodes), too.

    Raises:
        TrainingError: if they are missing or damaged.
    """
    path = output / EVALUATIONS
    try:
        saved = read_arrays(path)
    except FileNotFoundError as error:
        raise TrainingError(f"{output} holds no evaluations of an agent") from error
    except UnreadableFileError as error:
        raise TrainingError(
            f"the evaluations {path} are damaged; without the file the run goes on, with a "
            "learning curve that lacks its beginning"
        ) from error
    names = {"timesteps", "results", "ep_lengths"}
    counts = {len(array) if array.ndim else 0 for array in saved.values()}
    if not names <= saved.keys() <= names | {"successes"} or len(counts) != 1 or 0 in counts:
        raise TrainingError(f"{path} holds no evaluations of an agent")
    return saved


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
    """Write a checkpoint whole or not at all, unless it is there, and delete those before it.

    Raises:
        UnwritableFileError: if the system refuses; the checkpoint before this one is left.
    """
    folder = output / f"{_PREFIX}{model.num_timesteps}"
    partial = output / f"partial_{_PREFIX}{model.num_timesteps}"
    shutil.rmtree(partial, ignore_errors=True)
    if not folder.exists():
        make_folder(partial)
        save_state(partial, model)
        with writing(folder):
            os.replace(partial, folder)
    for path in _checkpoints(output):
        if path != folder:
            shutil.rmtree(path, ignore_errors=True)


def last_checkpoint(output: Path) -> Path | None:
    """The folder of the checkpoint with the most steps, if there is any."""
    return max(_checkpoints(output), key=_steps, default=None)


def _checkpoints(output: Path) -> list[Path]:
    return [path for path in output.glob(f"{_PREFIX}*") if _steps(path) >= 0]


def _steps(checkpoint: Path) -> int:
    number = checkpoint.name.removeprefix(_PREFIX)
    return int(number) if number.isdecimal() else -1
