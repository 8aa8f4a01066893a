"""Grasp force problems: construction, every validation error, batching, storage, torch."""

import dataclasses
import io
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from solvers import GraspForceError, GraspForceProblem, ProblemError, solve
from solvers.problem import ARRAY_FIELDS
from tests.support.problems import random_batch, random_problem, skew
from tests.support.seeds import SEEDS, seeded


def arrays(problem: GraspForceProblem) -> dict[str, Any]:
    return {name: getattr(problem, name) for name in ARRAY_FIELDS}


def assert_same(left: GraspForceProblem, right: GraspForceProblem) -> None:
    assert left.objective == right.objective
    for name in ARRAY_FIELDS:
        first, second = getattr(left, name), getattr(right, name)
        assert type(first) is type(second), name
        assert first.dtype == second.dtype, name
        np.testing.assert_array_equal(np.asarray(first), np.asarray(second), err_msg=name)


def fields(**changes: Any) -> dict[str, Any]:
    """A valid problem of four contacts as plain arguments, with some of them changed."""
    return arrays(random_problem(seeded(0))) | changes


def changed(name: str, index: Any, value: float) -> dict[str, Any]:
    array = np.array(fields()[name])
    array[index] = value
    return fields(**{name: array})


def test_defaults_are_no_external_torque_no_preload_no_cap_and_no_padding() -> None:
    optional = ("external_torque", "normal_min", "normal_max", "contact_mask")
    problem = GraspForceProblem(**{k: v for k, v in fields().items() if k not in optional})
    assert problem.objective == "min_norm"
    np.testing.assert_array_equal(problem.external_torque, np.zeros(8))
    np.testing.assert_array_equal(problem.normal_min, np.zeros(4))
    np.testing.assert_array_equal(problem.normal_max, np.full(4, np.inf))
    np.testing.assert_array_equal(problem.contact_mask, np.ones(4, dtype=bool))


def test_single_problem_knows_its_sizes() -> None:
    problem = random_problem(seeded(0), 5)
    assert (problem.batch_shape, problem.n_contacts, problem.n_joints) == ((), 5, 8)
    with pytest.raises(TypeError, match="no length"):
        len(problem)
    with pytest.raises(TypeError, match="cannot be indexed"):
        problem[0]


def test_batch_dimensions_broadcast_against_each_other() -> None:
    loads = seeded(1).standard_normal((5, 1, 6))
    friction = np.linspace(0.2, 1.0, 12).reshape(3, 4)
    problem = GraspForceProblem(**fields(external_wrench=loads, friction=friction))
    assert problem.batch_shape == (5, 3)
    assert len(problem) == 5
    one = GraspForceProblem(**fields(external_wrench=loads[2, 0], friction=friction[1]))
    assert_same(problem[2, 1], one)


def test_lists_and_integers_are_taken_as_float64() -> None:
    as_lists = {name: value.tolist() for name, value in fields().items()}
    assert_same(GraspForceProblem(**as_lists), GraspForceProblem(**fields()))
    whole = GraspForceProblem(
        **fields(friction=[1] * 4, torque_max=np.full(8, 2), contact_mask=[1, 1, 1, 1])
    )
    assert whole.friction.dtype == whole.torque_max.dtype == np.float64
    assert whole.contact_mask.dtype == bool


def test_float32_stays_float32_only_where_every_field_is() -> None:
    small = {k: v if v.dtype == bool else v.astype(np.float32) for k, v in fields().items()}
    assert GraspForceProblem(**small).grasp_map.dtype == np.float32
    mixed = GraspForceProblem(**(small | {"friction": fields()["friction"]}))
    assert {getattr(mixed, n).dtype for n in ARRAY_FIELDS} == {np.dtype(bool), np.dtype(float)}
    assert mixed.to_numpy().grasp_map.dtype == np.float64


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_tensors_share_one_data_type(dtype: torch.dtype) -> None:
    tensors = {k: torch.tensor(np.array(v)) for k, v in fields().items()}
    tensors["grasp_map"] = tensors["grasp_map"].to(dtype)
    tensors["friction"] = torch.ones(4, dtype=torch.int64)
    tensors["contact_mask"] = torch.ones(4, dtype=torch.uint8)
    problem = GraspForceProblem(**tensors)
    assert problem.contact_mask.dtype == torch.bool
    floats = {getattr(problem, n).dtype for n in ARRAY_FIELDS if n != "contact_mask"}
    assert floats == {torch.float64}


