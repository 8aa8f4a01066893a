"""What compiled functions may not say, because their bits would then depend on who else says it."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCES = sorted(
    path.relative_to(ROOT).as_posix()
    for package in ("solvers", "gfo_env", "training")
    for path in (ROOT / package).rglob("*.py")
    if "njit" in path.read_text(encoding="utf-8")
)


def powers(source: str) -> list[str]:
    """Powers in functions that numba compiles, but those of a constant that is no whole number."""
    return [
        f"line {node.lineno}: {ast.unparse(node)}"
        for function in ast.walk(ast.parse(source))
        if isinstance(function, ast.FunctionDef)
        and any("njit" in ast.unparse(decorator) for decorator in function.decorator_list)
        for node in ast.walk(function)
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow)
        if not (isinstance(node.right, ast.Constant) and isinstance(node.right.value, float))
    ]


@pytest.mark.parametrize("path", SOURCES)
def test_no_power_of_whole_numbers(path: str) -> None:
    """numba compiles `x ** 2` once in a process, with the fast-math flags of the first function
    that has it, and all others get that one: products and sums of the judge would be fused if a
    solver was compiled before it, and not if it was first. `x * x` has the flags of its function.
    """
    assert powers((ROOT / path).read_text(encoding="utf-8")) == []


def test_powers_are_found() -> None:
    compiled = "@njit(cache=True)\ndef f(x, n):\n    return x**2 + x**0.5 + x**n\n"
    plain = "def g(x):\n    return x**2\n"
    assert set(powers(compiled + plain)) == {"line 3: x ** 2", "line 3: x ** n"}
