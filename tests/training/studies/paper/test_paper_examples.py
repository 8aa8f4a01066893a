"""The paper's two printed programs: exact arithmetic, HiGHS, the ODE by two integrators, fits."""

from fractions import Fraction
from functools import cache

import numpy as np
import pytest
import torch

from gfo_env.hand import BARRETT_BH8_280
from solvers.paper.kkt_ode import integrate, integrate_with_scipy
from tests.support.seeds import reseeded
from training.studies.paper.examples import (
    BENCHMARK,
    GRASP,
    HORIZON,
    WALL_SPAN,
    BenchmarkSolutions,
    GraspSolutions,
    PrintedProgram,
    solve_benchmark,
    solve_grasp_program,
    unbounded_ray,
)

OPTIMUM = Fraction("-23.43")


@cache
def benchmark() -> BenchmarkSolutions:
    return solve_benchmark((reseeded(0), reseeded(1)))


@cache
def grasp() -> GraspSolutions:
    return solve_grasp_program()


def numbers(values: tuple[Fraction, ...]) -> np.ndarray:
    return np.array([float(value) for value in values])


def test_programs_are_those_that_are_printed() -> None:
    """Equations 39 and 40, once more, as a reader would type them."""
    x = np.arange(1.0, 10.0)
    x1, x2, x3, x4 = x[:4]
    row, cost = numbers(BENCHMARK.row), numbers(BENCHMARK.cost)
    assert cost @ x[:4] == pytest.approx(-9.54 * x1 - 8.16 * x2 - 4.26 * x3 - 11.43 * x4)
    assert row @ x[:4] == pytest.approx(3.18 * x1 + 2.72 * x2 + 1.42 * x3 + 3.81 * x4)
    assert float(BENCHMARK.bound) == 7.81
    x11, x12, x13, x21, x22, x23, x31, x32, x33 = x
    left = 1.7744 * x11 + 1.8984 * x12 + 1.5 * x13 + 2.1994 * x21 + 1.858 * x22
    left += 1.5 * x23 + 1.8642 * x31 + 1.7924 * x32 + 1.5 * x33 + 600
    assert float(GRASP.bound) - numbers(GRASP.row) @ x == pytest.approx(left)
    assert numbers(GRASP.cost) @ x == sum(x)


def test_cone_program_is_the_printed_program() -> None:
    for printed in (BENCHMARK, GRASP):
        program = printed.program
        np.testing.assert_array_equal(program.linear, numbers(printed.cost))
        np.testing.assert_array_equal(program.matrix, numbers(printed.row)[None])
        assert program.bound.tolist() == [float(printed.bound)]
        assert program.cone.nonnegative == program.cone.rows == 1
        assert torch.count_nonzero(program.quadratic) == 0


def test_benchmark_is_optimal_on_a_whole_face() -> None:
    assert all(c == -3 * a for c, a in zip(BENCHMARK.cost, BENCHMARK.row, strict=True))
    assert -3 * BENCHMARK.bound == OPTIMUM
    figures = benchmark()
    assert figures.proportional
    assert figures.optimum == pytest.approx(float(OPTIMUM), rel=1e-9)
    # no component is bounded on it, so that "the" solution is a matter of where one starts
    np.testing.assert_array_equal(figures.face, np.tile([-np.inf, np.inf], (4, 1)))


def test_ode_rests_at_the_point_of_the_face_that_is_nearest_to_the_origin() -> None:
    figures = benchmark()
    for objective in (figures.ode_objective, figures.scipy_objective):
        assert objective == pytest.approx(float(OPTIMUM), rel=1e-6)
    row = numbers(BENCHMARK.row)
    np.testing.assert_allclose(
        figures.ode_end, row * float(BENCHMARK.bound) / (row @ row), rtol=1e-6
    )
    assert figures.at_horizon == pytest.approx(float(OPTIMUM), rel=1e-4)
    assert figures.at_horizon != pytest.approx(float(OPTIMUM), rel=1e-6)