def test_problem_without_joints_has_no_torques() -> None:
    problem = random_problem(
        seeded(0),
        hand_jacobian=np.zeros((12, 0)),
        **dict.fromkeys(("torque_min", "torque_max", "external_torque"), np.zeros(0)),
    )
    assert problem.n_joints == 0
    batch = GraspForceProblem.stack([problem, problem]).reshape(-1)
    assert batch.hand_jacobian.shape == (2, 12, 0)


def line_map(points: list[float]) -> np.ndarray:
    return np.hstack([np.vstack([np.eye(3), skew(np.array([x, 0.0, 0.0]))]) for x in points])


def contacts(count: int, **changes: Any) -> dict[str, Any]:
    """Fields with the first `count` contacts only."""
    plain = fields()
    small = {k: plain[k][:count] for k in ("friction", "normal_min", "normal_max", "contact_mask")}
    small["grasp_map"] = plain["grasp_map"][:, : 3 * count]
    small["hand_jacobian"] = plain["hand_jacobian"][: 3 * count]
    return plain | small | changes


PADDED = arrays(random_problem(seeded(0)).pad(5))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (changed("friction", 1, -0.1), "friction is negative"),
        (changed("normal_min", 1, -0.1), "normal_min is negative"),
        (
            fields(normal_min=[1.0, 3.0, 1.0, 1.0], normal_max=np.full(4, 2.0)),
            "normal_min exceeds normal_max",
        ),
        (changed("normal_min", 1, np.inf), "normal_min contains an infinite value"),
        (changed("torque_min", 3, 50.0), "torque_min exceeds torque_max"),
        (
            fields(torque_min=np.full(8, np.inf), torque_max=np.full(8, np.inf)),
            "torque_min is inf or torque_max is -inf",
        ),
        (
            fields(torque_min=np.full(8, -np.inf), torque_max=np.full(8, -np.inf)),
            "torque_min is inf or torque_max is -inf",
        ),
        *((changed(name, 1, np.nan), f"{name} contains NaN") for name in ARRAY_FIELDS[:-1]),
        *(
            (changed(name, 1, np.inf), f"{name} contains an infinite value")
            for name in ("grasp_map", "hand_jacobian", "friction", "external_wrench")
        ),
        (fields(contact_mask=np.zeros(4, bool)), "contact_mask is False everywhere"),
        (fields(contact_mask=[1.0, 1.0, 1.0, np.nan]), "contact_mask must hold True and False"),
        (fields(contact_mask=[1.0, 1.0, 1.0, 0.5]), "contact_mask must hold True and False"),
        (fields(contact_mask=[True, True, True, False]), "marks as padding has nonzero"),
        (
            PADDED | {"hand_jacobian": np.ones((15, 8))},
            "marks as padding has nonzero",
        ),
        (fields(objective="fastest"), "'fastest' is unknown; choose one of min_norm, sum_normal, "),
        (fields(grasp_map=np.zeros((6, 12))), "rank 0 and not 6"),
        (fields(grasp_map=line_map([-0.03, 0.0, 0.01, 0.03])), "rank 5 and not 6"),
        (contacts(1), "rank 3 and not 6"),
        (contacts(2), "rank 5 and not 6"),
        (fields(grasp_map=np.ones((6, 11))), r"grasp_map has shape \(6, 11\) .* \(6, 12\)"),
        (fields(hand_jacobian=np.ones((8, 12))), r"hand_jacobian has shape \(8, 12\)"),
        (fields(external_wrench=np.ones(3)), r"external_wrench has shape \(3,\)"),
        (fields(torque_max=np.ones(7)), r"torque_max has shape \(7,\) .* \(8,\)"),
        (fields(torque_max=2.0), r"torque_max has shape \(\) "),
        (fields(normal_max=np.ones(3)), r"normal_max has shape \(3,\)"),
        (fields(friction=0.5), "friction needs at least 1 dimension"),
        (fields(friction=np.zeros(0)), "friction is empty"),
        (fields(friction=None), "friction needs at least 1 dimension"),
        (fields(external_wrench=None), "external_wrench is missing"),
        (
            fields(friction=np.ones((2, 4)), external_wrench=np.ones((3, 6))),
            "batch dimensions do not broadcast",
        ),
        (fields(friction=[0.5, [0.5]]), "friction is not a rectangular array"),
        (fields(friction=["slippery"] * 4), "friction has the data type"),
        (fields(external_wrench=np.ones(6) * 1j), "external_wrench has the data type complex"),
        (fields(friction=torch.ones(4)), "friction is a torch tensor but grasp_map is not"),
        *(
            (changed(name, 1, size), f"{name} has an entry beyond 1e\\+30 in size")
            for name in ARRAY_FIELDS[:-1]
            for size in (1e31, 1e160, 1e200, 1e308)
        ),
        (changed("torque_min", 1, -1e200), "no limit is inf"),
        *(
            (changed(name, 1, 1e-160), f"{name} is smaller than 1e-100 in size, but not zero")
            for name in ("friction", "normal_min", "normal_max", "torque_max")
        ),
        *(
            (fields(**{name: 1e-160 * getattr(random_problem(seeded(0)), name)}), message)
            for name, message in (
                ("grasp_map", "grasp_map has force rows without any entry of 1e-30 or more"),
                ("hand_jacobian", "hand_jacobian is smaller than 1e-100 in size, but not zero"),
                ("external_wrench", "external_wrench is smaller than 1e-100"),
            )
        ),
        (fields(external_torque=np.full(8, 1e-200)), "external_torque is smaller than 1e-100"),
        (
            fields(grasp_map=np.repeat([1.0, 1e-160], 3)[:, None] * fields()["grasp_map"]),
            "grasp_map has torque rows without any entry of 1e-30 or more",
        ),
        (fields(objective=["min_norm"]), "is unknown; choose one of"),
        (fields(friction=np.array([0.5, None, 0.5, 0.5])), "friction has the data type object"),
    ],
)
def test_every_malformed_problem_is_refused_with_its_cause(
    arguments: dict[str, Any], message: str
) -> None:
    with pytest.raises(ProblemError, match=message) as error:
        GraspForceProblem(**arguments)
    assert isinstance(error.value, GraspForceError)
    assert isinstance(error.value, ValueError)
    assert "\n" not in str(error.value)
    if not isinstance(arguments["friction"], torch.Tensor) and "data type" not in message:
        # and the same for tensors
        try:
            tensors = {
                k: v if v is None or k == "objective" else torch.tensor(np.array(v))
                for k, v in arguments.items()
            }
        except ValueError:
            return
        with pytest.raises(ProblemError, match=message.replace("array of", "")):
            GraspForceProblem(**tensors)


