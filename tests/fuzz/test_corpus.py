"""What `make fuzz` has found, as small as it can be: of each kind of case a few of every sort."""

from contextlib import nullcontext, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh

from gfo_env.exceptions import MeshError
from solvers import OBJECTIVES, GraspForceError, ProblemError, make_solver
from tests.fuzz import files, meshes
from tests.fuzz.arguments import CALLS
from tests.fuzz.outcome import outcome_of
from tests.fuzz.problems import EXACT, TWISTS, Twist, answered, draft, name_of, try_batch
from tests.support.seeds import seeded

SOLVERS = {"dual_newton": 4, "interior_point": 3, "clarabel": 1, "dual_newton_torch": 1}
"""How many problems of each sort a solver gets."""


@pytest.mark.parametrize("twist", TWISTS, ids=name_of)
@pytest.mark.parametrize("objective", OBJECTIVES)
def test_degenerate_problems_are_settled_as_clarabel_settles_them(
    twist: Twist, objective: str
) -> None:
    wrong = []
    for name, each in SOLVERS.items():
        solver = make_solver(name)
        for k in range(each if objective in solver.objectives else 0):
            rng = seeded([71, k, TWISTS.index(twist)])
            drafted = draft(rng, objective, 12, [twist])
            ended = outcome_of(lambda _, s=solver, d=drafted: answered(s, d), rng)
            wrong += [] if ended.fine else [f"{name}, {k}: {ended.detail}"]
    assert not wrong


@pytest.mark.parametrize("name", [*EXACT, "equal_squeeze", "pseudoinverse"])
def test_batches_of_any_size_are_answered(name: str) -> None:
    for k in range(4):
        assert try_batch(seeded([72, k]), name)


@pytest.mark.parametrize("name", CALLS)
def test_arrays_of_another_length_are_refused(name: str) -> None:
    answered_all_the_same = []
    for k in range(3):
        call = CALLS[name](seeded([73, k]))
        for argument, given in call.arguments.items():
            if isinstance(given, np.ndarray | torch.Tensor) and given.ndim and given.shape[-1]:
                for length in (0, given.shape[-1] - 1, given.shape[-1] + 1):
                    other = _of_length(given, length)
                    try:
                        call.function(**{**call.arguments, argument: other})
                    except GraspForceError:
                        continue
                    answered_all_the_same.append(f"{argument} of length {length}")
    assert not answered_all_the_same


def _of_length(array: Any, length: int) -> Any:
    index = np.arange(length) % array.shape[-1]
    return array[..., torch.tensor(index) if isinstance(array, torch.Tensor) else index]


@pytest.mark.parametrize("name", CALLS)
def test_nothing_in_the_place_of_an_argument_is_refused_or_answered(name: str) -> None:
    call = CALLS[name](seeded(74))
    for argument in call.arguments:
        for nothing in (None, "x", [], {}, np.array([]), np.nan):
            spoilt = {**call.arguments, argument: nothing}
            ended = outcome_of(lambda _, c=call, s=spoilt: c.function(**s), seeded(0))
            assert ended.fine, f"{argument}={nothing!r}: {ended.detail}"


@pytest.mark.parametrize("change", meshes.SAME, ids=name_of)
@pytest.mark.parametrize("suffix", ["stl", "obj", "ply"])
def test_a_box_keeps_its_volume_however_it_is_written(
    change: Any, suffix: str, tmp_path: Path
) -> None:
    box = trimesh.creation.box((0.04, 0.05, 0.06))
    path = tmp_path / f"box.{suffix}"
    change(seeded(75), box).export(path)
    refused = suppress(MeshError) if change in meshes.MAY_BE_REFUSED else nullcontext()
    with refused:
        assert meshes.read_and_checked(path).volume == pytest.approx(box.volume, rel=1e-4)


@pytest.mark.parametrize("kind", [kind for kind in files.KINDS if kind not in files.SLOW])
def test_damaged_files_are_refused_or_read(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    for k, damage in enumerate([damage for damage in files.DAMAGES if damage is not files.BOMB]):
        ended = outcome_of(lambda rng, d=damage: files.damaged(kind, d, rng), seeded([76, k]))
        assert ended.fine, f"{name_of(damage)}: {ended.detail}\n{ended.trace}"


def test_ranks_and_ranges_that_no_solver_can_use_are_named() -> None:
    for k in range(6):
        drafted = draft(seeded([77, k]), "min_norm", 8, [TWISTS[-1]])
        with pytest.raises(ProblemError, match=r"rank|contact"):
            answered(make_solver("dual_newton"), drafted)
