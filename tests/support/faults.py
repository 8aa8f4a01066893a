"""Commands that are killed, interrupted or run out of room, and what they leave."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from .commands import ROOT
from .seeds import NUMBER

MANY = bool(os.environ.get("GRASPFORCE_FAULTS"))
"""Whether somebody has time, as `make faults` has."""

DRAWS = int(os.environ.get("GRASPFORCE_FAULTS") or 1)
"""How often each command is killed."""

_GONE = 10.0
"""s in which nothing of a command may be left, whatever happened to it."""


class Command:
    """`python scripts/<name>.py <arguments>` in a session of its own, run in a folder.

    Args:
        folder: paths among the arguments are below it.
        name: of the script.
        arguments: of the command line.
        limit: KiB, the longest file that it can write; None for no limit.
    """

    def __init__(
        self, folder: Path, name: str, *arguments: object, limit: int | None = None
    ) -> None:
        words = [sys.executable, str(ROOT / "scripts" / f"{name}.py"), *map(str, arguments)]
        if limit is not None:
            words = ["bash", "-c", f'ulimit -f {limit}; exec "$@"', "bash", *words]
        folder.mkdir(parents=True, exist_ok=True)
        self._began = time.monotonic()
        self._process = subprocess.Popen(
            words,
            cwd=folder,
            env=os.environ | {"PYTHONPATH": str(ROOT)},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            # who runs in the background of a shell ignores interruptions, and so would its children
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        )

    def end(self) -> tuple[int, list[str], float]:
        """Wait for it: exit status, lines of complaint, and seconds that it took."""
        _, complaints = self._process.communicate(timeout=600)
        took = time.monotonic() - self._began
        self._gone()
        # loky's own process may say that it has cleaned up
        others = ("build time", "resource_tracker", "warnings.warn")
        lines = [
            line for line in complaints.splitlines() if not any(other in line for other in others)
        ]
        return self._process.returncode, lines, took

    def kill(self, after: float) -> bool:
        """`kill -9` after so many seconds, of the first process alone; whether it still ran."""
        try:
            self._process.wait(after)
        except subprocess.TimeoutExpired:
            self._process.kill()
        self._process.wait()
        self._gone()
        self._process.stderr.close()  # type: ignore[union-attr]
        return self._process.returncode == -signal.SIGKILL

    def interrupt(self) -> tuple[int, list[str]]:
        """Ctrl-C, which every process of a terminal's session gets: exit status and complaints."""
        os.killpg(self._process.pid, signal.SIGINT)
        status, complaints, _ = self.end()
        return status, complaints

    def wait_for(self, path: Path) -> None:
        """Wait until it has made a file or a folder."""
        while not path.exists():
            assert self._process.poll() is None, "it ended before"
            time.sleep(0.02)

    def _gone(self) -> None:
        """See that no process of the session is left, or will be soon."""
        begin = time.monotonic()
        while left := _session(self._process.pid):
            assert time.monotonic() - begin < _GONE, f"left: {left}"
            time.sleep(0.1)


def _session(number: int) -> list[str]:
    """Command lines of the processes of a session that have not ended."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, _, session = stat.read_text().rpartition(")")[2].split()[:4]
            if int(session) == number and state != "Z":
                found.append(stat.with_name("cmdline").read_text().replace("\0", " "))
        except (FileNotFoundError, ProcessLookupError):
            continue  # it has just ended
    return found


def moments(seed: int, longest: float) -> list[float]:
    """s, one for each draw: never the same ones twice where others are asked for."""
    rng = np.random.default_rng([seed, NUMBER, DRAWS])
    return rng.uniform(0.2 * longest, longest, DRAWS).tolist()
