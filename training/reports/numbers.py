"""Numbers as the benchmark's report writes them; a number that does not exist is a word."""

import math

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
    return "<1e-15" if abs(value) < 1e-15 else f"{value:.0e}"


def percentage(value: float | None) -> str:
    """A relative size in per cent, with two digits; below 1e-9 it is tolerance."""
    if value is None or not math.isfinite(value):
        return NONE
    return "0%" if abs(value) < 1e-9 else f"{100 * value:.2g}%"


def triple(values: tuple[float | None, ...]) -> str:
    """Small numbers side by side."""
    return " / ".join(small(value) for value in values)


def listed(names: list[str]) -> str:
    """Names as a list in words."""
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} and {names[-1]}"
