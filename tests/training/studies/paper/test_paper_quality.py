"""q_lrw of the paper's set-up: a real grasp, every convention, and what 6.7 can and cannot mean."""

from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import linprog

from gfo_env.conditions import FRICTION_FACTOR, PRELOAD, STANDARD_GRAVITY
from gfo_env.contacts import is_force_closure, lowest_resisted_wrench
from gfo_env.exceptions import AcquisitionError, QualityError
from tests.support.seeds import seeded
from training.studies.paper.quality import (
    EDGE_COUNTS,
    PRINTED_QUALITY,
    Hull,
    arbitrary_forces,
    closure,
    conventions,
    force_scale_for,
    hull,
    length_for,
    lengths,
    quality,
    strongest_scale,
    vertex_distance,
)
from training.studies.paper.three_fingers import FORCES, PRINTED_NORMAL_FORCES, PaperGrasp, acquire

QUICK_SEED = 4


@cache
def paper_grasp() -> PaperGrasp:
    return acquire(0)


@cache
def paper_hull() -> Hull:
    return hull(paper_grasp())


def largest_multiple(points: np.ndarray, direction: np.ndarray) -> float:
    """The largest s for which s * direction is in the convex hull of the origin and the points."""
    cost = np.append(np.zeros(len(points)), -1.0)
    rows = np.hstack([points.T, -direction[:, None]])
    answer = linprog(
        cost,
        A_eq=rows,
        b_eq=np.zeros(points.shape[1]),
        A_ub=np.append(np.ones(len(points)), 0.0)[None],
        b_ub=[1.0],
    )
    assert answer.status == 0
    return float(answer.x[-1])


def random_directions(count: int, size: int) -> np.ndarray:
    directions = seeded(3).normal(size=(count, size))
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def test_grasp_is_the_paper_s_three_contacts_one_a_finger() -> None:
    grasp = paper_grasp()
    assert sorted(grasp.fingers) == [1, 2, 3]
    assert grasp.radius >= np.linalg.norm(grasp.contacts.positions, axis=1).max()
    friction = np.full(3, grasp.friction)
    assert is_force_closure(grasp.contacts.positions, grasp.contacts.normals, friction)


def test_forces_of_the_grasp_carry_its_weight_within_cones_and_torque_limits() -> None:
    grasp = paper_grasp()
    problem, forces = grasp.problem, grasp.forces
    assert str(grasp.solution.status) == "optimal"
    load = np.asarray(problem.external_wrench)
    assert_allclose(grasp.grasp.pose.rotation @ load[:3], grasp.mass * grasp.gravity, atol=1e-12)
    assert np.linalg.norm(load[:3]) == pytest.approx(grasp.mass * STANDARD_GRAVITY)
    assert_allclose(problem.grasp_map @ forces.ravel() + load, 0, atol=1e-7)
    tangential = np.linalg.norm(forces[:, :2], axis=1)
    planned = FRICTION_FACTOR * grasp.friction * forces[:, 2]
    assert np.all(tangential <= planned + 1e-7)
    assert np.all(grasp.normal_forces() >= PRELOAD - 1e-7)
    torques = forces.ravel() @ problem.hand_jacobian + problem.external_torque
    assert np.all((torques >= problem.torque_min) & (torques <= problem.torque_max))


def test_acquisition_is_deterministic_and_depends_on_the_seed() -> None:
    first, second = acquire(QUICK_SEED), acquire(QUICK_SEED)
    assert first.object_id == second.object_id != paper_grasp().object_id
    assert first.attempt == second.attempt
    assert first.contacts.positions.tobytes() == second.contacts.positions.tobytes()
    assert first.forces.tobytes() == second.forces.tobytes()


def test_acquisition_with_a_negative_seed() -> None:
    with pytest.raises(AcquisitionError, match="0 or more"):
        acquire(-1)


def test_normal_forces_by_name() -> None:
    grasp = paper_grasp()
    assert_allclose(grasp.normal_forces("unit"), 1.0)
    assert_allclose(grasp.normal_forces("commanded"), grasp.forces[:, 2])
    assert_allclose(grasp.normal_forces("commanded x 10"), 10 * grasp.forces[:, 2])
    printed = grasp.normal_forces("printed sizes")
    by_finger = dict(zip(grasp.fingers.tolist(), printed.tolist(), strict=True))
    assert tuple(by_finger[finger] for finger in (1, 2, 3)) == PRINTED_NORMAL_FORCES
    with pytest.raises(QualityError, match="printed sizes"):
        grasp.normal_forces("enormous")


def test_conventions_are_one_grasp_from_thousandths_to_beyond_the_printed_figure() -> None:
    rows = conventions(paper_grasp())
    assert len(rows) == len(FORCES) * len(lengths(paper_grasp())) * len(EDGE_COUNTS)
    assert min(row.lower for row in rows) < 0.01
    assert max(row.lower for row in rows) > PRINTED_QUALITY
    for row in rows:
        assert 0 < row.lower <= row.upper


def test_intervals_of_one_convention_agree_whatever_the_edges() -> None:
    by_convention: dict[tuple[str, str], list] = {}
    for row in conventions(paper_grasp()):
        by_convention.setdefault((row.forces, row.length_name), []).append(row)
    for rows in by_convention.values():
        assert [row.edges for row in rows] == list(EDGE_COUNTS)
        lower = [row.lower for row in rows]
        assert lower == sorted(lower), "more edges, a larger hull"
        assert max(lower) <= min(row.upper for row in rows)


