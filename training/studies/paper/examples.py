"""The paper's two printed linear programs: their optima, its ODE on them, its points and networks.

Basumatary et al., "Grasp Force Optimization as a Bilinear Matrix Inequality Problem", section 5.
"""

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import linprog

from solvers.arrays import Array
from solvers.kkt import ConeProgram, linear_program
from solvers.paper.instance_network import InstanceFit, fit
from solvers.paper.kkt_ode import Trajectory, integrate, integrate_with_scipy

HORIZON = 10.0
"""The paper's T."""

REST = 40.0
"""Time by which the ODE rests on the benchmark: its slowest part decays as e^-t."""

WALL_SPAN = 60.0
"""Time over which the second example is traced: the ODE meets the constraint before 38."""

_UNBOUNDED = 3
"""`scipy.optimize.linprog`'s status of such a program."""


@dataclass(frozen=True)
class PrintedProgram:
    """min cost' x subject to row x <= bound, with free x, as printed.

    Args:
        cost: (m,) exact decimals.
        row: (m,) of the only constraint, row x <= bound.
        bound: its right side.
        point: (m,) the paper's answer.
    """

    cost: tuple[Fraction, ...]
    row: tuple[Fraction, ...]
    bound: Fraction
    point: tuple[Fraction, ...]

    @property
    def program(self) -> ConeProgram:
        """The same as a cone program with one inequality; float64."""
        return linear_program(_tensor(self.cost), _tensor(self.row)[None], _tensor((self.bound,)))

    def objective(self, point: tuple[Fraction, ...]) -> Fraction:
        """cost' x, exactly."""
        return _dot(self.cost, point)

    def slack(self, point: tuple[Fraction, ...]) -> Fraction:
        """bound - row x, exactly: negative where the constraint is violated."""
        return self.bound - _dot(self.row, point)


def _decimals(text: str) -> tuple[Fraction, ...]:
    return tuple(Fraction(number) for number in text.split())


BENCHMARK = PrintedProgram(
    cost=_decimals("-9.54 -8.16 -4.26 -11.43"),
    row=_decimals("3.18 2.72 1.42 3.81"),
    bound=Fraction("7.81"),
    point=_decimals("0.999 0.579 -0.228 0.886"),
)
"""Equation 39."""

GRASP = PrintedProgram(
    cost=_decimals("1 1 1 1 1 1 1 1 1"),
    row=_decimals("-1.7744 -1.8984 -1.5 -2.1994 -1.858 -1.5 -1.8642 -1.7924 -1.5"),
    bound=Fraction(600),
    point=_decimals("36.601 -40.756 -38.333 -37.788 -35.586 -35.823 -39.289 -40.043 -34.805"),
)
"""Equation 40, whose constraint is printed as a'x + 600 >= 0; x_ij is component j of finger i."""


@dataclass(frozen=True, eq=False)
class BenchmarkSolutions:
    """What became of the benchmark.

    Args:
        optimum: HiGHS's.
        proportional: whether cost = -3 row exactly, so that every point of the constraint's edge is
            optimal, and the optimum is -3 times the bound.
        face: (4, 2) least and largest value of each component among the optimal points, by HiGHS.
        ode_objective: where the ODE rests, by torchdiffeq.
        scipy_objective: the same by `solve_ivp`.
        ode_end: (4,) the point of rest.
        printed_objective: of the printed point, exactly.
        printed_slack: bound - row x there; positive inside.
        printed_distance: from the printed point to the ODE's point of rest.
        horizon_distance: from the printed point to the ODE at t = 10.
        edge_distance: from the printed point to the optimal face.
        at_horizon: the exact ODE's objective at t = 10.
        network_objective: of the network at t = 10, for each seed.
        fits: the networks, for each seed.
    """

    optimum: float
    proportional: bool
    face: Array
    ode_objective: float
    scipy_objective: float
    ode_end: Array
    printed_objective: float
    printed_slack: float
    printed_distance: float
    horizon_distance: float
    edge_distance: float
    at_horizon: float
    network_objective: Array
    fits: tuple[InstanceFit, ...]


@dataclass(frozen=True, eq=False)
class GraspSolutions:
    """What became of the "grasp" program, which is unbounded.

    Args:
        highs_status: HiGHS's verdict, in its words.
        ray: (9,) exact direction along which the objective falls for ever.
        ray_cost: cost' ray, below zero.
        ray_slope: row ray, zero: the ray runs along the edge.
        printed_slack: bound - row x at the printed point.
        flipped_slack: the same with the sign of x_11 changed.
        wall_time: when the ODE from zero meets the constraint.
        drift: change of the objective per unit of time after that, as the traced path has it.
        exact_drift: -(|c|^2 - (c'a)^2 / |a|^2), what it tends to.
        nearest_time: of the path to the printed point with x_11 flipped.
        nearest_distance: their distance.
        at_horizon: (9,) the ODE at t = 10.
        network_end: (9,) the network at t = 10.
        friction_needed: (3,) least mu of each finger if x_i3 were its normal force, with the sign
            that pushes.
        pushing: (3,) how many of each finger's printed components are positive. A finger with none
            pulls, whichever of them is the normal force: no friction coefficient allows that.
        path: traced, from zero to `WALL_SPAN`.
        path_slack: (T,) bound - row x along it.
        fit: the network.
    """

    highs_status: str
    ray: tuple[Fraction, ...]
    ray_cost: Fraction
    ray_slope: Fraction
    printed_slack: float
    flipped_slack: float
    wall_time: float
    drift: float
    exact_drift: float
    nearest_time: float
    nearest_distance: float
    at_horizon: Array
    network_end: Array
    friction_needed: Array
    pushing: NDArray[np.int_]
    path: Trajectory
    path_slack: Array
    fit: InstanceFit


