"""Bilinear matrix inequalities: what is solved holds, what is bounded or proven is true."""

from typing import Any

import cvxpy
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from solvers.arrays import Array
from solvers.exceptions import ProblemError
from solvers.paper.bilinear import (
    RANK_ONE,
    BilinearMatrixInequality,
    BilinearSolution,
    BilinearStatus,
    minimise,
)
from solvers.synthesis import SynthesisStatus
from tests.support.seeds import SEEDS, seeded


def symmetric(rng: np.random.Generator, *shape: int) -> Array:
    matrices = rng.standard_normal(shape)
    return matrices + matrices.swapaxes(-1, -2)


def random_inequality(rng: np.random.Generator, count: int, size: int) -> BilinearMatrixInequality:
    return BilinearMatrixInequality(
        symmetric(rng, size, size),
        symmetric(rng, count, size, size),
        symmetric(rng, count, count, size, size),
    )


def scalar(constant: float, linear: list[float], bilinear: Any) -> BilinearMatrixInequality:
    """constant + linear'x + x' bilinear x >= 0, a 1 by 1 matrix."""
    return BilinearMatrixInequality(
        np.full((1, 1), constant),
        np.reshape(linear, (-1, 1, 1)),
        np.reshape(bilinear, (len(linear), len(linear), 1, 1)),
    )


def product_at_least_one(largest: float) -> BilinearSolution:
    """min x + y with xy >= 1 and 0 <= x, y <= largest."""
    inequality = scalar(-1.0, [0.0, 0.0], [[0.0, 1.0], [0.0, 0.0]])
    return minimise([1.0, 1.0], [inequality], [0.0, 0.0], [largest, largest])


class EigenvalueProblem:
    """min over a box of the largest eigenvalue of F00 + x F10 + y F01 + xy F11."""

    def __init__(self, matrices: Array, lower: list[float], upper: list[float]) -> None:
        self.matrices, self.lower, self.upper = matrices, np.array(lower), np.array(upper)

    def value(self, x: Array, y: Array) -> Array:
        x, y = np.asarray(x)[..., None, None], np.asarray(y)[..., None, None]
        first, by_x, by_y, by_both = self.matrices
        return np.linalg.eigvalsh(first + x * by_x + y * by_y + x * y * by_both)[..., -1]

    def below(self, level: float | None = None) -> BilinearMatrixInequality:
        """The value is at most `level`, or without one a third variable."""
        count, size = (3 if level is None else 2), len(self.matrices[0])
        linear, bilinear = np.zeros((3, size, size)), np.zeros((count, count, size, size))
        linear[:2], linear[2] = -self.matrices[1:3], np.eye(size)
        bilinear[0, 1] = -self.matrices[3]
        constant = (level or 0.0) * np.eye(size) - self.matrices[0]
        return BilinearMatrixInequality(constant, linear[:count], bilinear)

    def solve(self) -> BilinearSolution:
        reach = np.abs([self.lower, self.upper]).max(axis=0)
        norms = np.linalg.norm(self.matrices, ord=2, axis=(1, 2))
        most = float(norms @ [1.0, *reach, reach.prod()])
        box = [*self.lower, -most], [*self.upper, most]
        return minimise([0.0, 0.0, 1.0], [self.below()], *box)

    def brute_force(self) -> float:
        """The least value on a grid over the box, refined about its best point."""
        lower, upper, count = self.lower, self.upper, 201
        for _ in range(16):
            axes = np.linspace(lower, upper, count)
            values = self.value(axes[:, None, 0], axes[None, :, 1])
            row, column = np.unravel_index(values.argmin(), values.shape)
            best = np.array([axes[row, 0], axes[column, 1]])
            # wide, since the valleys are narrow, bent and not smooth
            width = (upper - lower) / 5
            lower = np.maximum(self.lower, best - width)
            upper = np.minimum(self.upper, best + width)
            count = 41
        return float(values.min())


