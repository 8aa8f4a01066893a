"""Files of networks: safetensors whose metadata says how they were made."""

import dataclasses
import hashlib
import json
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import torch
from safetensors import safe_open
from safetensors.torch import save
from torch import Tensor, nn

from solvers.exceptions import SolverError, UnreadableFileError
from solvers.files import reading, write_bytes

_DIGEST = "sha256"
"""Key of the metadata under which the digest of all tensors stands."""


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
    """Write the weights, the configuration and `metadata` (command, seed, ...) to `path`.

    The same network and metadata give the same bytes.

    Raises:
        UnwritableFileError: if the system refuses; what lay there before still does.
    """
    config = json.dumps(dataclasses.asdict(network.config))
    tensors = {name: value.detach().cpu() for name, value in network.state_dict().items()}
    header = {"format": network.file_format, "config": config, _DIGEST: _digest(tensors)}
    write_bytes(path, _ordered(save(tensors, metadata=header | metadata)))


def read_metadata(path: Path, kind: type[SavedNetwork]) -> dict[str, str]:
    """The metadata that `save_network` wrote.

    Raises:
        SolverError: if the file is missing or is something else.
    """
    return _read(path, kind)[0]


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
        SolverError: if the file is missing, is damaged or something else, or does not fit its
            configuration.
    """
    metadata, tensors = _read(path, kind)
    try:
        config = kind.config_type(**json.loads(metadata["config"]))
    except (KeyError, TypeError, ValueError, RecursionError, SolverError) as error:
        raise SolverError(f"the configuration in {path} is damaged: {error}") from error
    with torch.device("meta"):  # takes up no memory, however large a stranger says that it is
        wanted = {name: value.shape for name, value in kind(config).state_dict().items()}
    if wanted != {name: value.shape for name, value in tensors.items()}:
        raise SolverError(f"the weights in {path} do not fit its configuration")
    network = kind(config)
    network.load_state_dict(tensors)
    return network.eval()


def _read(path: Path, kind: type[SavedNetwork]) -> tuple[dict[str, str], dict[str, Tensor]]:
    """Metadata and tensors of a file of weights of this kind."""
    try:
        with reading(path), safe_open(path, framework="pt") as file:
            metadata: dict[str, str] = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except FileNotFoundError as error:
        raise SolverError(f"no weights at {path}; make them with {kind.training_script}") from error
    except UnreadableFileError as error:
        raise SolverError(
            f"{path} is not a safetensors file of weights; make one with {kind.training_script}"
        ) from error
    found = metadata.get("format")
    if found != kind.file_format:
        raise SolverError(f"{path} has the format {found!r}, not {kind.file_format!r}")
    # files from before there was a digest have none
    if metadata.get(_DIGEST, digest := _digest(tensors)) != digest:
        raise SolverError(f"the weights in {path} are damaged; fetch or make them again")
    return metadata, tensors


def _ordered(content: bytes) -> bytes:
    """A file of safetensors, its metadata in the order of their names: the library has none."""
    end = 8 + int.from_bytes(content[:8], "little")
    header = json.loads(content[8:end])
    header["__metadata__"] = dict(sorted(header["__metadata__"].items()))
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    return len(text).to_bytes(8, "little") + text + content[end:]


def _digest(tensors: dict[str, Tensor]) -> str:
    content = hashlib.sha256()
    for name, value in sorted(tensors.items()):
        content.update(f"{name} {value.dtype} {tuple(value.shape)} ".encode())
        content.update(value.contiguous().reshape(-1).view(torch.uint8).numpy().tobytes())
    return content.hexdigest()