def test_complex_tensors_are_refused() -> None:
    tensors = {k: torch.tensor(np.array(v)) for k, v in fields().items()}
    tensors["friction"] = tensors["friction"] + 0j
    with pytest.raises(ProblemError, match="friction has the data type torch"):
        GraspForceProblem(**tensors)


@pytest.mark.parametrize(
    ("name", "position", "value"),
    [
        ("friction", (1, 2, 0), -1.0),
        ("normal_max", (1, 2, 3), -1.0),
        ("torque_max", (1, 2, 0), -1e9),
        ("grasp_map", (1, 2, 0, 0), np.nan),
        ("grasp_map", (1, 2, slice(3, 6)), 0.0),
        ("external_wrench", (1, 2, 4), np.inf),
        ("contact_mask", (1, 2), False),
        ("contact_mask", (1, 2, 3), False),
    ],
)
def test_error_names_the_batch_index(name: str, position: tuple[Any, ...], value: float) -> None:
    batch = arrays(random_batch(seeded(0), 6, 4).reshape(2, 3))
    batch[name] = np.array(batch[name])
    batch[name][position] = value
    with pytest.raises(ProblemError, match=re.escape("(batch index 1, 2)")):
        GraspForceProblem(**batch)


def test_two_contacts_are_refused_in_a_batch_too() -> None:
    with pytest.raises(ProblemError, match=re.escape("rank 3 and not 6 (batch index 0)")):
        GraspForceProblem(**contacts(1, external_wrench=np.ones((2, 6))))


