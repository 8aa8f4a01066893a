"""Cases in a process of its own, which may crash, hang or eat memory without harm to the rest."""

import multiprocessing
import os
import resource
import signal
import tempfile
import time
import traceback
import zlib
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from tests.fuzz.outcome import Outcome, listen, outcome_of

SECONDS = 30.0
"""That a case may take."""

MEMORY = 4 * 2**30
"""Bytes that a case may take, beyond what the loaded libraries do."""

_START_SECONDS = 300.0
"""That a worker may take to load and compile what its cases need."""


@dataclass(frozen=True, order=True)
class Name:
    """What a case is made of, and found again by.

    Args:
        kind: of `tests.fuzz.kinds.KINDS`.
        index: of the case in its kind.
        seed: of the run.
    """

    kind: str
    index: int
    seed: int

    def generator(self) -> np.random.Generator:
        """The source of everything random in it."""
        return np.random.default_rng([self.seed, zlib.crc32(self.kind.encode()), self.index])

    def command(self) -> str:
        """What tries it again."""
        return f"python -m tests.fuzz --only {self.kind}:{self.index} --seed {self.seed}"


def tried(names: Iterable[Name]) -> Iterator[tuple[Name, Outcome]]:
    """Every case with its outcome, in order; a worker that is lost is replaced."""
    worker: _Worker | None = None
    try:
        for name in names:
            if worker is None or worker.kind != name.kind:
                if worker is not None:
                    worker.stop()
                worker = _Worker(name.kind)
            outcome = worker.outcome(name)
            if outcome.word in ("crash", "hang", "memory"):
                worker.stop()
                worker = None
            yield name, outcome
    finally:
        if worker is not None:
            worker.stop()


class _Worker:
    """A process that tries cases of one kind."""

    def __init__(self, kind: str) -> None:
        self.kind = kind
        context = multiprocessing.get_context("spawn")
        self._ours, theirs = context.Pipe()
        # ours, because a process that is killed removes nothing
        self._folder = tempfile.TemporaryDirectory(prefix="graspforce-fuzz-")
        self._process = context.Process(target=_work, args=(kind, theirs, self._folder.name))
        self._process.start()
        theirs.close()
        why = self._received() if self._ours.poll(_START_SECONDS) else "in time"
        if why != "":
            self.stop()
            raise RuntimeError(f"the worker for {kind} did not start: {why}")

    def outcome(self, name: Name) -> Outcome:
        started = time.perf_counter()
        self._ours.send(name)
        told = ""
        while True:
            left = SECONDS - (time.perf_counter() - started)
            if not self._ours.poll(max(left, 0.0)):
                return Outcome("hang", f"{told}: no end after {SECONDS:.0f} s", seconds=SECONDS)
            received = self._received()
            seconds = time.perf_counter() - started
            if isinstance(received, str):
                told = received
            elif received is None:
                return Outcome("crash", f"{told}: the process {self._end()}", seconds=seconds)
            else:
                about = f"{told}: " if told and not received.fine else ""
                return replace(received, detail=about + received.detail, seconds=seconds)

    def _end(self) -> str:
        self._process.join(10.0)
        code = self._process.exitcode or 0
        how = signal.Signals(-code).name if code < 0 else f"exit status {code}"
        return f"ended with {how}"

    def _received(self) -> Any:
        with suppress(EOFError, ConnectionError):
            return self._ours.recv()
        return None

    def stop(self) -> None:
        """End the process and what it has started."""
        assert self._process.pid is not None
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.kill()
        self._process.join()
        self._ours.close()
        with suppress(OSError):
            self._folder.cleanup()


def _work(kind: str, pipe: Connection, folder: str) -> None:
    os.setsid()  # so that its own children end with it
    quiet = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(quiet, stream)
    from tests.fuzz.kinds import KINDS

    os.chdir(folder)
    tempfile.tempdir = folder
    os.environ["XDG_CACHE_HOME"] = str(Path(folder, "cache"))
    try:
        prepare, case = KINDS[kind].load()
        prepare()
    except Exception:
        pipe.send(traceback.format_exc())
        raise
    listen(pipe.send)
    _limit()
    pipe.send("")
    with suppress(EOFError):
        while True:
            pipe.send(outcome_of(case, pipe.recv().generator()))


def _limit() -> None:
    with open("/proc/self/statm", encoding="ascii") as stream:
        pages = int(stream.read().split()[0])
    most = pages * resource.getpagesize() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
