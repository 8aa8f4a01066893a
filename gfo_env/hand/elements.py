"""Names and numbers of a URDF's elements, and its faults: one error names them all."""

import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from gfo_env.exceptions import HandError


@contextmanager
def noted(faults: list[str]) -> Iterator[None]:
    """Collect what a `HandError` says instead of raising it."""
    try:
        yield
    except HandError as error:
        faults.append(str(error))


def refuse(faults: Sequence[str], what: object) -> None:
    """Raise one `HandError` that names every fault of something, unless there is none."""
    faults = list(dict.fromkeys(faults))
    if len(faults) == 1:
        raise HandError(faults[0])
    if faults:
        reasons = "".join(f"\n- {fault}" for fault in faults)
        raise HandError(f"{what} cannot be used, for {len(faults)} reasons:{reasons}")


def name_of(element: ET.Element) -> str:
    """The name of a link or joint."""
    name = element.get("name")
    if not name:
        raise HandError(f"A <{element.tag}> of the URDF has no name: name it.")
    return name


def number(element: ET.Element, key: str, what: str, default: float = 0.0) -> float:
    """The number in an attribute; `what` the element is stands in the error."""
    text = element.get(key)
    try:
        value = default if text is None else float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise HandError(f"The {what} has {key}={text!r}: it must be a number.")
    return value


def vector(element: ET.Element, key: str, what: str) -> NDArray[np.float64]:
    """(3,) the numbers in an attribute, 0 without it."""
    return _values(element.get(key, "0 0 0"), key, 3, what)


def sizes(element: ET.Element, key: str, count: int, what: str) -> NDArray[np.float64]:
    """(count,) the numbers in an attribute, positive all of them."""
    values = _values(text := element.get(key, ""), key, count, what)
    if not np.all(values > 0):
        raise HandError(f"The {what} has {key}={text!r}: it must be above 0.")
    return values


def origin(element: ET.Element | None, what: str) -> NDArray[np.float64]:
    """(6,) position [m] and fixed-axis angles [rad] in an element's `<origin>`, 0 without one."""
    found = None if element is None else element.find("origin")
    if found is None:
        return np.zeros(6)
    return np.append(*(vector(found, key, f"<origin> of {what}") for key in ("xyz", "rpy")))


def _values(text: str, key: str, count: int, what: str) -> NDArray[np.float64]:
    try:
        values = np.array(text.split(), dtype=np.float64)
    except ValueError:
        values = np.empty(0)
    if values.shape != (count,) or not np.isfinite(values).all():
        wanted = {1: "a number", 3: "three numbers"}[count]
        raise HandError(f"The {what} has {key}={text!r}: it must be {wanted}.")
    return values


def listed(names: Iterable[str]) -> str:
    """Names as they stand in an error."""
    return ", ".join(map(repr, names))


def text_of(values: Iterable[float]) -> str:
    """Numbers as they stand in an attribute, to the last bit."""
    return " ".join(repr(float(value)) for value in values)
