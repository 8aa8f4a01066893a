"""What is promised of other processors: equal statuses, and figures within stated tolerances.

The tolerances are those of docs/reproducibility.md.
"""

import json
from typing import Any

import numpy as np
import pytest

from tests.support.elsewhere import QUALITY_SOLVERS, SOLVERS, STORED, answers

pytestmark = pytest.mark.slow

CONVEX = 1e-7
QUALITY = {"uniform_preload": 1e-5, "quality_search": 0.02, "quality": 0.05}
HULL = 1e-8
TRAINING = 1e-3
SAME_GRASPS = 0.8
"""Share of attempts at grasps."""


@pytest.fixture(scope="module")
def here() -> dict[str, Any]:
    return answers()


@pytest.fixture(scope="module")
def there() -> dict[str, Any]:
    stored: dict[str, Any] = json.loads(STORED.read_text(encoding="utf-8"))
    return stored


def numbers(text: str) -> np.ndarray:
    return np.array(text.split(), dtype=float)


def test_the_other_processor_has_other_kernels(there: dict[str, Any]) -> None:
    chosen = " ".join(there["kernels"].values())
    for newer in ("avx", "fma", "AVX", "X86_V3", "Haswell", "Zen", "SkylakeX"):
        assert newer not in chosen


@pytest.mark.parametrize(
    "entry", [f"{solver}, {objective}" for solver, all_ in SOLVERS.items() for objective in all_]
)
def test_exact_answers(entry: str, here: dict[str, Any], there: dict[str, Any]) -> None:
    one, other = here["convex"][entry], there["convex"][entry]
    assert one["status"] == other["status"]
    assert "failed" not in one["status"]
    np.testing.assert_allclose(
        numbers(one["objective"]), numbers(other["objective"]), rtol=CONVEX, atol=1e-30
    )


@pytest.mark.parametrize("solver", QUALITY_SOLVERS)
def test_forces_of_high_quality(solver: str, here: dict[str, Any], there: dict[str, Any]) -> None:
    one, other = here["max_quality"][solver], there["max_quality"][solver]
    assert one["status"] == other["status"]
    np.testing.assert_allclose(
        numbers(one["objective"]), numbers(other["objective"]), rtol=QUALITY[solver]
    )


def test_intervals_of_quality(here: dict[str, Any], there: dict[str, Any]) -> None:
    for one, other in zip(here["q_lrw"], there["q_lrw"], strict=True):
        np.testing.assert_allclose(numbers(one), numbers(other), rtol=HULL)


def test_losses_of_a_training(here: dict[str, Any], there: dict[str, Any]) -> None:
    np.testing.assert_allclose(numbers(here["training"]), numbers(there["training"]), rtol=TRAINING)


def test_nearly_all_grasps(here: dict[str, Any], there: dict[str, Any]) -> None:
    one, other = here["attempts"], there["attempts"]
    outcomes = np.array(one["outcome"].split()) == np.array(other["outcome"].split())
    apart = np.abs(numbers(one["sum"]) - numbers(other["sum"]))
    assert (outcomes & ~(apart > 1e-6)).mean() >= SAME_GRASPS
