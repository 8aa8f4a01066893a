"""What users hand over: numbers and arrays of stated shapes, or one error that says what is due."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from gfo_env.checks import checked_array, checked_arrays, is_number, is_whole
from gfo_env.exceptions import GeometryError, QualityError
from gfo_env.pose import Pose
from solvers import GraspForceError

SHAPES = {"positions": ("n", 3), "frames": ("n", 3, 3), "jacobian": ("3n", "t")}


def arrays_of(n: int, t: int) -> dict[str, np.ndarray]:
    sizes = ((n, 3), (n, 3, 3), (3 * n, t))
    made = (np.arange(float(np.prod(size))).reshape(size) for size in sizes)
    return dict(zip(SHAPES, made, strict=True))


@given(n=st.integers(0, 5), t=st.integers(0, 4))
def test_arrays_that_agree_are_taken_as_they_are(n: int, t: int) -> None:
    given_arrays = arrays_of(n, t)
    for one, other in zip(checked_arrays(given_arrays, SHAPES), given_arrays.values(), strict=True):
        assert one is other


@given(
    n=st.integers(0, 5),
    name=st.sampled_from(list(SHAPES)),
    wrong=st.lists(st.integers(0, 5), max_size=4).map(tuple),
)
def test_any_other_shape_is_an_error_that_names_it(n: int, name: str, wrong: tuple) -> None:
    arrays = arrays_of(n, 2)
    # the first array says how many there are, and any number of joints will do
    agrees = wrong == arrays[name].shape or (name == "positions" and wrong[1:] == (3,))
    agrees = agrees or (name == "jacobian" and len(wrong) == 2 and wrong[0] == 3 * n)
    arrays[name] = np.zeros(wrong)
    if agrees and name == "positions" and wrong[0] != n:
        name, wrong = "frames", arrays["frames"].shape
    elif agrees:
        checked_arrays(arrays, SHAPES)
        return
    with pytest.raises(GeometryError, match=rf"{name} must have shape \(.*\), not") as caught:
        checked_arrays(arrays, SHAPES)
    assert f"not {wrong}" in str(caught.value)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (None, "array of numbers"),
        ("abc", "array of numbers"),
        ([["1", "2", "3"]], "array of numbers, not of <U1"),
        ([[1, 2, 3], [4]], "array of numbers"),
        ([[1, 2, None]], "array of numbers"),
        (np.ones((2, 3), dtype=complex), "array of numbers, not of complex128"),
        (np.ones((2, 3), dtype=bool), "array of numbers, not of bool"),
        ([[10**400, 0, 0]], "array of numbers"),
        (torch.ones(2, 3, requires_grad=True), "array of numbers"),
        (np.full((2, 3), np.nan), "be finite"),
        ([[0.0, 0.0, np.inf]], "be finite"),
        (np.zeros((3, 2)), r"\(n, 3\), not \(3, 2\): transpose it"),
        (np.zeros((4, 2, 3)), r"\(n, 3\), not \(4, 2, 3\): one of a batch at a time"),
    ],
    ids=str,
)
def test_what_is_no_array_of_finite_numbers(value: Any, message: str) -> None:
    for error in (GeometryError, QualityError):
        with pytest.raises(error, match=f"normals must .*{message}") as caught:
            checked_array("normals", value, ("n", 3), error)
        assert isinstance(caught.value, GraspForceError)


@pytest.mark.parametrize("value", [[[1, 2, 3]], ((1, 2, 3),), np.float32([[1, 2, 3]])], ids=str)
def test_lists_whole_numbers_and_single_precision_are_arrays(value: Any) -> None:
    made = checked_array("normals", value, ("n", 3))
    assert made.dtype == np.float64
    np.testing.assert_array_equal(made, [[1.0, 2.0, 3.0]])
    tensor = checked_array("normals", torch.tensor([[1.0, 2.0, 3.0]]), ("n", 3))
    np.testing.assert_array_equal(tensor, made)


def test_a_batch_is_welcome_where_it_is_said() -> None:
    assert checked_array("wrench", np.zeros((4, 2, 6)), (6,), batched=True).shape == (4, 2, 6)
    with pytest.raises(GeometryError, match=r"wrench must have shape \(\.\.\., 6\), not \(6, 2\)"):
        checked_array("wrench", np.zeros((6, 2)), (6,), batched=True)


def test_numbers_are_numbers_by_their_type() -> None:
    for value in (1, 0.5, np.float32(0.5), np.int64(3), np.float64(0.5)):
        assert is_number(value)
    for value in (True, np.bool_(True), "1", None, [1.0], np.array(1.0), 1j):
        assert not is_number(value)
        assert not is_whole(value)
    assert is_whole(np.int32(3))
    assert not is_whole(3.0)


# -- poses -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Pose(np.zeros(4), np.eye(3)), r"position must have shape \(3\), not \(4,\)"),
        (lambda: Pose(np.zeros(3), np.eye(4)), r"rotation must have shape \(3, 3\)"),
        (lambda: Pose(np.full(3, np.nan), np.eye(3)), "position must be finite"),
        (lambda: Pose(np.zeros(3), 2.0 * np.eye(3)), "rotation must be one"),
        (lambda: Pose(np.zeros(3), np.diag([1.0, 1.0, -1.0])), "rotation must be one"),
        (lambda: Pose(np.zeros(3), np.eye(3)).to_hand(np.zeros((3, 5))), r"\(\.\.\., 3\)"),
    ],
)
def test_what_is_no_pose(make: Callable[[], object], message: str) -> None:
    with pytest.raises(GeometryError, match=message):
        make()


def test_a_pose_keeps_its_own_arrays() -> None:
    position, rotation = np.ones(3), np.eye(3)
    pose = Pose(position, rotation)
    position[:], rotation[:] = np.nan, np.nan
    np.testing.assert_array_equal(pose.to_hand(np.ones((2, 3))), np.full((2, 3), 2.0))
    assert pose.motion_from(Pose(np.ones(3), np.eye(3))) == (0.0, 0.0)
