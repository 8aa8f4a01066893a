"""The lifted program: a bound on every grasp on the facets, which each of them satisfies."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from solvers import ProblemError, solve
from solvers.arrays import Array
from solvers.synthesis import GRASP_MATRIX_FLOOR, ContactFacets, force_problems
from solvers.synthesis.ascent import reaches
from solvers.synthesis.lifted import INTERIOR_FRICTION, INTERIOR_PRELOAD, LiftedSynthesis
from solvers.synthesis.rank_one import separating_wrench
from tests.support.facets import (
    LENGTH,
    X,
    Y,
    Z,
    box_facets,
    even_internal_forces,
    least_eigenvalue,
    points_on,
    random_facets,
    random_loads,
)
from tests.support.problems import random_rotation
from tests.support.seeds import SEEDS, seeded

COUNTS = st.integers(3, 5)
NO_LOADS = np.zeros((0, 6))


def feasible_point(
    facets: ContactFacets, positions: Array, loads: Array
) -> tuple[float, Array] | None:
    """Reach and forces (n, 1 + K, 3) at fixed positions, load 0 internal; None if there are none.

    By the force problems alone, which know nothing of a lift.
    """
    least, internal = even_internal_forces(facets, positions)
    if least < INTERIOR_PRELOAD + 1e-6:
        return None
    if least_eigenvalue(facets, positions) < GRASP_MATRIX_FLOOR:
        return None
    reach = 1.0
    forces = np.zeros((0, len(facets), 3))
    if len(loads):
        answer = solve(force_problems(facets, positions, loads, "sum_normal"), "clarabel")
        reach = float(1.0 / answer.objective.max())
        forces = reach * len(facets) * answer.forces.reshape(len(loads), -1, 3)
    return reach, np.concatenate([internal[None], forces]).swapaxes(0, 1)


def rows_at(
    program: LiftedSynthesis, local: Array, forces: Array, reach: float
) -> list[tuple[str, Array]]:
    """The rows b - A x of each cone, by its kind, where x is the rank-one lift of a point."""
    one = np.ones((*forces.shape[:2], 1))
    places = np.broadcast_to(local[:, None], (*forces.shape[:2], 2))
    vectors = np.concatenate([places, forces, one], axis=-1)
    blocks = vectors[..., :, None] * vectors[..., None, :]
    x = np.full(program._size, np.nan)
    x[program._reach] = reach
    variable = program._blocks >= 0
    x[program._blocks[variable]] = blocks[variable]
    slack, start, parts = program._bound - program._matrix @ x, 0, []
    for cone in program._cones:
        kind = type(cone).__name__
        size = cone.dim * (cone.dim + 1) // 2 if kind == "PSDTriangleConeT" else cone.dim
        parts.append((kind, slack[start : start + size]))
        start += size
    assert start == len(slack)
    return parts


def matrix_of(rows: Array) -> Array:
    """The symmetric 6 by 6 matrix of a semidefinite cone's rows."""
    matrix = np.zeros((6, 6))
    # the upper triangle by columns is the lower one by rows
    matrix[np.tril_indices(6)] = rows / np.sqrt(2.0)
    return matrix + matrix.T - np.diag(np.diag(matrix)) * (2.0 - np.sqrt(2.0))


def worst_row(program: LiftedSynthesis, local: Array, forces: Array, reach: float) -> float:
    """How far b - A x lies outside K at the rank-one lift of a point."""
    measure = {
        "ZeroConeT": lambda rows: np.abs(rows).max(),
        "NonnegativeConeT": lambda rows: -rows.min(),
        "SecondOrderConeT": lambda rows: np.linalg.norm(rows[1:]) - rows[0],
        "PSDTriangleConeT": lambda rows: -np.linalg.eigvalsh(matrix_of(rows))[0],
    }
    return max(measure[kind](rows) for kind, rows in rows_at(program, local, forces, reach))


@settings(max_examples=25)
@given(seed=SEEDS, count=COUNTS, loads=st.integers(1, 4))
def test_relaxation_bounds_the_reach_at_any_positions(seed: int, count: int, loads: int) -> None:
    facets, rng = random_facets(seed, count), seeded(seed)
    directions = random_loads(rng, loads)
    points = [points_on(facets, rng) for _ in range(4)]
    points = [point for point in points if feasible_point(facets, point, NO_LOADS) is not None]
    assume(points)
    bound = LiftedSynthesis(facets, directions).solve().reach
    for point in points:
        assert reaches(facets, point, directions)[0].min() <= bound + 1e-6


@settings(max_examples=40)
@given(seed=SEEDS, count=COUNTS, loads=st.integers(0, 3))
def test_every_feasible_point_satisfies_every_row(seed: int, count: int, loads: int) -> None:
    facets, rng = random_facets(seed, count), seeded(seed)
    directions = random_loads(rng, loads)
    positions = points_on(facets, rng)
    found = feasible_point(facets, positions, directions)
    assume(found is not None)
    assert found is not None
    reach, forces = found
    program, local = LiftedSynthesis(facets, directions), facets.local(positions)
    assert worst_row(program, local, forces, reach) < 1e-6
    # ... and no infeasible one does
    load = int(rng.integers(1 + loads))
    assert worst_row(program, local + 3.0, forces, reach) > 0.1
    assert worst_row(program, local, -forces, reach) > 0.01
    pushed = forces.copy()
    pushed[0, load] += [0.0, 0.0, 1.0]
    assert worst_row(program, local, pushed, reach) > 0.01
    if loads:
        assert worst_row(program, local, forces, 1.1 * reach) > 0.01 * reach