def solve_benchmark(seeds: tuple[int, ...] = (0, 1, 2)) -> BenchmarkSolutions:
    """The benchmark by HiGHS, by the ODE with two integrators, and by networks of several seeds."""
    cost, row = _array(BENCHMARK.cost), _array(BENCHMARK.row)
    answer = linprog(cost, A_ub=row[None], b_ub=[float(BENCHMARK.bound)], bounds=(None, None))
    program = BENCHMARK.program
    times = torch.tensor([0.0, HORIZON, REST], dtype=torch.float64)
    ode, scipy = integrate(program, times), integrate_with_scipy(program, times)
    end = ode.x[-1].numpy()
    printed = _array(BENCHMARK.point)
    slack = float(BENCHMARK.slack(BENCHMARK.point))
    fits = tuple(fit(program, seed=seed) for seed in seeds)
    return BenchmarkSolutions(
        optimum=float(answer.fun),
        proportional=all(c == -3 * a for c, a in zip(BENCHMARK.cost, BENCHMARK.row, strict=True)),
        face=_ranges_of_face(row, float(BENCHMARK.bound)),
        ode_objective=float(cost @ end),
        scipy_objective=float(cost @ scipy.x[-1].numpy()),
        ode_end=end,
        printed_objective=float(BENCHMARK.objective(BENCHMARK.point)),
        printed_slack=slack,
        printed_distance=float(np.linalg.norm(printed - end)),
        horizon_distance=float(np.linalg.norm(printed - ode.x[1].numpy())),
        edge_distance=slack / float(np.linalg.norm(row)),
        at_horizon=float(cost @ ode.x[1].numpy()),
        network_objective=np.array([cost @ one.x.numpy() for one in fits]),
        fits=fits,
    )


def solve_grasp_program(seed: int = 0) -> GraspSolutions:
    """The "grasp" program: a ray that proves it unbounded, the ODE's path, the printed point."""
    cost, row = _array(GRASP.cost), _array(GRASP.row)
    answer = linprog(cost, A_ub=row[None], b_ub=[float(GRASP.bound)], bounds=(None, None))
    ray = unbounded_ray(GRASP)
    flipped = (-GRASP.point[0], *GRASP.point[1:])
    times = torch.linspace(0.0, WALL_SPAN, 2401, dtype=torch.float64)
    path = integrate(GRASP.program, times)
    x, moments = path.x.numpy(), times.numpy()
    slack = float(GRASP.bound) - x @ row
    distance = np.linalg.norm(x - _array(flipped), axis=1)
    nearest = int(np.argmin(distance))
    late = moments >= WALL_SPAN - 10.0
    printed = _array(GRASP.point).reshape(3, 3)
    network = fit(GRASP.program, seed=seed)
    return GraspSolutions(
        highs_status=str(answer.message),
        ray=ray,
        ray_cost=GRASP.objective(ray),
        ray_slope=_dot(GRASP.row, ray),
        printed_slack=float(GRASP.slack(GRASP.point)),
        flipped_slack=float(GRASP.slack(flipped)),
        wall_time=float(GRASP.bound / -sum(GRASP.row)),
        drift=float(np.polyfit(moments[late], (x @ cost)[late], 1)[0]),
        exact_drift=-float(cost @ cost - (cost @ row) ** 2 / (row @ row)),
        nearest_time=float(moments[nearest]),
        nearest_distance=float(distance[nearest]),
        at_horizon=x[np.searchsorted(moments, HORIZON)],
        network_end=network.x.numpy(),
        friction_needed=np.hypot(printed[:, 0], printed[:, 1]) / np.abs(printed[:, 2]),
        pushing=np.sum(printed > 0.0, axis=1),
        path=path,
        path_slack=slack,
        fit=network,
    )


def _ranges_of_face(row: Array, bound: float) -> Array:
    """(m, 2) least and largest value of each component where row x = bound."""

    def least(objective: Array) -> float:
        answer = linprog(objective, A_eq=row[None], b_eq=[bound], bounds=(None, None))
        return -np.inf if answer.status == _UNBOUNDED else float(answer.fun)

    return np.array([[least(component), -least(-component)] for component in np.eye(len(row))])


def unbounded_ray(program: PrintedProgram) -> tuple[Fraction, ...]:
    """A direction d with row d = 0 and cost' d < 0, exactly: the program has no optimum.

    It trades the component that costs most per unit of the constraint for the one that costs least.

    Raises:
        ValueError: if cost is a multiple of the row: then there is none along the edge.
    """
    rates = [c / a for c, a in zip(program.cost, program.row, strict=True)]
    most, least = rates.index(max(rates)), rates.index(min(rates))
    if rates[most] == rates[least]:
        raise ValueError("cost is a multiple of the row: the objective is constant along the edge")
    ray = [Fraction(0)] * len(rates)
    ray[most], ray[least] = program.row[least], -program.row[most]
    if _dot(program.cost, tuple(ray)) > 0:
        ray = [-component for component in ray]
    return tuple(ray)


def _dot(first: tuple[Fraction, ...], second: tuple[Fraction, ...]) -> Fraction:
    return sum((a * b for a, b in zip(first, second, strict=True)), Fraction(0))


def _array(numbers: tuple[Fraction, ...]) -> Array:
    return np.array([float(number) for number in numbers])


def _tensor(numbers: tuple[Fraction, ...]) -> torch.Tensor:
    return torch.tensor([float(number) for number in numbers], dtype=torch.float64)
