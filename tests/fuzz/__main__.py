"""Try many cases that nobody would type; say what came of them, and how to see each defect again.

Example: python -m tests.fuzz --cases 10000 --seed 1
"""

import json
import sys
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import tyro
from rich.console import Console
from rich.table import Table

from tests.fuzz.kinds import KINDS
from tests.fuzz.outcome import DEFECTS, FINE, Outcome
from tests.fuzz.workers import Name, tried


@dataclass(frozen=True)
class Settings:
    """Problems, arguments, meshes, files and settings at their worst: none may do harm."""

    cases: int = 10_000
    """In all, divided among the kinds."""
    seed: int = 0
    """Other seeds make other cases."""
    kinds: tuple[str, ...] = tuple(kind for kind in KINDS if KINDS[kind].share)
    """Which of them to try."""
    only: tuple[str, ...] = ()
    """Single cases as kind:index, whose whole story is told."""
    minutes: float | None = None
    """Stop after so long."""
    json: Path | None = None
    """Write counts and defects here."""


def names(settings: Settings) -> list[Name]:
    """All cases, those of a kind together."""
    if settings.only:
        pairs = (one.rsplit(":", 1) for one in settings.only)
        return [Name(kind, int(index), settings.seed) for kind, index in pairs]
    shares = sum(KINDS[kind].share for kind in settings.kinds)
    return [
        Name(kind, index, settings.seed)
        for kind in settings.kinds
        for index in range(max(round(settings.cases * KINDS[kind].share / shares), 1))
    ]


def main(settings: Settings) -> int:
    """Try all cases; 1 if there is a defect."""
    console = Console()
    console.width = max(console.width, 110)
    unknown = set(settings.kinds) - set(KINDS)
    if unknown:
        console.print(f"no kinds {', '.join(sorted(unknown))}; there are {', '.join(KINDS)}")
        return 2
    counts = {kind: Counter[str]() for kind in KINDS}
    slowest = dict.fromkeys(KINDS, 0.0)
    defects: list[tuple[Name, Outcome]] = []
    started = time.perf_counter()
    for name, outcome in tried(names(settings)):
        counts[name.kind][outcome.word] += 1
        slowest[name.kind] = max(slowest[name.kind], outcome.seconds)
        if settings.only:
            console.print(f"{outcome.word}: {outcome.detail}\n{outcome.trace}", markup=False)
        if not outcome.fine:
            defects.append((name, outcome))
            console.print(
                f"{name.command()}\n    {outcome.word}: {outcome.detail}",
                markup=False,
                soft_wrap=True,
            )
        if settings.minutes is not None and time.perf_counter() - started > 60 * settings.minutes:
            break
    console.print(table(counts, slowest))
    if settings.json is not None:
        found = [
            {"command": name.command(), "word": outcome.word, "detail": outcome.detail}
            for name, outcome in defects
        ]
        result = {"counts": counts, "slowest": slowest, "defects": found}
        settings.json.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    return 1 if defects else 0


def table(counts: dict[str, Counter[str]], slowest: dict[str, float]) -> Table:
    """A row for each kind that was tried."""
    result = Table("kind", "cases", *FINE, *DEFECTS, "slowest [s]")
    for kind, words in counts.items():
        if words:
            row = [str(words.total()), *(str(words[word]) for word in (*FINE, *DEFECTS))]
            result.add_row(kind, *row, f"{slowest[kind]:.1f}")
    total = sum(counts.values(), Counter[str]())
    row = [str(total.total()), *(str(total[word]) for word in (*FINE, *DEFECTS))]
    result.add_row("all", *row, f"{max(slowest.values()):.1f}")
    return result


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Settings)))
