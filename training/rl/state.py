"""What a run keeps of its agent, all of it data: nothing that is read here can run.

stable-baselines3 keeps agents, replay buffers and normalisations as pickles, and to read a pickle
is to run it. Of its `model.zip`, which others may read as they like, the parameters alone are read
here; what else an agent consists of follows from the settings of its run, or lies beside it as
arrays and JSON.
"""

import io
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.save_util import load_from_zip_file, recursive_setattr
from stable_baselines3.common.vec_env import VecNormalize

from solvers.files import (
    check_archive,
    read_arrays,
    read_json,
    reading,
    write_arrays,
    write_bytes,
    write_json,
)

MODEL = "model.zip"
AGENT = "agent.npz"
"""The spaces of what an agent sees and does, and the statistics that its observations are
normalised by."""
_PROGRESS = "progress.json"
_REPLAY = "replay_buffer.npz"

_COUNTERS = (
    "num_timesteps",
    "_n_updates",
    "_episode_num",
    "_current_progress_remaining",
)
"""Attributes of an algorithm that change as it learns, if it has them."""


class SpacesOnly(gymnasium.Env[Any, Any]):
    """An environment that says what an agent sees and does, and nothing more.

    Args:
        observation_space: what it sees.
        action_space: what it does.
    """

    def __init__(
        self, observation_space: spaces.Space[Any], action_space: spaces.Space[Any]
    ) -> None:
        self.observation_space = observation_space
        self.action_space = action_space


def save_model(folder: Path, model: BaseAlgorithm) -> None:
    """Write a model with its spaces and the normalisation of its observations.

    Raises:
        UnwritableFileError: if the system refuses.
    """
    content = io.BytesIO()
    model.save(content)
    arrays = {
        **_bounds("observation_space", model.observation_space),
        **_bounds("action_space", model.action_space),
    }
    for name, statistics in _statistics(model.env):
        arrays |= {f"{name}/{key}": value for key, value in vars(statistics).items()}
    write_bytes(folder / MODEL, content.getvalue())
    write_arrays(folder / AGENT, arrays)


def load_spaces(folder: Path) -> tuple[spaces.Space[Any], spaces.Space[Any]]:
    """What the agent sees and does that `save_model` wrote.

    Raises:
        FileNotFoundError: if there is none.
        UnreadableFileError: if it is damaged.
    """
    arrays = read_arrays(folder / AGENT)
    with reading(folder / AGENT):
        return _space(arrays, "observation_space"), _space(arrays, "action_space")


def load_model(folder: Path, model: BaseAlgorithm) -> None:
    """Give a new model the parameters and the normalisation that `save_model` wrote.

    Raises:
        FileNotFoundError: if there are none.
        UnreadableFileError: if they are damaged, or are another model's.
    """
    arrays = read_arrays(folder / AGENT)
    with reading(folder / AGENT):
        for name, statistics in _statistics(model.env):
            for key, value in vars(statistics).items():
                saved = arrays[f"{name}/{key}"]
                if saved.shape != np.shape(value) or not np.isfinite(saved).all():
                    raise ValueError(f"{name} is another agent's")
                setattr(statistics, key, float(saved) if isinstance(value, float) else saved)
    with reading(folder / MODEL) as stream:
        check_archive(stream)
        # load_data would unpickle
        content = io.BytesIO(stream.read())
        _, parameters, variables = load_from_zip_file(content, device="cpu", load_data=False)
        model.set_parameters(parameters, device="cpu")
        for name, value in (variables or {}).items():
            if value is not None:
                recursive_setattr(model, f"{name}.data", value.data)


def save_state(folder: Path, model: BaseAlgorithm) -> None:
    """Write all that the rest of a run depends on: `save_model`, counters and memory.

    Raises:
        UnwritableFileError: if the system refuses.
    """
    save_model(folder, model)
    progress: dict[str, Any] = {
        name: getattr(model, name) for name in _COUNTERS if hasattr(model, name)
    }
    # what the last episodes were like is logged
    progress["episodes"] = [[float(one["r"]), int(one["l"])] for one in model.ep_info_buffer or ()]
    progress["successes"] = [float(one) for one in model.ep_success_buffer or ()]
    write_json(folder / _PROGRESS, progress)
    if isinstance(model, OffPolicyAlgorithm):
        assert model.replay_buffer is not None
        write_arrays(folder / _REPLAY, _memory(model.replay_buffer))