def random_eigenvalue_problem(seed: int) -> EigenvalueProblem:
    rng = seeded(seed)
    matrices = symmetric(rng, 4, 2 + seed % 4, 2 + seed % 4)
    matrices[3] *= (1.0, 3.0)[seed % 2]
    return EigenvalueProblem(matrices, [-1.0, -1.0], [1.0, 1.0])


@given(SEEDS, st.integers(1, 4), st.integers(1, 4))
@settings(max_examples=50)
def test_lift_agrees_where_it_has_rank_one(seed: int, count: int, size: int) -> None:
    rng = seeded(seed)
    inequality = random_inequality(rng, count, size)
    points = rng.standard_normal((2, 3, count))
    x = points[1, 2]
    expected = inequality.constant.copy()
    for i in range(count):
        expected += x[i] * inequality.linear[i]
        for j in range(count):
            expected += x[i] * x[j] * inequality.bilinear[i, j]
    np.testing.assert_allclose(inequality(x), expected, atol=1e-12)
    np.testing.assert_allclose(inequality.lifted(x, np.outer(x, x)), expected, atol=1e-12)
    np.testing.assert_allclose(inequality(points)[1, 2], expected, atol=1e-12)
    # and the lift is linear, which the inequality is not
    other, square = rng.standard_normal(count), symmetric(rng, count, count)
    mixed = inequality.lifted(0.5 * x + 0.5 * other, 0.5 * np.outer(x, x) + 0.5 * square)
    halves = 0.5 * inequality(x) + 0.5 * inequality.lifted(other, square)
    np.testing.assert_allclose(mixed, halves, atol=1e-12)


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"constant": np.eye(3)}, r"constant must have shape \(2, 2\), not \(3, 3\)"),
        ({"linear": np.eye(2)}, r"linear must have shape \(N, m, m\)"),
        ({"linear": np.zeros((0, 2, 2))}, r"none of them 0, not \(0, 2, 2\)"),
        ({"linear": np.zeros((3, 2, 1))}, r"linear must have shape \(3, 2, 2\)"),
        ({"bilinear": np.zeros((3, 2, 2))}, r"bilinear must have shape \(3, 3, 2, 2\)"),
        ({"constant": np.full((2, 2), np.nan)}, "constant must be finite"),
        ({"constant": np.array([[0.0, 1.0], [2.0, 0.0]])}, "matrix of constant must be symmetric"),
        (
            {"bilinear": np.tile([[0.0, 1.0], [1.1, 0.0]], (3, 3, 1, 1))},
            "every matrix of bilinear must be symmetric",
        ),
    ],
)
def test_malformed_inequality_is_refused(changes: dict[str, Array], why: str) -> None:
    matrices: dict[str, Array] = {
        "constant": np.eye(2),
        "linear": np.zeros((3, 2, 2)),
        "bilinear": np.zeros((3, 3, 2, 2)),
    }
    with pytest.raises(ProblemError, match=why):
        BilinearMatrixInequality(**(matrices | changes))


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"cost": 1.0}, r"cost must have shape \(N,\), not \(\)"),
        ({"cost": []}, r"cost must have shape \(N,\), not \(0,\)"),
        ({"cost": [1.0, np.nan]}, "cost must be finite"),
        ({"cost": [1.0, 1.0, 1.0], "lower": [0.0] * 3, "upper": [1.0] * 3}, "inequality 0 has 2"),
        ({"lower": [0.0]}, r"lower must have shape \(2,\)"),
        ({"upper": [1.0, np.inf]}, "upper must be finite"),
        ({"lower": [0.0, 2.0]}, "lower exceeds upper at index 1"),
    ],
)
def test_malformed_problem_is_refused(changes: dict[str, Any], why: str) -> None:
    inequality = scalar(1.0, [0.0, 0.0], np.eye(2))
    arguments = {"cost": [1.0, 1.0], "lower": [0.0, 0.0], "upper": [1.0, 1.0]}
    with pytest.raises(ProblemError, match=why):
        minimise(inequalities=[inequality], **(arguments | changes))


