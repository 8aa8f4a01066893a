"""Cases that do what no case should, to see that it is noticed."""

import os
import signal
import time

import numpy as np

from solvers import SolverError
from tests.fuzz.outcome import WrongAnswer, tell


def prepare() -> None:
    """Nothing to load."""


def try_nothing_good(rng: np.random.Generator) -> str:
    """By its number: an answer, a refusal, and each of the defects."""
    number = int(rng.bit_generator.seed_seq.entropy[-1])  # type: ignore[attr-defined]
    tell(f"number {number}")
    if number == 1:
        raise SolverError("no")
    if number == 2:
        raise WrongAnswer("two and two is five")
    if number == 3:
        raise KeyError("not ours")
    if number == 4:
        os.kill(os.getpid(), signal.SIGSEGV)
    if number == 5:
        time.sleep(600.0)
    if number == 6:
        np.ones(2**33)
    if number == 7:
        raise SolverError(" ")
    return f"drew {rng.random()}"
