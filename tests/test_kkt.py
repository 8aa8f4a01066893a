import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from solvers import SolverError, solve
from solvers.kkt import Cone, ConeProgram, grasp_program, kkt_field, project_dual_cone
from solvers.scaling import force_scale
from tests.problems import random_batch, random_problem

MIXED = Cone(zero=2, nonnegative=3, second_order=2, second_order_size=4)
SEEDS = st.integers(0, 2**32 - 1)


def normal(rng: np.random.Generator, *shape: int) -> torch.Tensor:
    return torch.as_tensor(rng.standard_normal(shape))


@given(seed=SEEDS)
def test_linear_program_gives_the_field_of_the_paper(seed: int) -> None:
    rng = np.random.default_rng(seed)
    m, k = rng.integers(1, 6, 2)
    a, b, d = normal(rng, k, m), normal(rng, k), normal(rng, m)
    x, u = normal(rng, m), normal(rng, k)
    program = ConeProgram(torch.zeros(m, m, dtype=x.dtype), d, a, b, Cone(nonnegative=int(k)))
    dx, du = kkt_field(program, x, u)
    positive_part = torch.relu(u + a @ x - b)
    torch.testing.assert_close(dx, -(d + a.T @ positive_part))
    torch.testing.assert_close(du, positive_part - u)


@given(seed=SEEDS)
def test_projection_on_the_dual_cone_satisfies_moreau(seed: int) -> None:
    rng = np.random.default_rng(seed)
    point = 3.0 * normal(rng, 5, MIXED.rows)
    inside = project_dual_cone(MIXED, point)
    rest = inside - point  # the projection of -point on K itself
    torch.testing.assert_close(project_dual_cone(MIXED, inside), inside)
    assert torch.all(torch.abs(torch.sum(inside * rest, dim=-1)) < 1e-12)
    torch.testing.assert_close(rest[:, :2], torch.zeros_like(rest[:, :2]))  # K is {0} there
    torch.testing.assert_close(project_dual_cone(MIXED, rest)[:, 2:], rest[:, 2:])


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
    problem = random_problem(np.random.default_rng(3), 4, normal_max=40.0)
    answer = solve(problem, "clarabel")
    assert answer.status == "optimal"
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
    blocks = slack[head:].unflatten(0, (cone.second_order, cone.second_order_size))
    reflected = torch.cat([blocks[:, :1], -blocks[:, 1:]], dim=-1)
    columns = torch.zeros(cone.rows, head + cone.second_order, dtype=slack.dtype)
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


@pytest.mark.parametrize("seed", range(5))
def test_field_vanishes_at_the_optimum_and_only_there(seed: int) -> None:
    rng = np.random.default_rng(seed)
    problem = random_problem(rng, 5, normal_min=0.3, normal_max=30.0, torque_max=np.inf)
    answer = solve(problem, "clarabel")
    assert answer.status == "optimal"
    program = grasp_program(problem.to_torch())
    x = torch.as_tensor(answer.forces / force_scale(problem))
    u = kkt_point(program, x)
    assert max(float(part.abs().max()) for part in kkt_field(program, x, u)) < 1e-5
    off = kkt_field(program, x + 0.1 * normal(rng, len(x)), u)
    assert max(float(part.abs().max()) for part in off) > 1e-3


def test_batch_equals_its_parts() -> None:
    rng = np.random.default_rng(0)
    problems = random_batch(rng, 6).to_torch()
    program = grasp_program(problems)
    x, u = normal(rng, 6, program.linear.shape[-1]), normal(rng, 6, program.cone.rows)
    dx, du = kkt_field(program, x, u)
    for index in range(6):
        one = kkt_field(grasp_program(problems[index]), x[index], u[index])
        torch.testing.assert_close(dx[index], one[0])
        torch.testing.assert_close(du[index], one[1])


def test_multipliers_of_absent_constraints_decay() -> None:
    problem = random_problem(np.random.default_rng(1), 4, torque_max=np.inf, normal_max=np.inf)
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
