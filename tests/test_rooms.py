"""Rooms are entered by their doors: what a room's `__init__` opens is imported from there.

Which room may know which is a matter of the contracts in pyproject.toml, `make lint`.
"""

import ast
from importlib.util import resolve_name
from pathlib import Path

import pytest

from tests.support.commands import ROOT

PACKAGES = ("gfo_env", "solvers", "training")
FILES = sorted(
    path.relative_to(ROOT) for package in PACKAGES for path in (ROOT / package).rglob("*.py")
)


def module_of(path: Path) -> str:
    return ".".join(path.with_suffix("").parts).removesuffix(".__init__")


def room_of(module: str) -> str:
    """The first folder or file of a package; of studies, the study."""
    parts = module.split(".")
    return ".".join(parts[: 3 if parts[:2] == ["training", "studies"] else 2])


def opened(path: Path) -> set[str]:
    """Names in `__all__` of a file."""
    for node in ast.parse((ROOT / path).read_text()).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            return set(ast.literal_eval(node.value))
    return set()


DOORS = {module_of(path): opened(path) for path in FILES if path.name == "__init__.py"}


def imports(path: Path, source: str) -> list[tuple[int, int, str, str]]:
    """Line, level, module and name of all that is imported from the project's packages."""
    parent = module_of(path) if path.name == "__init__.py" else module_of(path).rpartition(".")[0]
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom):
            base = resolve_name("." * node.level + (node.module or ""), parent)
            if base.split(".")[0] in PACKAGES:
                found += [(node.lineno, node.level, base, alias.name) for alias in node.names]
    return found


def wrong_ways(path: Path, source: str) -> list[str]:
    here, wrong = room_of(module_of(path)), []
    for line, level, base, name in imports(path, source):
        front = name in DOORS.get(base, ())
        there = room_of(base if front else f"{base}.{name}")
        if here in PACKAGES or (base in PACKAGES and front):
            continue
        if there == here and not level:
            wrong.append(f"line {line}: {name} is of this room: from .file import {name}")
        elif there != here and level:
            wrong.append(f"line {line}: {name} is of another: from {base} import {name}")
        elif there != here and base != there and name in DOORS.get(there, ()):
            wrong.append(f"line {line}: {name} by the door: from {there} import {name}")
    return wrong


@pytest.mark.parametrize("path", FILES, ids=str)
def test_rooms_are_entered_by_their_doors(path: Path) -> None:
    assert wrong_ways(path, (ROOT / path).read_text()) == []


@pytest.mark.parametrize(
    ("source", "complaint"),
    [
        ("from solvers.problem.definition import GraspForceProblem", "by the door"),
        ("from ..problem import GraspForceProblem", "is of another"),
        ("from solvers.solution.repair import tightened", "is of this room"),
    ],
)
def test_wrong_ways_are_found(source: str, complaint: str) -> None:
    (found,) = wrong_ways(Path("solvers/solution/finish.py"), source)
    assert complaint in found