def test_quality_is_linear_in_the_forces_and_falls_with_the_length() -> None:
    grasp = paper_grasp()
    assert quality(grasp, forces="commanded x 10").lower == pytest.approx(
        10 * quality(grasp).lower, rel=1e-6
    )
    by_length = [quality(grasp, length=length).lower for length in np.geomspace(1e-4, 10, 12)]
    assert by_length == sorted(by_length, reverse=True)
    refined = quality(grasp, relative_width=0.01)
    assert quality(grasp).lower <= refined.upper
    assert refined.upper - refined.lower <= 0.01 * refined.upper


def test_force_scale_at_which_quality_would_be_the_printed_figure() -> None:
    grasp = paper_grasp()
    scale = force_scale_for(grasp)
    contacts = grasp.contacts
    scaled = lowest_resisted_wrench(
        contacts.positions,
        contacts.normals,
        np.full(3, grasp.friction),
        normal_forces=scale * grasp.normal_forces(),
        length=grasp.radius,
    )
    assert scaled.lower == pytest.approx(PRINTED_QUALITY, rel=1e-6)
    assert scale > strongest_scale(grasp), "the hand is too weak for it"


def test_strongest_scale_takes_one_joint_to_its_limit() -> None:
    grasp = paper_grasp()
    problem, scale = grasp.problem, strongest_scale(grasp)
    torques = scale * grasp.forces.ravel() @ problem.hand_jacobian + problem.external_torque
    slack = np.minimum(problem.torque_max - torques, torques - problem.torque_min)
    assert slack.min() == pytest.approx(0, abs=1e-9)


def test_length_at_which_quality_would_be_the_printed_figure() -> None:
    grasp = paper_grasp()
    length = length_for(grasp)
    found = quality(grasp, forces="printed sizes", length=length)
    assert found.lower == pytest.approx(PRINTED_QUALITY, rel=1e-6)
    assert lengths(grasp)["1 mm"] < length < grasp.radius


def test_no_length_makes_quality_exceed_the_largest_pure_force() -> None:
    grasp = paper_grasp()
    assert np.isnan(length_for(grasp, forces="commanded"))
    assert np.isnan(length_for(grasp, target=1e-9, forces="commanded"))
    pure = [
        largest_multiple(paper_hull().wrenches, np.append(direction, np.zeros(3)))
        for direction in random_directions(60, 3)
    ]
    assert quality(grasp, length=1e-5).lower <= min(pure)


def test_positive_quality_is_force_closure_and_the_other_program_s_figure_is_not() -> None:
    rows = closure(paper_grasp(), np.arange(0.0, 1.01, 0.1).tolist())
    assert [row.quality > 0 for row in rows] == [row.closes for row in rows]
    assert [row.interior_force for row in rows] == [row.closes for row in rows]
    assert {row.closes for row in rows} == {False, True}
    qualities = [row.quality for row in rows]
    assert qualities == sorted(qualities)
    # one figure for all frictions, positive where nothing closes
    assert len({row.vertex_distance for row in rows}) == 1
    assert rows[0].vertex_distance > 0


def test_quality_validates_contacts_and_not_forces() -> None:
    drawn = arbitrary_forces(paper_grasp(), 60)
    assert drawn.positive == drawn.count == 60
    assert 0 < drawn.lowest < 0.2 * drawn.highest
    assert drawn.least_residual > 0.1


def test_vertex_distance_is_positive_where_all_contacts_push_the_same_way() -> None:
    positions = 0.03 * np.array([[1.0, 0.0, 1.0], [-0.6, 0.8, 1.0], [-0.6, -0.7, 1.0]])
    normals = np.tile([0.0, 0.0, -1.0], (3, 1))
    assert not is_force_closure(positions, normals, np.ones(3))
    forces = np.array([1.0, 2.0, 3.0])
    distance = vertex_distance(positions, normals, forces, 0.05)
    assert distance > 0
    doubled = vertex_distance(positions, normals, 2 * forces, 0.05, pyramid_radius=0.12)
    assert doubled == pytest.approx(2 * distance, rel=1e-6)
    # edges have the length N / sides, so no vertex is farther than that from their mean
    far = vertex_distance(positions, normals, forces, 1e6, sides=12)
    assert far < 2 * forces.max() / 12


def test_hull_s_ball_lies_inside_and_touches() -> None:
    found = paper_hull()
    assert found.wrenches.shape == (3 * found.edges, 6)
    assert found.radius == pytest.approx(quality(paper_grasp()).lower)
    assert np.linalg.norm(found.touch) == pytest.approx(found.radius)
    outward = found.touch / found.radius
    assert largest_multiple(found.wrenches, outward) == pytest.approx(found.radius, rel=1e-5)
    for direction in random_directions(40, 6):
        assert largest_multiple(found.wrenches, direction) >= found.radius


@pytest.mark.parametrize("kind", ["force", "torque"])
def test_projections_hold_the_ball_and_overstate_it(kind) -> None:
    found = paper_hull()
    projection = getattr(found, kind)
    assert projection.inradius > found.radius
    first, second, third = projection.points[projection.faces].transpose(1, 0, 2)
    normals = np.cross(second - first, third - first)
    offsets = np.einsum("fi,fi->f", normals, first) / np.linalg.norm(normals, axis=1)
    assert offsets.min() == pytest.approx(projection.inradius, rel=1e-9)
    heights = projection.points @ normals.T - np.einsum("fi,fi->f", normals, first)
    assert heights.max() < 1e-9, "every point behind every face"
    columns = slice(0, 3) if kind == "force" else slice(3, 6)
    assert_allclose(projection.points[1:], found.wrenches[:, columns])
