"""Numbers and tables as the report writes them."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def relative(value: Any, optimum: float) -> Any:
    """Distance from the optimum over its size."""
    return np.abs(np.asarray(value) - optimum) / abs(optimum)


def drop(losses: Array) -> str:
    """First and last of the losses (iterations,), in words."""
    return f"from {losses[0]:.2g} to {losses[-1]:.1g} in {len(losses):,} iterations"


def scientific(value: Any) -> str:
    """A number to one digit with its power of ten."""
    return f"{float(value):.0e}" if value else "0"


def spread(values: Array) -> str:
    """Median, 90th percentile and largest of some values."""
    return " / ".join(scientific(value) for value in np.percentile(values, [50, 90, 100]))


def percent(values: Array) -> str:
    """Median and largest of some shares."""
    shares = np.percentile(values, [50, 100])
    return " / ".join(f"{value:.0%}" if value >= 0.01 else f"{value:.1%}" for value in shares)


def yes(value: bool) -> str:
    """A truth value as a word."""
    return "yes" if value else "no"


def table(headings: Sequence[str], rows: Iterable[Sequence[str]], align: str) -> str:
    """A Markdown table; `align` has a letter a column, l or r, and the last one is repeated."""
    letters = align.ljust(len(headings), align[-1])
    rule = ["---:" if letter == "r" else "---" for letter in letters]
    return "\n".join(f"| {' | '.join(line)} |" for line in (headings, rule, *rows))