@pytest.mark.parametrize("largest", [1.0, 2.0, 5.0, 10.0])
def test_hyperbola_has_the_optimum_and_the_bound_of_closed_form(largest: float) -> None:
    solution = product_at_least_one(largest)
    assert solution.status == "solved"
    np.testing.assert_allclose(solution.x, [1.0, 1.0], atol=1e-4)
    assert solution.objective == pytest.approx(2.0, abs=1e-6)
    # X_12 >= 1 with McCormick's X_12 <= largest x_1 and X_12 <= largest x_2
    assert solution.bound == pytest.approx(2.0 / largest, abs=1e-6)
    assert solution.bound <= 2.0 / largest


@pytest.mark.parametrize("largest", [0.5, 0.9, 0.9999])
def test_hyperbola_beyond_the_box_is_proven_infeasible(largest: float) -> None:
    solution = product_at_least_one(largest)
    assert solution.status == "infeasible"
    assert solution.bound == np.inf
    assert solution.message == ""
    assert np.all(np.isnan(solution.x))


def test_published_example_has_its_optimum() -> None:
    """The problem of TOMLAB's quick guide to PENBMI; it has other local minima, near (0.44, 4)."""
    matrices = np.array(
        [
            [[-10.0, -0.5, -2.0], [-0.5, 4.5, 0.0], [-2.0, 0.0, 0.0]],
            [[9.0, 0.5, 0.0], [0.5, 0.0, -3.0], [0.0, -3.0, -1.0]],
            [[-1.8, -0.1, -0.4], [-0.1, 1.2, -1.0], [-0.4, -1.0, 0.0]],
            [[0.0, 0.0, 2.0], [0.0, -5.5, 3.0], [2.0, 3.0, 0.0]],
        ]
    )
    problem = EigenvalueProblem(matrices, [-5.0, -3.0], [2.0, 7.0])
    solution = problem.solve()
    assert solution.status == "solved"
    assert solution.objective == pytest.approx(problem.brute_force(), abs=1e-6)
    np.testing.assert_allclose(solution.x, [1.0488, 1.4178, -0.9565], atol=1e-4)
    assert -1.01 < solution.bound < -0.9565


def test_random_eigenvalue_problems_against_brute_force() -> None:
    """Every bound is below and every answer on or above the optimum, nearly all on it."""
    count, optimal = 60, 0
    for seed in range(count):
        problem = random_eigenvalue_problem(seed)
        solution, best = problem.solve(), problem.brute_force()
        assert solution.status == "solved"
        assert solution.violation <= 1e-6
        assert solution.objective == pytest.approx(problem.value(*solution.x[:2]), abs=1e-5)
        assert solution.bound <= best
        assert solution.objective >= best - 1e-6
        optimal += solution.objective <= best + 1e-5 * (1.0 + abs(best))
    # 0.98 of 200; 0.63 if the sequence stopped as soon as M has rank one
    assert optimal >= 0.9 * count


@pytest.mark.parametrize("seed", range(8))
def test_levels_below_the_bound_are_infeasible_and_above_the_answer_solved(seed: int) -> None:
    problem = random_eigenvalue_problem(seed)
    solution = problem.solve()
    box = problem.lower, problem.upper
    unreachable = minimise([0.0, 0.0], [problem.below(solution.bound - 1e-3)], *box)
    assert unreachable.status == "infeasible"
    reachable = minimise([0.0, 0.0], [problem.below(solution.objective + 1e-3)], *box)
    assert reachable.status != "infeasible"
    if reachable.status == "solved":
        assert problem.value(*reachable.x) <= solution.objective + 2e-3


