"""Every page of a study is made from a file of results alone, and says all of it.

The files in `results/` are results of the smallest runs of the commands that they name, from
`--json`; numbers are rounded, and long curves and lists of solvers are cut short.
"""

import re
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from training.reports.results import load_run

RESULTS = Path(__file__).with_name("results")

STUDIES = {
    "benchmark": ("benchmark.run:Benchmark", "benchmark.report"),
    "environment": ("environment.run:SpeedReport", "environment.page"),
    "holding": ("holding.survival.study:Study", "holding.survival.page"),
    "network": ("ablation.stages:AblationStudy", "ablation.page"),
    "paper": ("paper.report:PaperStudy", "paper.report"),
    "policies": ("policies.page:PolicyStudy", "policies.page"),
    "quality": ("quality.measures:QualityStudy", "quality.page"),
}


def page_of(name: str) -> tuple[type[Any], Callable[[Any, Path], str]]:
    """The kind of results of a study, and what writes its page."""
    kind, page = STUDIES[name]
    module, _, attribute = kind.partition(":")
    results: type[Any] = getattr(import_module(f"training.studies.{module}"), attribute)
    return results, import_module(f"training.studies.{page}").write_page


@pytest.mark.parametrize("name", STUDIES)
def test_page_is_made_from_stored_results(name: str, tmp_path: Path) -> None:
    kind, write_page = page_of(name)
    run = load_run(RESULTS / f"{name}.json", kind)
    page, again = tmp_path / "docs" / f"{name}.md", tmp_path / "again" / f"{name}.md"
    assert write_page(run, page) == write_page(run, again) != ""
    text = page.read_text()
    assert run.command in text
    prose = re.sub(r"```.*?```", "", text, flags=re.S)
    assert not re.search(r"[{}]|\bnan\b|\binf\b", prose)
    shown = set(re.findall(r"\]\((\w+\.png)\)", text))
    assert shown == {path.name for path in page.parent.glob("*.png")} != set()
    assert text == again.read_text()
    for picture in shown:
        path = page.with_name(picture)
        assert path.read_bytes() == again.with_name(picture).read_bytes()
        assert 1000 < path.stat().st_size < 200_000
        assert len(np.unique(np.asarray(Image.open(path).convert("L")))) > 5


@pytest.mark.parametrize("name", STUDIES)
def test_tables_have_as_many_cells_as_headings(name: str, tmp_path: Path) -> None:
    kind, write_page = page_of(name)
    write_page(load_run(RESULTS / f"{name}.json", kind), tmp_path / "page.md")
    widths: list[int] = []
    for line in (tmp_path / "page.md").read_text().splitlines():
        if line.startswith("|"):
            widths.append(line.count("|"))
        elif widths:
            assert len(widths) > 2, "a table without a row"
            assert len(set(widths)) == 1, widths
            widths = []
