"""Files of the conditioned network: safetensors whose metadata says how they were made."""

import dataclasses
import json
from pathlib import Path

from safetensors import SafetensorError, safe_open
from safetensors.torch import save

from .exceptions import SolverError
from .network import ConditionedKktNetwork
from .network_config import NetworkConfig

_FORMAT = "graspforce-conditioned-1"


def save_network(network: ConditionedKktNetwork, path: Path, metadata: dict[str, str]) -> None:
    """Write the weights, the configuration and `metadata` (command, seed, ...) to `path`."""
    config = json.dumps(dataclasses.asdict(network.config))
    header = {"format": _FORMAT, "config": config, **metadata}
    tensors = {name: value.detach().cpu() for name, value in network.state_dict().items()}
    path.write_bytes(save(tensors, metadata=header))


def read_metadata(path: Path) -> dict[str, str]:
    """The metadata that `save_network` wrote.

    Raises:
        SolverError: if the file is missing or is something else.
    """
    try:
        with safe_open(path, framework="pt") as file:
            metadata: dict[str, str] = file.metadata() or {}
    except FileNotFoundError as error:
        raise SolverError(f"no weights at {path}; make them with scripts/train.py") from error
    except (OSError, SafetensorError) as error:
        raise SolverError(f"{path} is not a safetensors file of weights") from error
    if metadata.get("format") != _FORMAT:
        raise SolverError(f"{path} has the format {metadata.get('format')!r}, not {_FORMAT!r}")
    return metadata


def load_network(path: Path) -> ConditionedKktNetwork:
    """The network at `path`, on the CPU, ready to be asked.

    Raises:
        SolverError: if the file is missing, is something else, or does not fit its configuration.
    """
    config = NetworkConfig(**json.loads(read_metadata(path)["config"]))
    network = ConditionedKktNetwork(config)
    with safe_open(path, framework="pt") as file:
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    try:
        network.load_state_dict(tensors)
    except RuntimeError as error:
        raise SolverError(f"the weights in {path} do not fit its configuration: {error}") from error
    return network.eval()