def load_state(folder: Path, model: BaseAlgorithm) -> None:
    """Give a new model the state that `save_state` wrote.

    Raises:
        FileNotFoundError, UnreadableFileError: as `load_model`.
    """
    load_model(folder, model)
    progress = read_json(folder / _PROGRESS)
    with reading(folder / _PROGRESS):
        for name in _COUNTERS:
            if hasattr(model, name):
                if type(progress[name]) is not type(getattr(model, name)):
                    raise TypeError(f"{name} is no number of its kind")
                setattr(model, name, progress[name])
        episodes = [{"r": float(r), "l": int(length)} for r, length in progress["episodes"]]
        successes = [float(one) for one in progress["successes"]]
        model.ep_info_buffer = deque(episodes, maxlen=model._stats_window_size)
        model.ep_success_buffer = deque(successes, maxlen=model._stats_window_size)
    if isinstance(model, OffPolicyAlgorithm):
        assert model.replay_buffer is not None
        arrays = read_arrays(folder / _REPLAY)
        with reading(folder / _REPLAY):
            _remember(model.replay_buffer, arrays)


def _bounds(name: str, space: spaces.Space[Any]) -> dict[str, NDArray[Any]]:
    """Arrays that tell a space."""
    if isinstance(space, spaces.Dict):
        parts = [_bounds(f"{name}/{key}", part) for key, part in space.items()]
        return {key: array for part in parts for key, array in part.items()}
    assert isinstance(space, spaces.Box)
    return {f"{name}/low": space.low, f"{name}/high": space.high}


def _space(arrays: dict[str, NDArray[Any]], name: str) -> spaces.Space[Any]:
    """The space that `_bounds` told."""
    if f"{name}/low" in arrays:
        low, high = arrays[f"{name}/low"], arrays[f"{name}/high"]
        return spaces.Box(low, high, dtype=low.dtype.type)
    keys = [key.split("/")[1] for key in arrays if key.startswith(f"{name}/")]
    if not keys:
        raise KeyError(name)
    return spaces.Dict({key: _space(arrays, f"{name}/{key}") for key in keys})


def _statistics(env: Any) -> Iterator[tuple[str, RunningMeanStd]]:
    """What a normalisation has counted, by name."""
    assert isinstance(env, VecNormalize)
    yield "returns", env.ret_rms
    if env.norm_obs:
        counted: Any = env.obs_rms
        several = counted if isinstance(counted, dict) else {"": counted}
        yield from ((f"observations/{key}", one) for key, one in several.items())


def _memory(buffer: ReplayBuffer) -> dict[str, NDArray[Any]]:
    """What a replay buffer holds, without the room that is left in it."""
    rows = {name: array[: buffer.size()] for name, array in _columns(buffer)}
    return {"place": np.array(buffer.pos), "full": np.array(buffer.full), **rows}


def _remember(buffer: ReplayBuffer, arrays: dict[str, NDArray[Any]]) -> None:
    """Fill a new replay buffer with what `_memory` gave."""
    place, full = int(arrays["place"]), bool(arrays["full"])
    size = buffer.buffer_size if full else place
    if not 0 <= place <= size <= buffer.buffer_size:
        raise ValueError("its place cannot be")
    for name, column in _columns(buffer):
        saved = arrays[name]
        if saved.shape != (size, *column.shape[1:]) or saved.dtype != column.dtype:
            raise ValueError(f"{name} is another agent's")
        column[:size] = saved
    buffer.pos, buffer.full = place, full


def _columns(buffer: ReplayBuffer) -> Iterator[tuple[str, NDArray[Any]]]:
    for name in ("observations", "next_observations", "actions", "rewards", "dones", "timeouts"):
        column = getattr(buffer, name, None)
        if isinstance(column, dict):
            yield from ((f"{name}/{key}", part) for key, part in column.items())
        elif column is not None:
            yield name, column
