"""The table of licences names what is installed."""

import tomllib
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from scripts import licences

ROOT = Path(__file__).parents[2]


def test_the_page_is_that_of_the_installed_packages() -> None:
    try:
        distribution("graspforce")
    except PackageNotFoundError:
        pytest.skip("the project runs from its tree and is not installed")
    words = licences.page().replace("+cpu", "")
    assert licences.PAGE.read_text(encoding="utf-8").replace("+cpu", "") == words


def test_no_dependency_is_left_out_and_none_is_without_a_licence() -> None:
    rows = licences.PAGE.read_text(encoding="utf-8").split("| --- | --- | --- |\n")[1].splitlines()
    cells = [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]
    named = {name for name, _, _ in cells}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    direct = {canonicalize_name(Requirement(text).name) for text in project["dependencies"]}
    assert direct <= named
    assert all(words and words != "not said" for _, _, words in cells)
