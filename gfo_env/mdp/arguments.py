"""Checks of what a user passes to the environment: one clear error for each mistake."""

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from gfo_env.checks import checked_array, is_number, is_whole
from gfo_env.exceptions import EnvironmentSettingsError

LEAST, MOST = 1e-6, 1e6
"""Between these lies every number that is not zero, in SI units: far beyond what a hand can hold,
and with room for all products of them in the single precision of observations."""

OPTIONS = ("grasp", "mass", "friction", "gravity")
"""What `reset(options=...)` understands."""


def require(holds: bool, rule: str, value: object) -> None:
    """Raise an EnvironmentSettingsError that says the rule and the value, unless it holds."""
    if not holds:
        raise EnvironmentSettingsError(f"{rule}, not {value!r}.")


def number(name: str, value: Any, *, zero: bool = False) -> float:
    """A number between `LEAST` and `MOST`, or perhaps zero."""
    fits = is_number(value) and (LEAST <= value <= MOST or (zero and value == 0))
    least = f"{'0 or ' if zero else ''}a number from {LEAST:g} to {MOST:g}"
    require(fits, f"{name} must be {least}", value)
    return float(value)


def number_range(name: str, bounds: Any) -> tuple[float, float]:
    """Two such numbers, the lower first: a tuple, a list, as from a file of settings, or an array.

    One number is none: whether it is the lowest, the highest or both is for the user to say.
    """
    ends = bounds.tolist() if isinstance(bounds, np.ndarray) else bounds
    fits = isinstance(ends, tuple | list) and len(ends) == 2 and all(map(is_number, ends))
    require(
        fits and LEAST <= ends[0] <= ends[1] <= MOST,
        f"{name} must be two numbers from {LEAST:g} to {MOST:g}, the lower first, (x, x) for x "
        "alone",
        bounds,
    )
    return float(ends[0]), float(ends[1])


def whole_number(name: str, value: Any, least: int, most: int) -> int:
    """A whole number between two others, whole by its type: 5.0 is none."""
    fits = is_whole(value) and least <= value <= most
    require(fits, f"{name} must be a whole number from {least} to {most}", value)
    return int(value)


def flag(name: str, value: Any) -> bool:
    """True or False."""
    require(isinstance(value, bool | np.bool_), f"{name} must be True or False", value)
    return bool(value)


def choice(name: str, value: Any, choices: Collection[str]) -> str:
    """One of several words."""
    words = " or ".join(map(repr, choices))
    require(isinstance(value, str) and value in choices, f"{name} must be {words}", value)
    return str(value)


def checked_seed(seed: Any) -> int | None:
    """A seed of all randomness, or None."""
    require(
        seed is None or (is_whole(seed) and seed >= 0),
        "seed must be None or a whole number >= 0",
        seed,
    )
    return None if seed is None else int(seed)


def checked_options(options: Any) -> dict[str, Any]:
    """A copy of the options of a reset, each of them known and sensible."""
    rule = f"options of reset are {', '.join(OPTIONS)} by name"
    require(options is None or isinstance(options, Mapping), rule, options)
    fixed = dict(options or {})
    unknown = [name for name in fixed if name not in OPTIONS]
    require(not unknown, rule, unknown)
    for name in ("mass", "friction"):
        if name in fixed:
            fixed[name] = number(f"options[{name!r}]", fixed[name])
    if "grasp" in fixed:
        given = fixed["grasp"]
        require(is_whole(given), "options['grasp'] must be the number of a grasp", given)
        fixed["grasp"] = int(given)
    if "gravity" in fixed:
        name = "options['gravity']"
        gravity = checked_array(name, fixed["gravity"], (3,), EnvironmentSettingsError)
        require(
            bool(np.abs(gravity).max() <= MOST),
            f"{name} must be three numbers of size {MOST:g} at most",
            fixed["gravity"],
        )
        fixed["gravity"] = gravity.copy()
    return fixed
