"""Results of studies go into a file and come back as they were; other files are refused."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from training.reports.results import ResultsError, Run, load_run, save_run


@dataclass(frozen=True)
class Plan:
    sizes: tuple[int, ...]
    table: Path | None = None


@dataclass(frozen=True, eq=False)
class Found:
    plan: Plan
    times: dict[str, dict[int, NDArray[np.float64]]]
    held: NDArray[np.bool_]
    rows: list[dict[str, Any]]
    ratio: float | None


FOUND = Found(
    plan=Plan((1, 64), Path("runs/train.npz")),
    times={"clarabel": {64: np.array([0.1, np.nan, np.inf, 1 / 3])}},
    held=np.array([[True, False]]),
    rows=[{"solver": "clarabel", "gap": None}],
    ratio=None,
)


def test_results_come_back_to_the_bit(tmp_path: Path) -> None:
    save_run(Run("a command", {"cores": "2"}, FOUND), tmp_path / "a.json")
    run = load_run(tmp_path / "a.json", Found)
    assert (run.command, run.machine) == ("a command", {"cores": "2"})
    found = run.results
    assert found.plan == FOUND.plan
    np.testing.assert_array_equal(found.times["clarabel"][64], FOUND.times["clarabel"][64])
    np.testing.assert_array_equal(found.held, FOUND.held)
    assert found.held.dtype == np.bool_
    assert (found.rows, found.ratio) == (FOUND.rows, None)
    save_run(run, tmp_path / "b.json")
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()


@pytest.mark.parametrize(
    "content", ["", "[]", "{}", "no JSON", '{"command": "c", "machine": {}, "results": {}}']
)
def test_other_files_are_refused(content: str, tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text(content)
    with pytest.raises(ResultsError, match=r"a\.json holds no results of this study"):
        load_run(tmp_path / "a.json", Found)


def test_results_of_another_study_are_refused(tmp_path: Path) -> None:
    save_run(Run("a command", {}, FOUND), tmp_path / "a.json")
    values = json.loads((tmp_path / "a.json").read_text())
    values["results"]["more"] = 1
    (tmp_path / "b.json").write_text(json.dumps(values))
    with pytest.raises(ResultsError, match="holds no results"):
        load_run(tmp_path / "b.json", Found)
    with pytest.raises(ResultsError, match="holds no results"):
        load_run(tmp_path / "a.json", Plan)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ResultsError, match=r"no results at .*gone\.json"):
        load_run(tmp_path / "gone.json", Found)