def test_rank_is_judged_in_any_unit_of_length() -> None:
    for unit in (1e-3, 1.0, 1e3, 1e6):
        wrench_unit = np.repeat([1.0, unit], 3)
        GraspForceProblem(**fields(grasp_map=wrench_unit[:, None] * fields()["grasp_map"]))
        flat = wrench_unit[:, None] * line_map([-0.03, 0.0, 0.01, 0.03])
        with pytest.raises(ProblemError, match="rank 5"):
            GraspForceProblem(**fields(grasp_map=flat))


def test_rank_of_float32_data_is_judged_by_its_rounding() -> None:
    rotation = np.linalg.qr(seeded(0).standard_normal((3, 3)))[0]
    points = np.outer([-0.03, 0.0, 0.01, 0.03], rotation[0]) + 0.001
    grasp_map = np.hstack([np.vstack([np.eye(3), skew(point)]) for point in points])
    single = {k: v if v.dtype == bool else v.astype(np.float32) for k, v in fields().items()}
    with pytest.raises(ProblemError, match="rank 5"):
        GraspForceProblem(**(single | {"grasp_map": grasp_map.astype(np.float32)}))


def test_crossed_limits_of_padding_contacts_do_not_matter() -> None:
    normal_min = np.append(fields()["normal_min"], 3.0)
    normal_max = np.append(fields()["normal_max"], 2.0)
    GraspForceProblem(**(PADDED | {"normal_min": normal_min, "normal_max": normal_max}))


def test_problem_is_frozen() -> None:
    problem = random_problem(seeded(0))
    with pytest.raises(dataclasses.FrozenInstanceError):
        problem.friction = np.ones(4)  # type: ignore[misc]


def test_replace_validates_again() -> None:
    problem = random_problem(seeded(0))
    linear = problem.replace(objective="sum_normal", friction=np.full(4, 0.3))
    assert linear.objective == "sum_normal"
    np.testing.assert_array_equal(linear.friction, np.full(4, 0.3))
    np.testing.assert_array_equal(linear.grasp_map, problem.grasp_map)
    with pytest.raises(ProblemError, match="negative"):
        problem.replace(friction=np.full(4, -0.3))


@pytest.mark.parametrize("kind", ["numpy", "torch"])
def test_indexing_takes_batch_dimensions_only(kind: str) -> None:
    batch = random_batch(seeded(2), 6)
    batch = batch.to_torch() if kind == "torch" else batch
    grid = batch.reshape(2, 3)
    assert grid[1].batch_shape == (3,)
    assert_same(grid[1, 2], batch[5])
    assert_same(grid[..., 2][1], batch[5])
    assert_same(grid[:, 1], batch[np.array([1, 4])])
    assert_same(batch[1:3], batch[np.array([False, True, True, False, False, False])])
    assert_same(batch[-1], batch[5])
    assert_same(grid.reshape(-1), batch)
    assert_same(grid.reshape(3, -1).reshape(6), batch)
    assert [p.batch_shape for p in batch] == [()] * 6
    for index in ((0, 0, 0), (..., 0, 0, 0), 2):
        with pytest.raises(IndexError):
            grid[index]
    with pytest.raises((ValueError, RuntimeError)):
        batch.reshape(4)


@given(SEEDS, st.integers(3, 6), st.integers(0, 3))
@settings(max_examples=20)
def test_padding_is_undone_by_dropping_it(seed: int, count: int, extra: int) -> None:
    problem = random_problem(seeded(seed), count)
    for original in (problem, problem.to_torch()):
        padded = original.pad(count + extra)
        assert padded.n_contacts == count + extra
        assert int(padded.contact_mask.sum()) == count
        assert_same(padded.without_padding(), original)
        GraspForceProblem(**arrays(padded))


def test_padding_cannot_shrink() -> None:
    problem = random_problem(seeded(0))
    with pytest.raises(ProblemError, match="4 contacts cannot be padded to 3"):
        problem.pad(3)
    with pytest.raises(TypeError, match="index the batch first"):
        random_batch(seeded(0), 2).without_padding()


