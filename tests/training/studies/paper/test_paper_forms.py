"""The paper's forms against each other, and that the checks of them can fail."""

from typing import Any

import pytest
import torch

from solvers import GraspForceProblem, solve
from solvers.kkt import ConeProgram, kkt_field
from solvers.paper.lmi import linear_matrix_inequality
from tests.support.problems import random_batch
from tests.support.seeds import seeded
from training.studies.paper import forms


def feasible_batch() -> GraspForceProblem:
    batch = random_batch(seeded(0), 20)
    return batch[solve(batch).status == "optimal"][:12]


def test_inequality_agrees_with_the_cones_inside_and_outside() -> None:
    check = forms.check_inequality(feasible_batch(), 0)
    assert check.mismatches == 0
    assert 30 < check.inside < check.draws - 100


def test_a_wrong_inequality_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    def slippery(problem: GraspForceProblem) -> Any:
        return linear_matrix_inequality(problem.replace(friction=0.3 * problem.friction))

    monkeypatch.setattr(forms, "linear_matrix_inequality", slippery)
    assert forms.check_inequality(feasible_batch(), 0).mismatches > 10


def test_the_field_is_phi_and_a_wrong_field_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    assert forms.field_difference(3) < 1e-15

    def flipped(
        program: ConeProgram, x: torch.Tensor, u: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        dx, du = kkt_field(program, x, u)
        return -dx, du

    monkeypatch.setattr(forms, "kkt_field", flipped)
    assert forms.field_difference(3) > 0.1