@given(SEEDS, st.integers(1, 3), st.integers(1, 3), st.sampled_from([0.0, 1.0]))
@settings(max_examples=25)
def test_nothing_feasible_is_ever_excluded(seed: int, count: int, size: int, room: float) -> None:
    """Neither by a bound nor by a proof, even where a known point is only just feasible."""
    rng = seeded(seed)
    lower = rng.uniform(-5.0, 0.0, count)
    upper = lower + rng.uniform(0.0, 10.0, count)
    known = rng.uniform(lower, upper)
    inequalities = []
    for _ in range(2):
        random = random_inequality(rng, count, size)
        constant = random.constant - random(known) + room * np.diag(rng.uniform(0.0, 1.0, size))
        inequalities.append(BilinearMatrixInequality(constant, random.linear, random.bilinear))
    cost = rng.standard_normal(count)
    solution = minimise(cost, inequalities, lower, upper)
    assert solution.status != "infeasible"
    # the known point itself satisfies the inequalities within rounding only
    assert solution.bound <= cost @ known + 1e-9
    if solution.status == "solved":
        assert np.all((lower <= solution.x) & (solution.x <= upper))
        least = min(np.linalg.eigvalsh(inequality(solution.x))[0] for inequality in inequalities)
        assert solution.violation == max(0.0, -least)
        assert solution.objective == cost @ solution.x
        assert solution.eigenvalue_ratio <= RANK_ONE


@pytest.mark.parametrize("seed", range(5))
def test_linear_inequality_has_the_optimum_of_its_semidefinite_program(seed: int) -> None:
    rng = seeded(seed)
    linear, cost = symmetric(rng, 3, 4, 4), rng.standard_normal(3)
    inequality = BilinearMatrixInequality(np.eye(4), linear, np.zeros((3, 3, 4, 4)))
    solution = minimise(cost, [inequality], -2.0 * np.ones(3), 2.0 * np.ones(3))
    x = cvxpy.Variable(3)
    matrix = np.eye(4) + sum(x[i] * linear[i] for i in range(3))
    program = cvxpy.Problem(cvxpy.Minimize(cost @ x), [matrix >> 0, cvxpy.abs(x) <= 2.0])
    optimum = program.solve(solver="CLARABEL")
    assert solution.status == "solved"
    assert solution.objective == pytest.approx(optimum, abs=1e-5)
    assert solution.bound == pytest.approx(optimum, abs=1e-5)
    np.testing.assert_allclose(solution.x, x.value, atol=1e-3)


@pytest.mark.parametrize("seed", range(5))
def test_matrix_of_rank_one_is_that_of_the_point(seed: int) -> None:
    solution = random_eigenvalue_problem(seed).solve()
    assert solution.eigenvalue_ratio <= 1e-7
    point = np.append(solution.x, 1.0)
    expected = np.outer(point, point)
    # the ratio is that of variables over their bounds, and those of the eigenvalue are wide: its
    # square was seen 1.2e-6 off
    np.testing.assert_allclose(solution.M, expected, atol=1e-5 * expected.max())


@pytest.mark.parametrize("seed", range(5))
def test_units_do_not_matter(seed: int) -> None:
    rng = seeded(seed)
    inequality = random_inequality(rng, 3, 3)
    inequality = BilinearMatrixInequality(
        inequality.constant + 5.0 * np.eye(3), inequality.linear, inequality.bilinear
    )
    cost, lower, upper = rng.standard_normal(3), -rng.uniform(1, 2, 3), rng.uniform(1, 2, 3)
    # powers of two, so that even the rounding is the same
    units = np.array([2.0**-10, 1.0, 2.0**13])
    force = 2.0**30
    scaled = BilinearMatrixInequality(
        force * inequality.constant,
        force * inequality.linear / units[:, None, None],
        force * inequality.bilinear / np.outer(units, units)[..., None, None],
    )
    one = minimise(cost, [inequality], lower, upper)
    two = minimise(cost / units, [scaled], units * lower, units * upper)
    assert one.status == two.status == "solved"
    outer = np.outer(np.append(units, 1.0), np.append(units, 1.0))
    np.testing.assert_array_equal(two.x / units, one.x)
    np.testing.assert_array_equal(two.M / outer, one.M)
    assert two.violation == force * one.violation
    for name in ("objective", "bound", "eigenvalue_ratio", "steps"):
        assert getattr(two, name) == getattr(one, name)