@pytest.mark.parametrize("printed", [BENCHMARK, GRASP], ids=["benchmark", "grasp"])
def test_integrators_agree_along_the_path(printed: PrintedProgram) -> None:
    times = torch.tensor([0.0, 0.05, 0.1, 1.0, 10.0, 37.0, 39.0, 50.0], dtype=torch.float64)
    path, oracle = (method(printed.program, times) for method in (integrate, integrate_with_scipy))
    torch.testing.assert_close(path.x, oracle.x, rtol=1e-6, atol=1e-6)
    torch.testing.assert_close(path.u, oracle.u, rtol=1e-6, atol=1e-6)
    # from zero, x never leaves the span of cost and row
    basis = np.linalg.qr(np.column_stack([numbers(printed.cost), numbers(printed.row)]))[0]
    outside = path.x.numpy() - path.x.numpy() @ basis @ basis.T
    assert np.abs(outside).max() < 1e-6


def test_printed_point_of_the_benchmark_is_near_the_face_and_far_from_the_ode() -> None:
    assert BENCHMARK.objective(BENCHMARK.point) == Fraction("-23.4108")
    assert BENCHMARK.slack(BENCHMARK.point) == Fraction("0.0064")
    figures = benchmark()
    assert figures.printed_objective == -23.4108
    assert figures.printed_slack == 0.0064
    row, printed = numbers(BENCHMARK.row), numbers(BENCHMARK.point)
    assert figures.edge_distance == pytest.approx(0.0064 / np.linalg.norm(row))
    assert figures.printed_distance == pytest.approx(np.linalg.norm(printed - figures.ode_end))
    assert figures.printed_distance > 0.6
    assert figures.horizon_distance == pytest.approx(figures.printed_distance, rel=1e-3)
    # within 0.1 % of the optimum, as the paper's network was
    assert abs(figures.printed_objective / float(OPTIMUM) - 1.0) < 1e-3


def test_networks_solve_the_benchmark_to_a_thousandth() -> None:
    figures = benchmark()
    assert figures.network_objective.shape == (2,)
    there = integrate(BENCHMARK.program, torch.tensor([0.0, 10.0], dtype=torch.float64))
    for one, objective in zip(figures.fits, figures.network_objective, strict=True):
        assert len(one.losses) == 1000
        assert one.losses[-1] < 1e-4 * one.losses[0]
        assert float(numbers(BENCHMARK.cost) @ one.x.numpy()) == pytest.approx(objective)
        # the flow brings no two states farther apart, so that what the network misses of it adds
        # up at most: |y(T) - y*(T)| <= T times the root of the mean square, which is the loss
        apart = torch.cat([one.x - there.x[1], one.u - there.u[1]]).norm()
        assert float(apart) <= 10.0 * np.sqrt(one.losses[-1])
        # the ODE's point of the face, and not the printed one
        assert np.linalg.norm(one.x.numpy() - figures.ode_end) < 0.1
    np.testing.assert_allclose(figures.network_objective, float(OPTIMUM), rtol=1e-3)


def test_grasp_program_is_unbounded_by_exact_arithmetic_and_by_highs() -> None:
    figures = grasp()
    assert "unbounded" in figures.highs_status
    ray = figures.ray
    assert sum(c * d for c, d in zip(GRASP.cost, ray, strict=True)) == figures.ray_cost < 0
    assert sum(a * d for a, d in zip(GRASP.row, ray, strict=True)) == figures.ray_slope == 0
    assert all(isinstance(component, Fraction) for component in ray)
    for length in (0, 1, 10**9):
        there = tuple(p + length * d for p, d in zip(GRASP.point, ray, strict=True))
        assert GRASP.slack(there) == GRASP.slack(GRASP.point) > 0
        assert GRASP.objective(there) == GRASP.objective(GRASP.point) + length * figures.ray_cost


