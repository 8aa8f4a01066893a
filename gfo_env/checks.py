"""Checks of what users hand over: numbers, and arrays of stated shapes; one clear error each."""

from collections.abc import Mapping
from numbers import Integral, Real
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from gfo_env.exceptions import GeometryError
from solvers.arrays import Array

Shape = tuple[int | str, ...]
"""Lengths of an array's dimensions: numbers, or names of what may have any length. Arrays that are
checked together agree in lengths of one name; "3n" is three times what "n" is."""


def is_number(value: object) -> bool:
    """Whether a value is one real number, of Python or numpy; truth values and texts are none."""
    return isinstance(value, Real) and not isinstance(value, bool)


def is_whole(value: object) -> bool:
    """Whether a value is a whole number by its type: 5.0 is none."""
    return isinstance(value, Integral) and not isinstance(value, bool)


def checked_array(
    name: str,
    value: Any,
    shape: Shape,
    error: type[Exception] = GeometryError,
    *,
    batched: bool = False,
) -> Array:
    """`checked_arrays` of one."""
    return checked_arrays({name: value}, {name: shape}, error, batched=batched)[0]


def checked_arrays(
    values: Mapping[str, Any],
    shapes: Mapping[str, Shape],
    error: type[Exception] = GeometryError,
    *,
    batched: bool = False,
) -> tuple[Array, ...]:
    """The values as finite float64 arrays of these shapes, in their order.

    Args:
        values: arrays, or what numpy makes one of, by name.
        shapes: of each.
        error: for values that are no numbers, have other shapes, or are not finite.
        batched: whether dimensions of a batch may stand in front.
    """
    lengths: dict[str, int] = {}
    arrays = []
    for name, shape in shapes.items():
        array = _numbers(name, values[name], error)
        cores = len(shape)
        fits = array.ndim == cores or (batched and array.ndim > cores)
        found = _lengths(array.shape[array.ndim - cores :], shape, lengths) if fits else None
        if found is None:
            raise error(_misfit(name, array.shape, shape, lengths, batched))
        if not np.isfinite(array).all():
            raise error(f"{name} must be finite.")
        lengths |= found
        arrays.append(array)
    return tuple(arrays)


def _numbers(name: str, value: Any, error: type[Exception]) -> Array:
    try:
        given = np.asarray(value)
        plain = given.dtype.kind in "iuf"
        if plain or (given.dtype.kind == "O" and all(map(is_number, given.flat))):
            return given.astype(np.float64, copy=False)
    # arrays of other libraries have their own errors for what cannot become an array of numpy
    except (TypeError, ValueError, RuntimeError, OverflowError) as reason:
        raise error(f"{name} must be an array of numbers: {reason}") from reason
    raise error(f"{name} must be an array of numbers, not of {given.dtype}.")


def _lengths(
    found: tuple[int, ...], shape: Shape, known: Mapping[str, int]
) -> dict[str, int] | None:
    """What the names of a shape stand for; None if the dimensions found are others."""
    lengths = dict(known)
    for length, wanted in zip(found, shape, strict=True):
        if isinstance(wanted, int):
            fits = length == wanted
        else:
            times, name = _parts(wanted)
            fits = length == times * lengths.setdefault(name, length // times)
        if not fits:
            return None
    return lengths


def _parts(name: str) -> tuple[int, str]:
    """3 and "n" of "3n", 1 and "n" of "n"."""
    return int(name[:-1] or 1), name[-1]


def _misfit(
    name: str, found: tuple[int, ...], shape: Shape, known: Mapping[str, int], batched: bool
) -> str:
    wanted = ["..."] if batched else []
    for length in shape:
        times, letter = (0, "") if isinstance(length, int) else _parts(length)
        wanted.append(str(times * known[letter] if letter in known else length))
    cure = ""
    if len(found) == len(shape) > 1 and _lengths(found[::-1], shape, known) is not None:
        cure = ": transpose it"
    elif len(found) > len(shape) and _lengths(found[-len(shape) :], shape, known) is not None:
        cure = ": one of a batch at a time"
    return f"{name} must have shape ({', '.join(wanted)}), not {found}{cure}."


class CheckedArrays:
    """Base of frozen dataclasses of arrays, which are checked and copied when one is made.

    Attributes:
        SHAPES: of the fields, in their order.
        NUMBERS: fields of whole numbers; the others are finite and float64.
    """

    SHAPES: ClassVar[Mapping[str, Shape]]
    NUMBERS: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self) -> None:
        arrays = checked_arrays(vars(self), self.SHAPES)
        for name, array in zip(self.SHAPES, arrays, strict=True):
            kind: Any = np.float64
            if name in self.NUMBERS:
                kind = np.int64
                if not np.array_equal(array, array.astype(kind)):
                    raise GeometryError(f"{name} must be whole numbers.")
            object.__setattr__(self, name, np.array(array, dtype=kind, order="C"))

    @classmethod
    def unchecked(cls, *arrays: NDArray[Any]) -> Self:
        """One of arrays in the order of the fields that are valid by construction: none is copied.

        For the loops of the simulation; whoever has data from elsewhere makes one as usual.
        """
        made = object.__new__(cls)
        vars(made).update(zip(cls.SHAPES, arrays, strict=True))
        return made
