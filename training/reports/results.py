"""Results of a study in a file, from which its page is made anew: dataclasses as JSON."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar, get_args, get_origin

import numpy as np
from cattrs import BaseValidationError
from cattrs.preconf.json import JsonConverter, make_converter

from solvers import GraspForceError
from solvers.files import read_json, write_json

Results = TypeVar("Results")


class ResultsError(GraspForceError):
    """A file does not hold the results of a study."""


@dataclass(frozen=True)
class Run(Generic[Results]):
    """What a study found, and how.

    Args:
        command: that finds it again, for the reader.
        machine: what it ran on, see `training.measuring.machine.machine`.
        results: a dataclass of the study, of numbers, texts, arrays and dataclasses.
    """

    command: str
    machine: dict[str, str]
    results: Results


def save_run(run: Run[Any], path: Path) -> None:
    """Write a run for `load_run`.

    Raises:
        UnwritableFileError: if the system refuses; what lay there before still does.
    """
    write_json(path, _CONVERTER.unstructure(run), indent=None)


def load_run(path: Path, kind: type[Results]) -> Run[Results]:
    """Read the run of a study whose results are of this kind.

    Raises:
        ResultsError: the file is missing, or holds something else.
    """
    try:
        values = read_json(path)
        if not isinstance(values, dict):
            raise ValueError("not an object")
        run: Run[Results] = _CONVERTER.structure(values, Run[kind])  # type: ignore[valid-type]
    except FileNotFoundError as error:
        raise ResultsError(f"no results at {path}") from error
    # UnreadableFileError among them, and what cattrs raises for other values
    except (ValueError, BaseValidationError) as error:
        raise ResultsError(
            f"{path} holds no results of this study: make them with --json FILE of this command"
        ) from error
    return run


def _is_array(kind: Any) -> bool:
    return get_origin(kind) is np.ndarray


def _array(values: Any, kind: Any) -> np.ndarray:
    (dtype,) = get_args(get_args(kind)[1])
    return np.array(values, dtype=dtype)


def _converter() -> JsonConverter:
    converter = make_converter(forbid_extra_keys=True)
    converter.register_structure_hook_func(_is_array, _array)
    converter.register_unstructure_hook(np.ndarray, lambda array: array.tolist())
    converter.register_unstructure_hook_func(_is_array, lambda array: array.tolist())
    converter.register_structure_hook(Path, lambda value, _: Path(value))
    converter.register_unstructure_hook(Path, str)
    return converter


_CONVERTER = _converter()