def test_benchmark_has_no_such_ray() -> None:
    with pytest.raises(ValueError, match="multiple of the row"):
        unbounded_ray(BENCHMARK)


def test_printed_point_of_the_grasp_is_on_the_edge_but_for_a_sign() -> None:
    flipped = (-GRASP.point[0], *GRASP.point[1:])
    assert GRASP.slack(GRASP.point) == Fraction("129.8867818")
    assert GRASP.slack(flipped) == Fraction("-0.002847")
    assert grasp().printed_slack == pytest.approx(129.8867818)
    assert grasp().flipped_slack == pytest.approx(-0.002847)


def test_ode_of_the_grasp_falls_to_the_edge_and_drifts_along_it_for_ever() -> None:
    figures = grasp()
    x, times = figures.path.x.numpy(), figures.path.times.numpy()
    assert figures.wall_time == pytest.approx(600 / 15.8866, rel=1e-4)
    before = times < figures.wall_time - 0.1
    np.testing.assert_allclose(x[before], -np.tile(times[before, None], 9), atol=1e-6)
    np.testing.assert_allclose(figures.path.u[before], 0.0, atol=1e-6)
    assert figures.path_slack[before].min() > 1.0
    late = times > figures.wall_time + 10.0
    assert np.abs(figures.path_slack[late]).max() < 0.5
    # along the edge the objective falls by the squared part of cost that the edge leaves free
    cost, row = numbers(GRASP.cost), numbers(GRASP.row)
    free = cost - row * (cost @ row) / (row @ row)
    assert figures.exact_drift == pytest.approx(-free @ free)
    assert figures.drift == pytest.approx(figures.exact_drift, rel=1e-4)
    assert figures.drift < -0.1
    assert times[-1] == WALL_SPAN


def test_printed_point_is_nearest_to_the_path_where_it_meets_the_edge() -> None:
    figures = grasp()
    assert abs(figures.nearest_time - figures.wall_time) < 0.2
    flipped = numbers(GRASP.point) * np.array([-1.0] + [1.0] * 8)
    moment = int(np.searchsorted(figures.path.times.numpy(), figures.nearest_time))
    apart = np.linalg.norm(figures.path.x[moment].numpy() - flipped)
    assert figures.nearest_distance == pytest.approx(apart)
    everywhere = np.linalg.norm(figures.path.x.numpy() - flipped, axis=1)
    assert np.all(everywhere >= apart)
    # a twentieth of the point's size is left: the path comes near it, and never through it
    assert 0.03 < apart / np.linalg.norm(flipped) < 0.1


def test_network_of_the_grasp_program_is_at_minus_ten_where_the_ode_is() -> None:
    figures = grasp()
    np.testing.assert_allclose(figures.at_horizon, -HORIZON, atol=1e-6)
    np.testing.assert_allclose(figures.network_end, -HORIZON, atol=0.05)
    assert figures.fit.losses[-1] < 1e-4 * figures.fit.losses[0]
    # the printed values cannot come from T = 10
    assert np.abs(numbers(GRASP.point)).min() > 3.0 * HORIZON


def test_printed_components_are_neither_contact_forces_nor_joint_torques() -> None:
    figures = grasp()
    np.testing.assert_array_equal(figures.pushing, [1, 0, 0])
    printed = numbers(GRASP.point).reshape(3, 3)
    assert np.all(printed[:, 2] < 0.0)  # x_i3, the normal force of the paper's P_i, pulls
    for finger in printed[1:]:
        for normal in range(3):
            others = np.delete(finger, normal)
            for mu in (0.0, 0.5, 1.0, 1e6):
                assert np.hypot(*others) > mu * finger[normal]
    assert np.all(figures.friction_needed > 1.4)
    assert np.abs(printed).min() > 15.0 * max(BARRETT_BH8_280.max_torque)
