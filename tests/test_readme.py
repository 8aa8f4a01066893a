"""The README's code runs as it stands, and its files exist."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
TEXT = (ROOT / "README.md").read_text()
BLOCKS = re.findall(r"```python\n(.*?)```", TEXT, flags=re.S)


def test_there_are_examples() -> None:
    assert len(BLOCKS) >= 3


@pytest.mark.parametrize("number", range(len(BLOCKS)))
def test_example_runs(number, capsys) -> None:
    exec(compile(BLOCKS[number], f"README example {number}", "exec"), {})


def test_links_and_pictures_exist() -> None:
    for target in re.findall(r"\]\(([^)#]+)\)", TEXT):
        assert target.startswith("https://") or (ROOT / target).exists(), target


def test_commands_exist() -> None:
    for command in re.findall(r"python (scripts/\w+\.py)", TEXT):
        assert (ROOT / command).exists(), command
    makefile = (ROOT / "Makefile").read_text()
    for target in re.findall(r"`make ([\w-]+)`|^make ([\w-]+)", TEXT, flags=re.M):
        assert re.search(rf"^{''.join(target)}:", makefile, flags=re.M), target
