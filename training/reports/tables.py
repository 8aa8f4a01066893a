"""Markdown tables."""

from collections.abc import Iterable, Sequence


def table(headings: Sequence[str], rows: Iterable[Sequence[str]], align: str = "lr") -> str:
    """A Markdown table; `align` has a letter a column, l or r, and the last one is repeated."""
    letters = align.ljust(len(headings), align[-1])
    rule = ["---:" if letter == "r" else "---" for letter in letters]
    return "\n".join(f"| {' | '.join(line)} |" for line in (headings, rule, *rows))
