"""Checks of what a user passes to the environment: one clear error for each mistake."""

from collections.abc import Mapping
from numbers import Integral
from typing import Any

import numpy as np

from gfo_env.exceptions import EnvironmentSettingsError

from .reward import TERMS, RewardWeights

OPTIONS = ("grasp", "mass", "friction", "gravity")
"""What `reset(options=...)` understands."""


def require(holds: bool, rule: str, value: object) -> None:
    """Raise an EnvironmentSettingsError that says the rule and the value, unless it holds."""
    if not holds:
        raise EnvironmentSettingsError(f"{rule}, not {value!r}.")


def positive_range(name: str, bounds: tuple[float, float]) -> tuple[float, float]:
    """The bounds, in the form of a tuple, as they may come from a file of settings."""
    require(
        len(bounds) == 2 and 0 < bounds[0] <= bounds[1] < np.inf,
        f"{name} must be two positive numbers, the lower first",
        bounds,
    )
    return float(bounds[0]), float(bounds[1])


def checked_weights(given: RewardWeights | Mapping[str, float] | None) -> RewardWeights:
    """The weights, perhaps told by name, as they may come from a file of settings."""
    if given is None or isinstance(given, RewardWeights):
        return given or RewardWeights()
    rule = f"reward_weights are numbers >= 0 by name, of {', '.join(TERMS)}"
    require(isinstance(given, Mapping) and not given.keys() - set(TERMS), rule, given)
    numeric = all(isinstance(weight, int | float) for weight in given.values())
    require(numeric and all(0 <= weight < np.inf for weight in given.values()), rule, given)
    return RewardWeights(**given)


def checked_options(options: dict[str, Any] | None) -> dict[str, Any]:
    """A copy of the options of a reset, each of them known and sensible."""
    fixed = dict(options or {})
    unknown = sorted(fixed.keys() - set(OPTIONS))
    require(not unknown, f"options of reset are {', '.join(OPTIONS)}", unknown)
    for name in ("mass", "friction"):
        if name in fixed:
            value = fixed[name]
            numeric = isinstance(value, int | float | np.integer | np.floating)
            require(
                numeric and 0 < value < np.inf,
                f"options[{name!r}] must be a positive number",
                value,
            )
    if "grasp" in fixed:
        number = fixed["grasp"]
        whole = isinstance(number, Integral)
        require(whole, "options['grasp'] must be the number of a grasp", number)
        fixed["grasp"] = int(number)
    if "gravity" in fixed:
        gravity = np.array(fixed["gravity"])
        fits = gravity.shape == (3,) and gravity.dtype.kind in "iuf"
        fits = fits and bool(np.isfinite(gravity).all())
        require(fits, "options['gravity'] must be three finite numbers", fixed["gravity"])
    return fixed
