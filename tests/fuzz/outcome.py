"""What may come of a case: a right answer, one clear error of the project's own, or a defect."""

import traceback
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from solvers import GraspForceError

Word = Literal["answered", "refused", "wrong", "foreign", "crash", "hang", "memory"]

FINE: tuple[Word, ...] = ("answered", "refused")
DEFECTS: tuple[Word, ...] = ("wrong", "foreign", "crash", "hang", "memory")
"""A wrong answer; an error that is not of the project's tree; the process killed by a signal; no
end in time; memory beyond the limit."""


class WrongAnswer(Exception):
    """An answer that is not right, or the refusal of what is."""


class Refused(Exception):
    """What ends a case where the project says no, in its own words."""


_LISTENERS: list[Callable[[str], None]] = []


def tell(what: str) -> None:
    """Say what a case is about to try, for whoever is left if the process is not."""
    for listener in _LISTENERS:
        listener(what)


def listen(listener: Callable[[str], None]) -> None:
    """Hear what cases tell."""
    _LISTENERS.append(listener)


@dataclass(frozen=True)
class Outcome:
    """How a case ended.

    Args:
        word: see `FINE` and `DEFECTS`.
        detail: the first line that says what happened.
        trace: the whole of it, for whoever looks closer.
        seconds: that it took.
    """

    word: Word
    detail: str
    trace: str = ""
    seconds: float = 0.0

    @property
    def fine(self) -> bool:
        return self.word in FINE


Case = Callable[[np.random.Generator], str]
"""Draws its input from the generator, tries it, and returns a word about what it was."""


def outcome_of(case: Case, rng: np.random.Generator) -> Outcome:
    """Try a case in this process."""
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            return Outcome("answered", case(rng))
    except WrongAnswer as error:
        return Outcome("wrong", str(error), traceback.format_exc())
    except (Refused, GraspForceError) as error:
        return _refusal(error)
    except MemoryError as error:
        return Outcome("memory", repr(error), traceback.format_exc())
    # whatever else there is, is what is looked for
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise
        what = f"{type(error).__name__}: {error}".splitlines() or [""]
        return Outcome("foreign", f"{what[0]} [{_place(error)}]", traceback.format_exc())


def _refusal(error: Exception) -> Outcome:
    message = str(error).strip()
    if not message:
        return Outcome("wrong", "an error without a word", traceback.format_exc())
    return Outcome("refused", f"{type(error).__name__}: {message.splitlines()[0]}")


def _place(error: BaseException) -> str:
    """The deepest line of the project that the error passed."""
    frames = traceback.extract_tb(error.__traceback__)
    ours = [f for f in frames if "/solvers/" in f.filename or "/gfo_env/" in f.filename]
    ours = ours or [f for f in frames if "/training/" in f.filename] or list(frames)
    last = ours[-1]
    return f"{last.filename.rsplit('/', 2)[-1]}:{last.lineno}" if ours else ""
