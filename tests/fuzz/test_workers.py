"""What cases do to their process is noticed, and does no harm to the next."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.fuzz import workers
from tests.fuzz.workers import Name, tried
from tests.support.commands import ROOT


@pytest.fixture
def misbehaving(monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setattr(workers, "SECONDS", 5.0)
    return "misbehaving"


def test_every_end_of_a_case_is_told_and_survived(misbehaving: str) -> None:
    ends = list(tried([Name(misbehaving, number, 0) for number in range(9)]))
    words = [outcome.word for _, outcome in ends]
    assert words == [
        *("answered", "refused", "wrong", "foreign", "crash", "hang", "memory", "wrong"),
        "answered",
    ]
    details = [outcome.detail for _, outcome in ends]
    assert details[1] == "SolverError: no"
    assert details[2] == "number 2: two and two is five"
    assert details[3].startswith("number 3: KeyError: 'not ours'")
    assert details[4] == "number 4: the process ended with SIGSEGV"
    assert details[5] == "number 5: no end after 5 s"
    assert "an error without a word" in details[7]


def test_a_case_is_the_same_in_any_company(misbehaving: str) -> None:
    alone = [next(tried([Name(misbehaving, 8, 3)]))[1].detail for _ in range(2)]
    among = [outcome.detail for _, outcome in tried([Name(misbehaving, k, 3) for k in (0, 8)])]
    assert alone == [among[1]] * 2
    assert among[0] != among[1]


def test_the_command_tells_what_it_found(tmp_path: Path) -> None:
    path = tmp_path / "found.json"
    done = subprocess.run(
        [sys.executable, "-m", "tests.fuzz", "--only", "misbehaving:3", "--json", str(path)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 1, done.stderr
    assert "KeyError" in done.stdout
    (found,) = json.loads(path.read_text())["defects"]
    assert found["word"] == "foreign"
    assert found["command"] == "python -m tests.fuzz --only misbehaving:3 --seed 0"
