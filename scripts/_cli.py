"""What every command shares: arguments from a dataclass, one clear line on bad input."""

import json
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol, TypeVar

# Problems are small, and processes fill the cores: threads inside them get in each other's way.
# Set before anything loads numpy or torch.
os.environ.setdefault("OMP_NUM_THREADS", "1")

import tyro

from solvers.exceptions import GraspForceError


class _Settings(Protocol):
    @property
    def json(self) -> Path | None: ...


Settings = TypeVar("Settings", bound=_Settings)


def run_cli(settings: type[Settings], main: Callable[[Settings], None]) -> None:
    """Parse the command line into `settings` and run `main`; exit with 2 on bad input.

    A path that cannot be read or written is bad input, too.
    """
    arguments = tyro.cli(settings)
    # a polite kill ends like an interruption: workers stop, and what is finished is kept
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        expect_file(arguments.json)
        main(arguments)
    except (GraspForceError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(130)


def expect_file(path: Path | None) -> None:
    """Find out before the work, not after it, that a result cannot be written there."""
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_dir():
            raise IsADirectoryError(f"{path} is a folder; name a file to write the result to")


def write_json(path: Path | None, result: Any) -> None:
    """Write a result where the user asked for it, if they did."""
    if path is not None:
        path.write_text(json.dumps(result, indent=2) + "\n")