def test_stack_pads_to_the_largest() -> None:
    rng = seeded(3)
    singles = [random_problem(rng, n) for n in (3, 6, 4)]
    for problems in (singles, [p.to_torch() for p in singles]):
        batch = GraspForceProblem.stack(problems)
        assert (batch.batch_shape, batch.n_contacts) == ((3,), 6)
        for one, original in zip(batch, problems, strict=True):
            assert_same(one.without_padding(), original)


@pytest.mark.parametrize(
    "other",
    [
        random_problem(seeded(0), objective="sum_normal"),
        random_problem(seeded(0)).to_torch(),
        random_batch(seeded(0), 2),
        random_problem(
            seeded(0),
            hand_jacobian=np.zeros((12, 1)),
            **dict.fromkeys(("torque_min", "torque_max", "external_torque"), np.zeros(1)),
        ),
    ],
)
def test_unlike_problems_do_not_stack(other: GraspForceProblem) -> None:
    with pytest.raises(ProblemError, match="stacked problems must share"):
        GraspForceProblem.stack([random_problem(seeded(0)), other])


def test_nothing_does_not_stack() -> None:
    with pytest.raises(ProblemError, match="nothing to stack"):
        GraspForceProblem.stack([])


@given(SEEDS, st.sampled_from(["min_norm", "sum_normal", "min_max_normal"]))
@settings(max_examples=10)
def test_saved_problems_come_back_bit_for_bit(
    tmp_path_factory: pytest.TempPathFactory, seed: int, objective: str
) -> None:
    folder = tmp_path_factory.mktemp("problems")
    batch = random_batch(seeded(seed), 4, objective=objective)
    for name, problem in (("batch", batch), ("single", batch[1]), ("torch", batch.to_torch())):
        first, second = folder / f"{name}.npz", folder / f"{name}-again.npz"
        problem.save(first)
        problem.save(second)
        assert first.read_bytes() == second.read_bytes()
        assert_same(GraspForceProblem.load(first), problem.to_numpy())


def npy_bytes() -> bytes:
    stream = io.BytesIO()
    np.save(stream, np.zeros(3))
    return stream.getvalue()


def npz_bytes(**members: Any) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **members)
    return stream.getvalue()


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"not an archive",
        npy_bytes(),
        npz_bytes(other=np.zeros(3)),
        npz_bytes(header=np.array("{")),
        npz_bytes(header=np.array("[1]")),
        npz_bytes(header=np.array('{"format": "graspforce-problem-1"}')),
        npz_bytes(header=np.array('{"format": "graspforce-problem-1", "objective": "min_norm"}')),
    ],
)
def test_other_files_are_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "file.npz"
    path.write_bytes(content)
    with pytest.raises(ProblemError, match=r"file\.npz is not a problem file"):
        GraspForceProblem.load(path)


def test_damaged_missing_and_foreign_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "file.npz"
    with pytest.raises(ProblemError, match="no problem file at"):
        GraspForceProblem.load(path)
    random_problem(seeded(0)).save(path)
    whole = path.read_bytes()
    middle = len(whole) // 2
    for damaged in (whole[:middle], whole[:middle] + b"?" + whole[middle + 1 :]):
        path.write_bytes(damaged)
        with pytest.raises(ProblemError, match="is not a problem file"):
            GraspForceProblem.load(path)
    path.write_bytes(npz_bytes(header=np.array('{"format": "future-9", "objective": "min_norm"}')))
    with pytest.raises(ProblemError, match="has the format 'future-9'"):
        GraspForceProblem.load(path)
    with pytest.raises(ProblemError, match="is not a problem file"):
        GraspForceProblem.load(tmp_path)


def test_loading_validates(tmp_path: Path) -> None:
    header = np.array('{"format": "graspforce-problem-1", "objective": "min_norm"}')
    path = tmp_path / "file.npz"
    path.write_bytes(npz_bytes(header=header, **changed("friction", 0, -1.0)))
    with pytest.raises(ProblemError, match="friction is negative"):
        GraspForceProblem.load(path)


