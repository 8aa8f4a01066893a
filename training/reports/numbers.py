"""Numbers as pages write them; a number that does not exist is a word."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

NONE = "none"


def times(microseconds: float | None) -> str:
    """A time in us to three digits."""
    if microseconds is None or not math.isfinite(microseconds):
        return NONE
    digits = max(0, 2 - math.floor(math.log10(max(microseconds, 1e-3))))
    return f"{microseconds:,.{min(digits, 2)}f}"


def factor(value: float) -> str:
    """A factor, two digits or an integer."""
    return f"{value:,.0f}" if value >= 10 else f"{value:.2g}"


def ratio(value: float | None) -> str:
    """How many times as fast."""
    return NONE if value is None or not math.isfinite(value) else f"{factor(value)}x"


def share(value: float | None) -> str:
    """A share in per cent; neither 0 nor 100 unless it is exactly that."""
    if value is None or not math.isfinite(value):
        return NONE
    if value in (0.0, 1.0):
        return f"{value:.0%}"
    text = f"{value:.1%}"
    return {"0.0%": "<0.1%", "100.0%": ">99.9%"}.get(text, text)


def small(value: float | None) -> str:
    """A small number with its power of ten; below 1e-15 it is rounding."""
    if value is None or not math.isfinite(value):
        return NONE
    if value == 0.0:
        return "0"
    return "<1e-15" if abs(value) < 1e-15 else scientific(value)


def percentage(value: float | None) -> str:
    """A relative size in per cent, with two digits at least; below 1e-9 it is tolerance."""
    if value is None or not math.isfinite(value):
        return NONE
    if abs(value) < 1e-9:
        return "0%"
    return f"{100 * value:,.0f}%" if abs(value) >= 0.1 else f"{100 * value:.2g}%"


def triple(values: tuple[float | None, ...]) -> str:
    """Small numbers side by side."""
    return " / ".join(small(value) for value in values)


def listed(names: list[str]) -> str:
    """Names as a list in words."""
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} and {names[-1]}"


def rate(per_second: float) -> str:
    """A rate to three digits."""
    if per_second >= 1000:
        return f"{round(per_second, 3 - len(str(int(per_second)))):,.0f}"
    return f"{per_second:.3g}"


def scientific(value: Any) -> str:
    """A number to one digit with its power of ten."""
    return f"{float(value):.0e}" if value else "0"


def spread(values: NDArray[np.float64]) -> str:
    """Median, 90th percentile and largest of some values."""
    return " / ".join(scientific(value) for value in np.percentile(values, [50, 90, 100]))


def percent(values: NDArray[np.float64]) -> str:
    """Median and largest of some shares."""
    shares = np.percentile(values, [50, 100])
    return " / ".join(f"{value:.0%}" if value >= 0.01 else f"{value:.1%}" for value in shares)


def yes(value: bool) -> str:
    """A truth value as a word."""
    return "yes" if value else "no"


def relative(value: Any, optimum: float) -> Any:
    """Distance from the optimum over its size."""
    return np.abs(np.asarray(value) - optimum) / abs(optimum)


def drop(losses: NDArray[np.float64]) -> str:
    """First and last of the losses (iterations,), in words."""
    return f"from {losses[0]:.2g} to {losses[-1]:.1g} in {len(losses):,} iterations"
