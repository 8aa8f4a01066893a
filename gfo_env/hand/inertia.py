"""The inertia of a URDF's links, made one that PyBullet takes as it is meant.

PyBullet gives a link without inertia 1 kg and 1 kg·m2, sets a tensor that no rigid body can have to
zero, by however little it misses, and reports wrong contact forces of a link whose only collision
shape has the frame of its inertia.
"""

from collections.abc import Callable
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from .elements import number, origin, text_of
from .shapes import Uniform

DENSITY = 1000.0
"""kg/m3 of the shapes of a link that has no inertia."""

FRAME_MASS = 1e-3
"""kg of a link without inertia and shapes: a frame."""

FRAME_MOMENT = 1e-7
"""kg·m2, of a frame about any axis."""

_TENSOR = ("ixx", "ixy", "ixz", "ixy", "iyy", "iyz", "ixz", "iyz", "izz")
_APART = 1e-6
"""m from an inertia's frame to that of the only shape; the engine's error is gone at that."""

_SLACK = 1e-6
"""By this share the largest moment stays below the sum of the others; rounding needs less."""

_LEAST_SHARE = 1e-3
"""Of the largest moment, in place of moments that are not positive."""


def mend_inertia(link: ET.Element, weigh: Callable[[], Uniform | None]) -> str | None:
    """Give a link an inertia that PyBullet takes as it is meant; a good one stays as it is.

    A frame, without inertia and shapes, gets next to none. Shapes without inertia get what they
    weigh at `DENSITY`. Of a tensor that no rigid body has, the smaller moments are raised, half of
    what is missing each, as a flywheel about the largest one's axis has it.

    Args:
        link: is changed in place.
        weigh: what its shapes weigh at 1 kg/m3.

    Returns:
        What was made up, to be told; None for nothing or a frame.

    Raises:
        HandError: a number is none.
    """
    what = f"link {link.get('name')!r}"
    note = _complete(link, weigh, what)
    shapes = link.findall("collision")
    inertial = link.find("inertial")
    assert inertial is not None
    place = origin(inertial, what)
    if len(shapes) == 1 and np.allclose(origin(shapes[0], what), place, rtol=0, atol=1e-9):
        place[0] += _APART
        _set_origin(inertial, place)
    return note


def _complete(link: ET.Element, weigh: Callable[[], Uniform | None], what: str) -> str | None:
    inertial = link.find("inertial")
    place = origin(inertial, what)
    mass_element, tensor_element = link.find("inertial/mass"), link.find("inertial/inertia")
    mass, tensor = 0.0, np.zeros((3, 3))
    if mass_element is not None:
        mass = number(mass_element, "value", f"<mass> of {what}")
    if tensor_element is not None:
        entries = [number(tensor_element, key, f"<inertia> of {what}") for key in _TENSOR]
        tensor = np.reshape(entries, (3, 3))
    moments, axes = np.linalg.eigh(tensor)
    if mass > 0 and moments[2] > 0:
        raised = _raised(moments)
        if raised is None:
            return None
        _replace(link, mass, place, axes * raised @ axes.T)
        return f"{what}: inertia of no rigid body, its smaller moments raised"
    shapes = weigh()
    if mass > 0:
        # the centre of mass is known, the rest is not
        place[3:] = 0.0
        tensor = np.eye(3) * FRAME_MOMENT / FRAME_MASS if shapes is None else _per_mass(shapes)
        _replace(link, mass, place, mass * tensor)
        source = "a small ball" if shapes is None else "its shapes"
        return f"{what}: no moments of inertia, those of {source} taken"
    if shapes is None:
        _replace(link, FRAME_MASS, np.zeros(6), FRAME_MOMENT * np.eye(3))
        return None
    mass = DENSITY * shapes.volume
    _replace(link, mass, np.append(shapes.centre, np.zeros(3)), mass * _per_mass(shapes))
    return f"{what}: no mass, {mass:.3g} kg taken from its shapes"


def _raised(moments: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Principal moments of a rigid body instead of these, ascending; None if they are already."""
    raised = np.where(moments > 0, moments, _LEAST_SHARE * moments[2])
    missing = moments[2] * (1 + _SLACK) - (raised[0] + raised[1])
    if missing > 0:
        raised[:2] += missing / 2
    return None if np.array_equal(raised, moments) else raised


def _per_mass(shapes: Uniform) -> NDArray[np.float64]:
    """(3, 3) m2."""
    return shapes.tensor / shapes.volume


def _replace(
    link: ET.Element, mass: float, place: NDArray[np.float64], tensor: NDArray[np.float64]
) -> None:
    inertial = link.find("inertial")
    if inertial is None:
        inertial = ET.SubElement(link, "inertial")
    for child in list(inertial):
        inertial.remove(child)
    _set_origin(inertial, place)
    ET.SubElement(inertial, "mass", value=text_of([mass]))
    entries = zip(_TENSOR, ((tensor + tensor.T) / 2).ravel(), strict=True)
    ET.SubElement(inertial, "inertia", {key: text_of([value]) for key, value in entries})


def _set_origin(inertial: ET.Element, place: NDArray[np.float64]) -> None:
    found = inertial.find("origin")
    if found is None:
        found = ET.SubElement(inertial, "origin")
    found.set("xyz", text_of(place[:3]))
    found.set("rpy", text_of(place[3:]))
