import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from solvers import SolverError, solve
from solvers.duality import contact_duals, dual_bound
from solvers.kkt import (
    OBJECTIVE_WEIGHT,
    Cone,
    ConeProgram,
    grasp_multipliers,
    grasp_program,
    kkt_field,
    linear_program,
    project_dual_cone,
)
from solvers.problem import Multipliers, force_scale
from tests.support.problems import feasible_problem, random_batch, random_problem
from tests.support.seeds import SEEDS, seeded

MIXED = Cone(zero=2, nonnegative=3, second_order=(4, 4, 2, 1, 1, 3, 4))
CONES = st.builds(
    Cone,
    zero=st.integers(0, 3),
    nonnegative=st.integers(0, 3),
    second_order=st.lists(st.integers(1, 5), max_size=6).map(tuple),
)


def normal(rng: np.random.Generator, *shape: int) -> torch.Tensor:
    return torch.as_tensor(rng.standard_normal(shape))


def field_as_printed(
    a: np.ndarray, b: np.ndarray, d: np.ndarray, x: np.ndarray, u: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Equation 15 component by component, in plain Python."""
    k, m = a.shape
    positive_part = [
        max(u[i] + sum(a[i, j] * x[j] for j in range(m)) - b[i], 0.0) for i in range(k)
    ]
    dx = [-(d[j] + sum(a[i, j] * positive_part[i] for i in range(k))) for j in range(m)]
    return np.array(dx), np.array([positive_part[i] - u[i] for i in range(k)])


@given(seed=SEEDS)
def test_linear_program_gives_the_field_of_the_paper(seed: int) -> None:
    rng = seeded(seed)
    m, k = rng.integers(1, 6, 2)
    a, b, d = normal(rng, k, m), normal(rng, k), normal(rng, m)
    x, u = normal(rng, m), normal(rng, k)
    dx, du = kkt_field(linear_program(d, a, b), x, u)
    positive_part = torch.relu(u + a @ x - b)
    torch.testing.assert_close(dx, -(d + a.T @ positive_part))
    torch.testing.assert_close(du, positive_part - u)
    printed = field_as_printed(*(part.numpy() for part in (a, b, d, x, u)))
    np.testing.assert_allclose(dx, printed[0], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(du, printed[1], rtol=1e-12, atol=1e-12)
    # a half-line is a second-order cone of one row
    lines = ConeProgram(torch.zeros(m, m, dtype=x.dtype), d, a, b, Cone(second_order=(1,) * int(k)))
    for part, same in zip(kkt_field(lines, x, u), (dx, du), strict=True):
        torch.testing.assert_close(part, same, rtol=0.0, atol=0.0)


@given(cone=CONES, seed=SEEDS)
def test_projection_on_the_dual_cone_satisfies_moreau(cone: Cone, seed: int) -> None:
    rng = seeded(seed)
    point = 3.0 * normal(rng, 5, cone.rows)
    inside = project_dual_cone(cone, point)
    rest = inside - point  # the projection of -point on K itself
    torch.testing.assert_close(project_dual_cone(cone, inside), inside)
    assert torch.all(torch.abs(torch.sum(inside * rest, dim=-1)) < 1e-12)
    torch.testing.assert_close(rest[:, : cone.zero], torch.zeros(5, cone.zero).double())  # K = {0}
    torch.testing.assert_close(project_dual_cone(cone, rest)[:, cone.zero :], rest[:, cone.zero :])


def nearest_in_second_order_cone(point: np.ndarray) -> np.ndarray:
    """By the spectral decomposition of a Jordan algebra: eigenvalues t +- |z|, made positive."""
    top, rest = point[0], point[1:]
    size = float(np.linalg.norm(rest))
    unit = rest / size if size > 0 else np.zeros_like(rest)
    frame = 0.5 * np.array([np.append(1.0, unit), np.append(1.0, -unit)])
    if not len(rest):
        return np.maximum(point, 0.0)
    return max(top + size, 0.0) * frame[0] + max(top - size, 0.0) * frame[1]


@given(cone=CONES, seed=SEEDS)
def test_projection_is_that_of_every_block(cone: Cone, seed: int) -> None:
    rng = seeded(seed)
    point = normal(rng, cone.rows)
    inside = project_dual_cone(cone, point).numpy()
    ends = np.cumsum([cone.zero, cone.nonnegative, *cone.second_order])
    free, positive, *blocks = np.split(point.numpy(), ends[:-1])
    oracle = [free, np.maximum(positive, 0.0), *map(nearest_in_second_order_cone, blocks)]
    np.testing.assert_allclose(inside, np.concatenate(oracle), atol=1e-14)


def test_cones_without_rows_are_refused() -> None:
    for wrong in ({"zero": -1}, {"nonnegative": -2}, {"second_order": (3, 0)}):
        with pytest.raises(SolverError, match="negative number of rows"):
            Cone(**wrong)
    assert Cone().rows == 0
    assert MIXED.rows == 24


def test_projection_has_a_gradient_at_the_apex() -> None:
    point = torch.zeros(MIXED.rows, requires_grad=True)
    project_dual_cone(MIXED, point).sum().backward()
    assert point.grad is not None
    assert torch.all(torch.isfinite(point.grad))


def integrate(program: ConeProgram, time: float) -> tuple[torch.Tensor, torch.Tensor]:
    m = program.linear.shape[-1]

    def field(_: float, y: np.ndarray) -> np.ndarray:
        state = torch.as_tensor(y)
        return torch.cat(kkt_field(program, state[:m], state[m:])).numpy()

    start = np.zeros(m + program.cone.rows)
    end = solve_ivp(field, (0.0, time), start, method="LSODA", rtol=1e-9, atol=1e-11).y[:, -1]
    return torch.as_tensor(end[:m]), torch.as_tensor(end[m:])


def test_flow_of_a_grasp_ends_at_the_optimum() -> None:
    problem = feasible_problem(seeded(3), 4, normal_max=40.0)
    answer = solve(problem, "clarabel")
    program = grasp_program(problem.to_torch())
    x, u = integrate(program, 400.0)
    forces = x.numpy() * force_scale(problem)
    np.testing.assert_allclose(forces, answer.forces, atol=1e-5 * np.linalg.norm(answer.forces))
    assert max(float(part.abs().max()) for part in kkt_field(program, x, u)) < 1e-5


def kkt_point(program: ConeProgram, forces: torch.Tensor) -> torch.Tensor:
    """Multipliers of a single program at its optimum, by non-negative least squares on the rows."""
    from scipy.optimize import lsq_linear

    slack = program.bound - program.matrix @ forces
    cone = program.cone
    head = cone.zero + cone.nonnegative
    # along an active second-order cone the multiplier is a multiple of the reflected slack
    blocks = slack[head:].unflatten(0, (len(cone.second_order), 3))
    reflected = torch.cat([blocks[:, :1], -blocks[:, 1:]], dim=-1)
    columns = torch.zeros(cone.rows, head + len(cone.second_order), dtype=slack.dtype)
    columns[:head, :head] = torch.eye(head, dtype=slack.dtype)
    for index, block in enumerate(reflected):
        rows = slice(head + 3 * index, head + 3 * index + 3)
        columns[rows, head + index] = block
    active = torch.ones(columns.shape[1], dtype=torch.bool)
    active[cone.zero : head] = slack[cone.zero : head] < 1e-6
    gap = blocks[:, 0] - torch.linalg.vector_norm(blocks[:, 1:], dim=-1)
    active[head:] = gap < 1e-6
    lower = np.full(columns.shape[1], 0.0)
    lower[: cone.zero] = -np.inf
    chosen = active.numpy()
    system = (program.matrix.T @ columns[:, active]).numpy()
    pull = -(program.quadratic @ forces + program.linear).numpy()
    weights = lsq_linear(system, pull, bounds=(lower[chosen], np.inf), tol=1e-14).x
    return columns[:, active] @ torch.as_tensor(weights)


@pytest.mark.parametrize("objective", ["min_norm", "sum_normal"])
@pytest.mark.parametrize("seed", range(5))
def test_field_vanishes_at_the_optimum_and_only_there(seed: int, objective: str) -> None:
    rng = seeded(seed)
    problem = random_problem(
        rng, 5, normal_min=0.3, normal_max=30.0, torque_max=np.inf, objective=objective
    )
    answer = solve(problem, "clarabel", tolerance=1e-12)
    assert answer.status == "optimal"
    program = grasp_program(problem.to_torch())
    x = torch.as_tensor(answer.forces / force_scale(problem))
    u = kkt_point(program, x)
    assert max(float(part.abs().max()) for part in kkt_field(program, x, u)) < 1e-5
    off = kkt_field(program, x + 0.1 * normal(rng, len(x)), u)
    assert max(float(part.abs().max()) for part in off) > 1e-3
    # and the multipliers there, in the problem's units, prove that the optimum is one
    proof = numpy_multipliers(grasp_multipliers(problem.to_torch(), u))
    bound = float(dual_bound(problem, proof))
    assert bound == pytest.approx(float(answer.objective), rel=1e-4)
    assert bound <= answer.objective * (1.0 + 1e-9)
    # the bound of a linear objective takes the best share of multipliers that are too large
    factor = 2.0 if objective == "min_norm" else 0.5
    wrong = Multipliers(factor * proof.equilibrium, factor * proof.torque)
    assert dual_bound(problem, wrong) < 0.999 * answer.objective


def numpy_multipliers(multipliers: Multipliers) -> Multipliers:
    return Multipliers(multipliers.equilibrium.numpy(), multipliers.torque.numpy())


@given(seed=SEEDS)
def test_multipliers_of_a_grasp_price_the_lagrangian_of_its_program(seed: int) -> None:
    """A' u over the rows of equilibrium and torques is q = G' nu + J_h lambda, in other units."""
    rng = seeded(seed)
    for objective, power in (("min_norm", 1), ("sum_normal", 0)):
        batch = random_batch(rng, 3, 4, objective=objective, torque_max=1.0)
        problem = batch.to_torch()
        program = grasp_program(problem)
        rows = 6 + 2 * problem.n_joints
        u = normal(rng, 3, program.cone.rows)
        pull = (program.matrix[:, :rows].mT @ u[:, :rows, None])[..., 0] / OBJECTIVE_WEIGHT
        multipliers = grasp_multipliers(problem, u)
        prices = contact_duals(problem, multipliers).flatten(-2)
        scale = force_scale(problem)[:, None] ** power
        torch.testing.assert_close(prices, scale * pull, rtol=1e-9, atol=1e-9)


def test_batch_equals_its_parts() -> None:
    rng = seeded(0)
    problems = random_batch(rng, 6).to_torch()
    program = grasp_program(problems)
    x, u = normal(rng, 6, program.linear.shape[-1]), normal(rng, 6, program.cone.rows)
    dx, du = kkt_field(program, x, u)
    for index in range(6):
        one = kkt_field(grasp_program(problems[index]), x[index], u[index])
        torch.testing.assert_close(dx[index], one[0])
        torch.testing.assert_close(du[index], one[1])


def test_multipliers_of_absent_constraints_decay() -> None:
    problem = random_problem(seeded(1), 4, torque_max=np.inf, normal_max=np.inf)
    program = grasp_program(problem.pad(5).to_torch())
    inert = (program.matrix[6 : 6 + program.cone.nonnegative] == 0).all(dim=-1)
    assert int(inert.sum()) == 8 + 5 + 1  # upper limits, caps, preload of the padding contact
    x = torch.zeros(15, dtype=torch.float64)
    u = torch.full((program.cone.rows,), 0.5, dtype=torch.float64)
    _, du = kkt_field(program, x, u)
    torch.testing.assert_close(du[6 : 6 + len(inert)][inert], torch.full((14,), -0.5).double())


def test_rows_must_agree() -> None:
    with pytest.raises(SolverError, match="3, 3 and 2 rows"):
        ConeProgram(torch.eye(2), torch.ones(2), torch.ones(3, 2), torch.ones(3), Cone(zero=2))