def test_torch_round_trip_is_exact_and_shares_no_memory() -> None:
    batch = random_batch(seeded(4), 3)
    tensors = batch.to_torch()
    assert tensors.grasp_map.dtype == torch.float64
    assert_same(tensors.to_numpy(), batch)
    tensors.friction[:] = 7.0
    assert float(batch.friction.max()) <= 1.0
    small = batch.to_torch(dtype=torch.float32)
    assert small.grasp_map.dtype == torch.float32
    assert small.contact_mask.dtype == torch.bool
    assert_same(small.to_torch(), GraspForceProblem(**arrays(small.to_numpy().to_torch())))


def test_broadcast_problem_becomes_torch_without_warning() -> None:
    GraspForceProblem(**fields(external_wrench=np.ones((3, 6)))).to_torch()


def test_gradients_flow_into_the_fields() -> None:
    batch = random_batch(seeded(4), 3).to_torch()
    friction = batch.friction.clone().requires_grad_()
    problem = batch.replace(friction=friction).pad(9).to_torch(dtype=torch.float32)
    problem.friction.sum().backward()
    np.testing.assert_array_equal(friction.grad, np.ones(friction.shape))
    assert problem.to_numpy().friction.dtype == np.float64


def test_arrays_that_are_changed_afterwards_change_no_problem() -> None:
    mine = {name: array.copy() for name, array in fields().items()}
    problem = GraspForceProblem(**mine)
    before = {name: array.copy() for name, array in arrays(problem).items()}
    answer = solve(problem)
    violations = answer.friction_violation(), answer.torque_violation()
    for array in mine.values():
        array[...] = -7
    for name, array in arrays(problem).items():
        np.testing.assert_array_equal(array, before[name])
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0
    assert violations == (answer.friction_violation(), answer.torque_violation())


def test_tensors_that_are_changed_afterwards_change_no_problem() -> None:
    mine = {name: torch.tensor(array) for name, array in fields().items()}
    leaf = mine["friction"].requires_grad_()
    problem = GraspForceProblem(**mine)
    before = problem.to_numpy()
    with torch.no_grad():
        for tensor in mine.values():
            tensor.fill_(0)
    assert_same(problem.to_numpy(), before)
    # the copy is in the graph: gradients reach the tensor that was given
    (3.0 * problem.friction).sum().backward()
    assert leaf.grad is not None
    np.testing.assert_array_equal(leaf.grad, np.full(leaf.shape, 3.0))


@given(SEEDS, st.sampled_from([1e-28, 1e-12, 1e12, 1e28]), st.sampled_from([1e-12, 1.0, 1e12]))
@settings(max_examples=20)
def test_problems_in_the_strangest_units_have_the_same_answer(
    seed: int, newton: float, metre: float
) -> None:
    """What is accepted is answered, whatever the units: no square of it overflows or vanishes."""
    problem = random_problem(seeded(seed))
    metre = metre if newton * metre < 1e28 else 1.0 / metre  # within what is accepted
    torque = newton * metre
    units = np.repeat([1.0, metre], 3)
    other = problem.replace(
        grasp_map=units[:, None] * problem.grasp_map,
        hand_jacobian=metre * problem.hand_jacobian,
        external_wrench=newton * units * problem.external_wrench,
        normal_min=newton * problem.normal_min,
        normal_max=newton * problem.normal_max,
        **{
            name: torque * getattr(problem, name)
            for name in ("torque_min", "torque_max", "external_torque")
        },
    )
    here, there = solve(problem), solve(other)
    assert here.status == there.status
    if here.status == "optimal":
        size = np.linalg.norm(here.forces)
        np.testing.assert_allclose(there.forces / newton, here.forces, atol=1e-9 * size)


def test_remainders_of_sums_are_no_error() -> None:
    """Computed entries that should be zero, but are not, lie beside larger ones."""
    problem = random_problem(seeded(0))
    tiny = {
        name: getattr(problem, name) + 0.0
        for name in ("grasp_map", "hand_jacobian", "external_wrench")
    }
    tiny["grasp_map"][0, 0] = tiny["hand_jacobian"][0, 0] = 1e-170
    tiny["external_wrench"][0] = 5e-324
    zero = {name: np.where(np.abs(array) < 1e-100, 0.0, array) for name, array in tiny.items()}
    answers = [solve(problem.replace(**changes)) for changes in (tiny, zero)]
    assert answers[0].status == answers[1].status == "optimal"
    np.testing.assert_allclose(answers[0].forces, answers[1].forces, atol=1e-12)