def test_internal_forces_must_keep_their_margins() -> None:
    """Squeezed along x and y; the contacts along x push up, those along y push down as much."""
    facets = box_facets(np.array([X, -X, Y, -Y]), friction=0.5, centre=(0, 0, 0))
    program, local = LiftedSynthesis(facets, NO_LOADS), np.zeros((4, 2))
    up = np.einsum("nji,j->ni", facets.frames, Z) * np.array([1.0, 1.0, -1.0, -1.0])[:, None]

    def beyond(share: float, preload: float) -> float:
        normal = np.array([2.0 - preload, 2.0 - preload, preload, preload])
        forces = 0.5 * share * preload * up + normal[:, None] * Z
        return worst_row(program, local, forces[:, None], 0.0)

    assert beyond(INTERIOR_FRICTION, 1.0) < 1e-9
    assert beyond(INTERIOR_FRICTION + 0.01, 1.0) == pytest.approx(0.005 / np.sqrt(2), rel=0.5)
    assert beyond(INTERIOR_FRICTION, INTERIOR_PRELOAD) < 1e-9
    assert beyond(INTERIOR_FRICTION, INTERIOR_PRELOAD - 0.01) == pytest.approx(0.01)


@settings(max_examples=20)
@given(seed=SEEDS, count=COUNTS)
def test_grasp_matrix_is_that_of_the_positions(seed: int, count: int) -> None:
    facets, rng = random_facets(seed, count), seeded(seed)
    local, forces = rng.normal(size=(count, 2)), np.ones((count, 1, 3))
    kind, rows = rows_at(LiftedSynthesis(facets, NO_LOADS), local, forces, 0.0)[-1]
    assert kind == "PSDTriangleConeT"
    units = np.repeat([1.0, 1.0 / LENGTH], 3)
    grasp_map = units[:, None] * facets.grasp_map(facets.positions(local))
    expected = grasp_map @ grasp_map.T - GRASP_MATRIX_FLOOR * np.eye(6)
    np.testing.assert_allclose(matrix_of(rows), expected, atol=1e-9)


@settings(max_examples=10)
@given(seed=SEEDS, count=COUNTS)
def test_relaxed_points_keep_the_products_that_hold_at_rank_one(seed: int, count: int) -> None:
    """Of sides with sides, and of sides with normal forces; s and f need not fit each other."""
    facets, rng = random_facets(seed, count), seeded(seed)
    assume(separating_wrench(facets) is None)
    point = LiftedSynthesis(facets, random_loads(rng, 2)).solve()
    assert (np.linalg.eigvalsh(point.blocks) > -1e-6).all()
    for (sides, bounds), blocks in zip(facets.sides, point.blocks, strict=True):
        gaps = np.hstack([-sides, np.zeros((len(sides), 3)), bounds[:, None]])
        normal = np.eye(6)[4]
        assert (gaps @ blocks @ np.eye(6)[5]).min() > -1e-6
        assert (gaps @ blocks @ gaps.T).min() > -1e-6
        assert (gaps @ blocks @ normal).min() > -1e-6


@settings(max_examples=10)
@given(seed=SEEDS, count=COUNTS)
def test_relaxation_depends_on_no_frame_unit_or_order(seed: int, count: int) -> None:
    facets, rng = random_facets(seed, count), seeded(seed)
    assume(separating_wrench(facets) is None)
    loads, rotation = random_loads(rng, 2), random_rotation(rng)
    rings, normals, friction = facets.corners, facets.normals, facets.friction
    order = rng.permutation(count)
    others = {
        "rotated": (
            ContactFacets(
                tuple(ring @ rotation.T for ring in rings), normals @ rotation.T, friction, LENGTH
            ),
            loads @ np.kron(np.eye(2), rotation).T,
        ),
        "in millimetres": (
            ContactFacets(tuple(1e3 * ring for ring in rings), normals, friction, 1e3 * LENGTH),
            loads,
        ),
        "in another order": (
            ContactFacets(tuple(rings[i] for i in order), normals[order], friction[order], LENGTH),
            loads[::-1],
        ),
        "from other corners": (
            ContactFacets(
                tuple(np.roll(ring[::-1], 2, axis=0) for ring in rings), normals, friction, LENGTH
            ),
            loads,
        ),
    }
    reach = LiftedSynthesis(facets, loads).solve().reach
    for name, (other, turned) in others.items():
        assert LiftedSynthesis(other, turned).solve().reach == pytest.approx(reach, abs=1e-6), name


def test_longer_loads_are_carried_less_far() -> None:
    facets = random_facets(1, 4)
    loads = random_loads(seeded(1), 2)
    reach = LiftedSynthesis(facets, loads).solve().reach
    assert LiftedSynthesis(facets, 4.0 * loads).solve().reach == pytest.approx(0.25 * reach)


@pytest.mark.parametrize(
    ("loads", "message"),
    [
        (np.eye(6)[:, :2], r"must have shape \(K, 6\), not \(6, 2\)"),
        (np.ones(6), r"must have shape \(K, 6\), not \(6,\)"),
        (np.full((1, 6), np.nan), "must be finite"),
        (np.vstack([np.ones(6), np.zeros(6)]), "none may be zero"),
    ],
)
def test_malformed_loads_are_refused(loads: Array, message: str) -> None:
    with pytest.raises(ProblemError, match=message):
        LiftedSynthesis(random_facets(0, 4), loads)