def test_symmetry_is_no_trap() -> None:
    """min y with y >= -0.02 x^2: the relaxation leaves x at 0, which is the worst point."""
    inequality = scalar(0.0, [0.0, 1.0], [[0.02, 0.0], [0.0, 0.0]])
    solution = minimise([0.0, 1.0], [inequality], [-1.0, -5.0], [1.0, 5.0])
    assert solution.status == "solved"
    # of the two ends, the same on every machine
    assert solution.x[0] == pytest.approx(1.0, abs=1e-3)
    assert solution.objective == pytest.approx(-0.02, abs=1e-4)


def test_any_feasible_point_will_do_without_a_cost() -> None:
    """x^2 + y^2 = 1, one variable of three being fixed: no interior, nowhere convex."""
    squares = np.diag([1.0, 1.0, 0.0])
    circle = [scalar(-1.0, [0.0] * 3, squares), scalar(1.0, [0.0] * 3, -squares)]
    solution = minimise([0.0, 0.0, 0.0], circle, [-2.0, -2.0, 0.7], [2.0, 2.0, 0.7])
    assert solution.status == "solved"
    assert np.hypot(*solution.x[:2]) == pytest.approx(1.0, abs=1e-5)
    assert solution.x[2] == 0.7
    assert solution.objective == 0.0
    assert solution.bound == pytest.approx(0.0, abs=1e-6)


def test_box_alone_has_its_corner() -> None:
    void = scalar(0.0, [0.0, 0.0], np.zeros((2, 2)))
    solution = minimise([1.0, -2.0], [void], [-1.0, 2.0], [3.0, 4.0])
    without = minimise([1.0, -2.0], [], [-1.0, 2.0], [3.0, 4.0])
    np.testing.assert_allclose(without.x, solution.x, atol=1e-6)
    assert solution.status == "solved"
    np.testing.assert_allclose(solution.x, [-1.0, 4.0], atol=1e-6)
    assert solution.bound == pytest.approx(-9.0, abs=1e-6)
    assert solution.violation == 0.0


def test_infeasibility_that_the_relaxation_does_not_see_is_no_proof() -> None:
    """x^2 >= 0.9 and 0.4 <= x <= 0.6 while |x| <= 1: of x and X, both hold."""
    strip = BilinearMatrixInequality(
        np.diag([-0.4, 0.6]), np.diag([1.0, -1.0])[None], np.zeros((1, 1, 2, 2))
    )
    solution = minimise([0.0], [scalar(-0.9, [0.0], [[1.0]]), strip], [-1.0], [1.0])
    assert solution.status == "failed"
    assert solution.message.startswith("eigenvalue ratio")
    assert solution.violation == pytest.approx(0.9 - solution.x[0] ** 2, abs=1e-6)
    assert solution.bound == pytest.approx(0.0, abs=1e-6)


def test_infeasibility_without_multipliers_is_no_proof(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        cvxpy.constraints.constraint.Constraint, "dual_value", property(lambda _: None)
    )
    solution = product_at_least_one(0.5)
    assert solution.status == "failed"
    assert solution.message == "clarabel ended with infeasible"
    assert solution.bound == -np.inf
    assert product_at_least_one(2.0).bound == -np.inf


