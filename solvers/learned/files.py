"""Files of networks: safetensors whose metadata says how they were made."""

import dataclasses
import json
from pathlib import Path
from typing import Any, ClassVar, TypeVar

from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import nn

from solvers.exceptions import SolverError


class SavedNetwork(nn.Module):
    """A network that is made of its configuration alone, and kept in files of its own format."""

    file_format: ClassVar[str]
    """Name and version, as the metadata has it."""
    training_script: ClassVar[str]
    """What makes such files."""
    config_type: ClassVar[type[Any]]
    """Dataclass of the only argument."""

    config: Any


Network = TypeVar("Network", bound=SavedNetwork)


def save_network(network: SavedNetwork, path: Path, metadata: dict[str, str]) -> None:
    """Write the weights, the configuration and `metadata` (command, seed, ...) to `path`."""
    config = json.dumps(dataclasses.asdict(network.config))
    header = {"format": network.file_format, "config": config, **metadata}
    tensors = {name: value.detach().cpu() for name, value in network.state_dict().items()}
    path.write_bytes(save(tensors, metadata=header))


def read_metadata(path: Path, kind: type[SavedNetwork]) -> dict[str, str]:
    """The metadata that `save_network` wrote.

    Raises:
        SolverError: if the file is missing or is something else.
    """
    try:
        with safe_open(path, framework="pt") as file:
            metadata: dict[str, str] = file.metadata() or {}
    except FileNotFoundError as error:
        raise SolverError(f"no weights at {path}; make them with {kind.training_script}") from error
    except (OSError, SafetensorError) as error:
        raise SolverError(f"{path} is not a safetensors file of weights") from error
    found = metadata.get("format")
    if found != kind.file_format:
        raise SolverError(f"{path} has the format {found!r}, not {kind.file_format!r}")
    return metadata


def weights_path(weights: Any, default: Path) -> Path:
    """The file that a solver's setting names; the default for None.

    Raises:
        SolverError: for what is neither.
    """
    if weights is None:
        return default
    if isinstance(weights, str | Path):
        return Path(weights)
    raise SolverError(f"weights must be a file or a network, not {type(weights).__name__}")


def load_network(path: Path, kind: type[Network]) -> Network:
    """The network at `path`, on the CPU, ready to be asked.

    Raises:
        SolverError: if the file is missing, is something else, or does not fit its configuration.
    """
    config = kind.config_type(**json.loads(read_metadata(path, kind)["config"]))
    network = kind(config)
    with safe_open(path, framework="pt") as file:
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    try:
        network.load_state_dict(tensors)
    except RuntimeError as error:
        raise SolverError(f"the weights in {path} do not fit its configuration: {error}") from error
    return network.eval()
