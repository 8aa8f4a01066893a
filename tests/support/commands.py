"""Commands as a user runs them, and what bad input must look like."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def run_command(command: str, *arguments: object) -> "subprocess.CompletedProcess[str]":
    """`python scripts/<command>.py <arguments>`, to its end."""
    return subprocess.run(
        [sys.executable, f"scripts/{command}.py", *map(str, arguments)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )


def assert_one_clear_line(done: "subprocess.CompletedProcess[str]", message: str) -> None:
    """Bad input ends with code 2 and one line that names what is wrong."""
    assert done.returncode == 2, done.stderr
    lines = [line for line in done.stderr.splitlines() if "build time" not in line]
    assert len(lines) == 1
    assert lines[0].startswith("error: ")
    assert message in lines[0]