@pytest.mark.parametrize("wrong", ["random", "negative"])
def test_bound_holds_whatever_the_multipliers(wrong: str, monkeypatch: pytest.MonkeyPatch) -> None:
    rng, kind = seeded(0), cvxpy.constraints.constraint.Constraint
    exact = kind.dual_value.fget
    sizes = np.repeat([1e-9, 1e-6, 1e-3, 1.0], 5)
    bounds = []
    for size in sizes:

        def spoilt(self: Any, size: float = size) -> Array:
            dual = np.array(exact(self), dtype=np.float64)
            if wrong == "random":
                return dual + size * rng.standard_normal(dual.shape)
            # as if the last entry had to be below zero, which makes the constant larger
            dual[(-1,) * dual.ndim] -= size
            return dual

        monkeypatch.setattr(kind, "dual_value", property(spoilt))
        # the relaxation's optimum is 0.4
        bounds.append(product_at_least_one(5.0).bound)
    assert np.all(np.array(bounds) <= 0.4)
    # it suffers in proportion, and no more
    assert np.all(np.array(bounds) >= 0.4 - 1e3 * sizes - 1e-6)


@pytest.mark.parametrize("seed", range(10))
def test_relaxation_of_a_product_is_its_convex_hull(seed: int) -> None:
    """min w xy + ax + by over a box is at a corner, and the products of the sides suffice."""
    rng = seeded(seed)
    lower, cost = rng.uniform(-2.0, 0.0, 2), rng.standard_normal(2)
    upper, weight = lower + rng.uniform(0.5, 3.0, 2), rng.choice([-1.0, 1.0])
    product = np.zeros((3, 3))
    product[0, 1] = -weight
    solution = minimise(
        [*cost, 1.0], [scalar(0.0, [0.0, 0.0, 1.0], product)], [*lower, -9.0], [*upper, 9.0]
    )
    corners = [np.array([x, y]) for x in (lower[0], upper[0]) for y in (lower[1], upper[1])]
    best = min(weight * corner.prod() + cost @ corner for corner in corners)
    assert solution.bound == pytest.approx(best, abs=1e-6)
    assert solution.bound <= best
    assert solution.objective == pytest.approx(best, abs=1e-5)


@pytest.mark.parametrize("calls", [0, 1, 3])
def test_program_that_is_given_up_is_no_answer(calls: int, monkeypatch: pytest.MonkeyPatch) -> None:
    solve, count = cvxpy.Problem.solve, iter(range(100))

    def give_up(self: cvxpy.Problem, *args: Any, **settings: Any) -> Any:
        if next(count) == calls:
            raise cvxpy.SolverError("numerical trouble")
        return solve(self, *args, **settings)

    monkeypatch.setattr(cvxpy.Problem, "solve", give_up)
    solution = product_at_least_one(5.0)
    assert solution.status == "failed"
    assert solution.message == "cvxpy: numerical trouble"
    assert solution.steps == max(1, calls)
    if calls:
        # what was bounded before remains so, and the point is judged as it is
        assert solution.bound == pytest.approx(0.4, abs=1e-6)
        assert solution.violation > 0.1
    else:
        assert solution.bound == -np.inf
        assert np.all(np.isnan(solution.M))


def test_both_rank_and_residual_decide(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("solvers.paper.bilinear._MAX_STEPS", 1)
    # the relaxation of a box has its corner, whatever X is there
    by_rank = minimise([0.0, 1.0], [], [-1.0, -1.0], [1.0, 1.0])
    assert by_rank.status == "failed"
    assert by_rank.violation == 0.0
    assert by_rank.eigenvalue_ratio > RANK_ONE
    monkeypatch.setattr("solvers.paper.bilinear.RANK_ONE", 1.0)
    assert minimise([0.0, 1.0], [], [-1.0, -1.0], [1.0, 1.0]).status == "solved"
    by_residual = product_at_least_one(5.0)
    assert by_residual.status == "failed"
    assert by_residual.violation == pytest.approx(1.0 - 0.2**2, abs=1e-4)


def test_statuses_are_those_of_contact_synthesis() -> None:
    assert {status.value for status in BilinearStatus} == {s.value for s in SynthesisStatus}
