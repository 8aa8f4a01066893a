"""Arguments checked where they come in: numbers and arrays, or one error that says what is wanted.

Compiled code reads what it is given, whatever its length; nothing reaches it but through here or
through the problem's own arrays (`GraspForceProblem.plain_arrays`).
"""

from numbers import Integral, Real
from typing import Any

import numpy as np
from array_api_compat import is_numpy_array, is_torch_array

from solvers.arrays import Array
from solvers.exceptions import ProblemError, SolverError

_FLOAT = np.dtype(np.float64)


def plain_array(name: str, value: Any, shape: tuple[int, ...]) -> Array:
    """The value as a float64 array in the layout of memory that compiled code takes.

    Arrays that are such already are handed on, others are copied: numpy arrays, torch tensors and
    lists of real numbers.

    Args:
        name: of the argument, for the error.
        value: what was given.
        shape: that it must have.

    Raises:
        ProblemError: for another shape, or for what are no real numbers.
    """
    if is_torch_array(value):
        value = value.detach().cpu()
    try:
        array = np.asarray(value)
    except (ValueError, TypeError) as error:
        raise ProblemError(f"{name} is not a rectangular array of numbers") from error
    if array.dtype.kind not in "biuf":
        raise ProblemError(
            f"{name} must be an array of real numbers of the shape {shape}, not "
            f"{type(value).__name__} of the data type {array.dtype}"
        )
    check_shape(name, array, shape)
    return plain(array, _FLOAT)


def plain(array: np.ndarray, kind: np.dtype[Any]) -> np.ndarray:
    """The array in this data type, contiguous and writable: numba compiles anew for any other.

    What a problem shows is a read-only view of an array of its own; compiled code, which writes to
    none of its arguments, is given that array.
    """
    flags, owner = array.flags, array.base
    if array.dtype == kind and flags.c_contiguous and flags.aligned:
        if flags.writeable:
            return array
        if isinstance(owner, np.ndarray) and owner.dtype == kind and owner.size == array.size:
            owned = owner.flags
            if owned.writeable and owned.c_contiguous:
                return owner.reshape(array.shape)
    return np.array(array, dtype=kind, order="C")


def check_shape(name: str, array: Any, shape: tuple[int, ...]) -> None:
    """Refuse an array of another shape.

    Raises:
        ProblemError: with the shape that is wanted.
    """
    found = getattr(array, "shape", None)
    if found is None:
        raise ProblemError(f"{name} must be an array of shape {shape}, not {type(array).__name__}")
    if tuple(found) != shape:
        raise ProblemError(f"{name} has shape {tuple(found)} but must have {shape}")


def check_vectors(name: str, array: Any, batch: tuple[int, ...], core: tuple[int, ...]) -> None:
    """Refuse what is no numpy array or tensor of this core shape for a batch.

    Args:
        name: of the argument, for the error.
        array: (..., *core); its leading dimensions may be any that broadcast with the batch.
        batch: dimensions of the problem.
        core: last dimensions of the array.

    Raises:
        ProblemError: with the shape that is wanted.
    """
    shape = getattr(array, "shape", None)
    if shape == (*batch, *core):
        return
    if not (is_numpy_array(array) or is_torch_array(array)):
        raise ProblemError(
            f"{name} must be a numpy array or a torch tensor, as the problem is, of the shape "
            f"{(*batch, *core)}, not {type(array).__name__}"
        )
    lead = array.ndim - len(core)
    fits = lead >= 0 and tuple(array.shape[lead:]) == core
    if fits:
        try:
            np.broadcast_shapes(array.shape[:lead], batch)
        except ValueError:
            fits = False
    if not fits:
        raise ProblemError(
            f"{name} has shape {tuple(array.shape)} but must have {(*batch, *core)}, or leading "
            "dimensions that broadcast with those of the problem"
        )


def whole_number(name: str, value: Any, least: int) -> int:
    """The value as an int, if it is a whole number of at least `least`.

    Raises:
        SolverError: otherwise.
    """
    if isinstance(value, bool) or not isinstance(value, Integral) or value < least:
        raise SolverError(f"{name} is {value!r}; {name} must be a whole number of at least {least}")
    return int(value)


def real_number(
    name: str, value: Any, above: float, below: float, *, closed: bool = False
) -> float:
    """The value as a float, if it is a real number strictly between the two.

    Args:
        name: of the argument, for the error.
        value: what was given.
        above: what it must exceed.
        below: what must exceed it.
        closed: whether it may be as large as `below`.

    Raises:
        SolverError: otherwise.
    """
    number = isinstance(value, Real) and not isinstance(value, bool)
    if not number or not (above < value < below or (closed and value == below)):
        wanted = f"lie between {above:g} and {below:g}"
        if above == 0.0 and below == np.inf:
            wanted = "be positive" if closed else "be positive and finite"
        raise SolverError(f"{name} is {value!r}; {name} must {wanted}")
    return float(value)
