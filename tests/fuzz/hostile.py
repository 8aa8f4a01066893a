"""What callers pass by mistake, or on purpose, in place of what is asked for."""

from collections.abc import Callable
from typing import Any

import numpy as np
import torch


class Stranger:
    """An object that nothing knows."""


_SCALARS: tuple[Any, ...] = (
    *(None, True, -1, 0, 1, 2**70, 0.5, -1.5, 1e200, 1e-300, np.nan, np.inf, -np.inf, 1j),
    *("", "x", "3", b"x", [], (), {}, [1.0, 2.0], {"a": 1}, {1}, np.float32(3), np.array(2.0)),
    *(np.array([]), np.array([1.0, 2.0]), np.array("x"), Stranger(), Stranger, len),
)


def _replaced(number: Any) -> Callable[[np.random.Generator, Any], Any]:
    def change(rng: np.random.Generator, array: Any) -> Any:
        array = np.array(array, dtype=np.float64)
        if array.size:
            array.flat[rng.integers(array.size)] = number
        return array

    return change


_VALUES: dict[str, Callable[[np.random.Generator, Any], Any]] = {
    **{
        f"an entry {n!r}": _replaced(n) for n in (np.nan, np.inf, -np.inf, 1e200, 1e-160, -1.0, 0.0)
    },
    "all NaN": lambda _, array: np.full(array.shape, np.nan),
    "all zero": lambda _, array: np.zeros(array.shape),
    "all huge": lambda _, array: np.full(array.shape, 1e200),
    "negative": lambda _, array: -np.abs(np.asarray(array, dtype=np.float64)) - 1.0,
    "as float32": lambda _, array: np.asarray(array, dtype=np.float32),
    "as integers": lambda _, array: np.nan_to_num(array, posinf=9, neginf=-9).astype(np.int64),
    "as a list": lambda _, array: np.asarray(array).tolist(),
    "in Fortran's order": lambda _, array: np.asfortranarray(array),
    "backwards in memory": lambda _, array: np.array(np.asarray(array)[..., ::-1])[..., ::-1],
    "big-endian": lambda _, array: np.asarray(array, dtype=">f8"),
    "read-only": lambda _, array: np.broadcast_to(np.array(array), np.shape(array)),
}
"""Of the shape that is asked for: these may be answered."""

_TYPES: dict[str, Callable[[np.random.Generator, Any], Any]] = {
    "as complex numbers": lambda _, array: np.asarray(array) + 1j,
    "as objects": lambda _, array: np.full(array.shape, None, dtype=object),
    "as texts": lambda _, array: np.asarray(array).astype(str),
    "a nested list of two lengths": lambda _, array: [[1.0, 2.0], [3.0]],
}
_SHAPES: dict[str, Callable[[np.random.Generator, Any], Any]] = {
    "one too short": lambda _, array: np.array(array)[..., :-1],
    "one too long": lambda _, array: np.concatenate(
        [np.asarray(array), np.asarray(array)[..., -1:]], axis=-1
    ),
    "empty": lambda _, array: np.array(array)[..., :0],
}
"""Of no use to anybody: an answer to these is wrong."""


def of_array(rng: np.random.Generator, array: Any) -> tuple[str, Any, bool]:
    """What it is, something in an array's place, and whether it must be refused."""
    draw = rng.random()
    if draw < 0.4 and array.ndim and array.shape[-1]:
        name = str(rng.choice(list(_SHAPES)))
        return name, _like(array, _SHAPES[name](rng, _host(array))), True
    if draw < 0.75:
        name = str(rng.choice(list(_VALUES)))
        value = _VALUES[name](rng, _host(array))
        return name, value if name == "as a list" else _like(array, value), False
    if draw < 0.85:
        name = str(rng.choice(list(_TYPES)))
        return name, _TYPES[name](rng, _host(array)), False
    if draw < 0.9:
        other = _host(array) if isinstance(array, torch.Tensor) else torch.tensor(_host(array))
        return "of the other library", other, False
    return of_scalar(rng)


def of_scalar(rng: np.random.Generator) -> tuple[str, Any, bool]:
    """The same in the place of a number, a text or an object."""
    value = _SCALARS[rng.integers(len(_SCALARS))]
    return f"{value!r:.30}", value, False


def _host(array: Any) -> Any:
    return array.detach().numpy() if isinstance(array, torch.Tensor) else np.asarray(array)


def _like(array: Any, value: Any) -> Any:
    if not isinstance(array, torch.Tensor):
        return value
    return torch.tensor(np.array(value, dtype=np.asarray(value).dtype.newbyteorder("=")))
