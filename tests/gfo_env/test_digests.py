"""What was made by old code is made anew: digests cover all that stored things depend on."""

import ast
import importlib
import importlib.util
import inspect
from collections.abc import Iterator
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

import pytest
from numba.core.caching import FunctionCache
from numba.core.dispatcher import Dispatcher

from gfo_env import digests
from tests.support.commands import ROOT

TOOLS = {"cache", "checks", "digests", "exceptions", "workers"}
"""Modules of gfo_env that decide nothing about a grasp."""


def module_names(package: str) -> list[str]:
    paths = (path.relative_to(ROOT) for path in (ROOT / package).rglob("*.py"))
    return sorted(".".join(path.with_suffix("").parts).removesuffix(".__init__") for path in paths)


def imported(name: str) -> set[str]:
    """Modules of the project that a module imports by name, wherever in it."""
    module = importlib.import_module(name)
    found = set()
    for node in ast.walk(ast.parse(inspect.getsource(module))):
        if isinstance(node, ast.ImportFrom):
            base = absolute(node, module)
            for alias in node.names:
                full = f"{base}.{alias.name}"
                found.add(full if importlib.util.find_spec(base) and is_module(full) else base)
    return {name for name in found if name.startswith(("gfo_env", "solvers"))}


def absolute(node: ast.ImportFrom, module: ModuleType) -> str:
    """The module that an import statement of another names."""
    return importlib.util.resolve_name("." * node.level + (node.module or ""), module.__package__)


def is_module(name: str) -> bool:
    try:
        return importlib.util.find_spec(name) is not None
    except ModuleNotFoundError:
        return False


def digested_rooms(name: str) -> list[str]:
    """The rooms that a module's calls of `digest` name."""
    tree = ast.parse(inspect.getsource(importlib.import_module(name)))
    return [
        argument.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "digest"
        for argument in node.args
        if isinstance(argument, ast.Constant) and isinstance(argument.value, str)
    ]


def room(name: str) -> str:
    return name.split(".")[1] if "." in name else ""


def test_attempts_rest_on_digested_rooms_alone() -> None:
    """A grasp in the user's cache is made anew where any code that decides it has changed."""
    seen, waiting = set(), ["gfo_env.grasps.attempts"]
    while waiting:
        name = waiting.pop()
        if name not in seen and name.startswith("gfo_env"):
            seen.add(name)
            waiting += imported(name)
    rooms = {room(name) for name in seen} - {""}
    assert {"contacts", "grasps", "hand", "objects", "pose", "simulation"} <= rooms
    assert rooms - TOOLS == set(digested_rooms("gfo_env.grasps.attempts"))


@pytest.fixture
def copied(tmp_path: Path) -> ModuleType:
    """`digests` as a module of a package that has two rooms and a file."""
    for path in ("objects/sets.py", "objects/deep/mesh.py", "hand/urdf.py", "pose.py"):
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_text(f'"""{path}"""\n')
    (tmp_path / "digests.py").write_text(inspect.getsource(digests))
    spec = importlib.util.spec_from_file_location("copied_digests", tmp_path / "digests.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("changed", ["objects/sets.py", "objects/deep/mesh.py", "pose.py"])
def test_digest_changes_with_every_file_of_its_rooms(copied, changed, tmp_path) -> None:
    before = copied.digest("objects", "pose")
    (tmp_path / "hand/urdf.py").write_text("x = 1\n")
    assert copied.digest("objects", "pose") == before
    (tmp_path / changed).write_text("x = 1\n")
    assert copied.digest("objects", "pose") != before


def test_digest_changes_with_a_new_file_and_a_new_name(copied, tmp_path) -> None:
    before = copied.digest("objects")
    (tmp_path / "objects/sets.py").rename(tmp_path / "objects/other.py")
    renamed = copied.digest("objects")
    (tmp_path / "objects/more.py").touch()
    assert len({before, renamed, copied.digest("objects")}) == 3


def test_a_room_that_is_not_there_is_an_error(copied) -> None:
    with pytest.raises(FileNotFoundError, match="kitchen"):
        copied.digest("objects", "kitchen")


# -- compiled code ---------------------------------------------------------------------------------


def cached_functions() -> dict[str, Any]:
    """Compiled functions that numba keeps on the disk, by module and name."""
    found = {}
    for name in module_names("gfo_env") + module_names("solvers/compiled"):
        for key, value in vars(importlib.import_module(name)).items():
            own = isinstance(value, Dispatcher) and value.py_func.__module__ == name
            if own and isinstance(value._cache, FunctionCache):
                found[f"{name}:{key}"] = value
    return found


CACHED = cached_functions()


def names_in(code: CodeType) -> set[str]:
    inner = [names_in(each) for each in code.co_consts if isinstance(each, CodeType)]
    return set(code.co_names).union(code.co_freevars, *inner)


def origins(function: Any) -> Iterator[tuple[str, str]]:
    """Names of all that is compiled into a function or read by it, and the modules they are of."""
    seen, waiting = set(), [function]
    while waiting:
        here = waiting.pop()
        code = here.py_func.__code__
        if code in seen:
            continue
        seen.add(code)
        home = importlib.import_module(here.py_func.__module__)
        yield code.co_name, home.__name__
        taken = names_from(home)
        values = dict(inspect.getclosurevars(here.py_func).nonlocals)
        values |= {name: vars(home)[name] for name in names_in(code) if name in vars(home)}
        for name, value in values.items():
            if isinstance(value, Dispatcher):
                waiting.append(value)
            elif name in taken:
                yield name, taken[name]


def names_from(module: ModuleType) -> dict[str, str]:
    """Names that a module takes from others of the project, and these."""
    return {
        alias.asname or alias.name: absolute(node, module)
        for node in ast.walk(ast.parse(inspect.getsource(module)))
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
        if absolute(node, module).startswith(("gfo_env", "solvers"))
    }


@pytest.mark.parametrize("name", CACHED)
def test_cached_code_is_renewed_with_all_that_it_is_made_of(name) -> None:
    """numba looks at the file of the function alone: what else it holds must be in its digest."""
    function = CACHED[name]
    home = function.py_func.__module__
    covered = {home}
    if "sources" in function.py_func.__code__.co_freevars:
        if home.startswith("solvers") or not digested_rooms(home):
            covered |= set(module_names("solvers/compiled"))
        covered |= {each for each in module_names("gfo_env") if room(each) in digested_rooms(home)}
    outside = {(what, where) for what, where in origins(function) if where not in covered}
    assert outside == set()


def test_cached_functions_are_found() -> None:
    for name in (
        "gfo_env.contacts.rank:balances",
        "gfo_env.contacts.contacts:contact_geometry",
        "gfo_env.mdp.reading:_look",
        "solvers.compiled.judge.measure:measure",
        "solvers.compiled.newton.batch:_together",
    ):
        assert name in CACHED
