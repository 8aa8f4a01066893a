"""The whole reproduction of the paper at its smallest: every number found, every row filled."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from training.reports.results import Run, load_run, save_run
from training.studies.paper.agreement import LONGER
from training.studies.paper.pictures import shown_synthesis
from training.studies.paper.report import PaperStudy, write_page
from training.studies.paper.reproduction import (
    Reproduction,
    ReproductionError,
    ReproductionPlan,
    reproduce,
)
from training.studies.paper.summary import summary

STORED = Path(__file__).parents[1] / "results" / "paper.json"
MOST_BYTES = 60_000
IMAGES = {"contacts", "grasp", "hull", "losses", "ode", "path", "synthesis"}


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("docs") / "paper.md"
    write_page(load_run(STORED, PaperStudy), path)
    return path


def slug(heading: str) -> str:
    """The anchor that Markdown viewers give a heading."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


def test_every_equation_figure_and_example_has_a_verdict(report: Path) -> None:
    text = report.read_text()
    table = text[text.index("## Verdicts") : text.index("## Example 1")]
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()[4:]
    ]
    rows = [row for row in rows if len(row) > 1]
    assert all(len(row) == 4 and all(row) for row in rows)
    covered: set[int] = set()
    for where, *_ in rows:
        for first, last in re.findall(r"Eqs?\. (\d+)(?:-(\d+))?", where):
            covered |= set(range(int(first), int(last or first) + 1))
    assert covered == set(range(1, 44))
    assert {f"Fig. {number}" for number in range(1, 5)} <= {row[0].split(",")[0] for row in rows}
    assert any("6.7" in row[0] for row in rows)


def test_links_and_pictures_lead_somewhere(report: Path) -> None:
    text = report.read_text()
    headings = {slug(line.lstrip("# ")) for line in text.splitlines() if line.startswith("#")}
    assert set(re.findall(r"\]\(#([^)]+)\)", text)) <= headings
    pictures = re.findall(r"!\[[^\]]+\]\(([^)]+)\)", text)
    assert set(pictures) == {f"paper_{name}.png" for name in IMAGES}
    for picture in pictures:
        assert 1_000 < (report.parent / picture).stat().st_size < MOST_BYTES


@pytest.mark.slow
def test_the_smallest_reproduction(tmp_path: Path) -> None:
    """One test, because what it asks about takes minutes to make."""
    result = reproduce(ReproductionPlan(1, 1, 0), workers=2)
    page_is_made_of(result, tmp_path)
    formulations_agree_and_the_network_is_judged_by_the_same_rule(result)
    matrix_inequality_is_never_of_another_opinion(result)
    ode_starts_at_zero_and_ends_at_the_optimum(result)
    contacts_improve_and_are_judged(result)
    summary_is_json(result)


def page_is_made_of(result: Reproduction, folder: Path) -> None:
    study = PaperStudy.of(result)
    save_run(Run("a command", {}, study), folder / "paper.json")
    said = write_page(load_run(folder / "paper.json", PaperStudy), folder / "paper.md")
    assert said.startswith("Contact synthesis: 100% of 1 objects")
    stored = load_run(STORED, PaperStudy).results
    assert set(study.texts) == set(stored.texts)
    assert study.texts["problem_count"] == "1"


def formulations_agree_and_the_network_is_judged_by_the_same_rule(result: Reproduction) -> None:
    routes = result.routes
    assert np.all(routes["clarabel"].status == "optimal")
    for name in ("lmi, clarabel", "lmi, scs", "kkt_ode"):
        assert np.all(routes[name].status == "optimal")
        assert routes[name].objective_error.max() < 1e-6
        assert routes[name].force_error.max() < 1e-4
    short, longer = routes["instance_network"], routes[LONGER]
    assert np.all(short.force_error > 1e-3)
    assert np.all(longer.force_error < short.force_error)
    assert not np.any(np.isin([*short.status, *longer.status], ("optimal", "feasible")))


def matrix_inequality_is_never_of_another_opinion(result: Reproduction) -> None:
    check = result.inequality
    assert check.mismatches == 0
    assert check.draws > 20


def ode_starts_at_zero_and_ends_at_the_optimum(result: Reproduction) -> None:
    paths = result.paths
    np.testing.assert_allclose(paths.force_errors[0], 1.0)
    assert np.median(paths.force_errors[-1]) < 1e-5
    assert np.all(paths.residuals[-1] < 1e-3 * paths.residuals[0])


def contacts_improve_and_are_judged(result: Reproduction) -> None:
    for one in result.synthesis:
        assert one.bmi.after.quality >= one.bmi.on_facets.quality >= one.bmi.before.quality
        assert one.gradient.before.quality == one.bmi.before.quality
        assert one.held
        assert one.one_sided == "infeasible"
        assert one.one_sided_work < 0
    assert shown_synthesis(result.synthesis) in result.synthesis


def summary_is_json(result: Reproduction) -> None:
    figures = json.loads(json.dumps(summary(result), allow_nan=False))
    assert max(figures["benchmark_network_error"]) < 1e-3
    assert figures["benchmark_ode_error"] < 1e-6
    assert figures["synthesis_solved"] == 1.0


@pytest.mark.parametrize(
    ("plan", "message"),
    [
        ({"grasps": 0}, "grasps is 0"),
        ({"objects": 0}, "objects is 0"),
        ({"objects": 1000}, "between 1 and"),
        ({"seed": -1}, "seed is -1"),
    ],
)
def test_bad_plans_are_refused(plan: dict[str, int], message: str) -> None:
    with pytest.raises(ReproductionError, match=message):
        ReproductionPlan(**plan)
