"""The KKT ODE integrated: trajectories of any cone program, and grasp forces as their limit."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from torch import Tensor
from torchdiffeq import odeint

from solvers.arguments import real_number
from solvers.base import Solver
from solvers.duality import farkas_value, recession_direction
from solvers.exceptions import SolverError
from solvers.judge import FARKAS_TOLERANCE
from solvers.kkt import (
    ConeProgram,
    canonical_multipliers,
    grasp_multipliers,
    grasp_program,
    kkt_field,
)
from solvers.problem import GraspForceProblem, Multipliers, canonical, force_scale
from solvers.solution import Candidate

_FIRST_SPAN = 25.0
"""Time before the first look at which problems are finished; every further span is as long as all
before it together."""

_STEP_TOLERANCE = 1e-3
"""Error of a step in the first span: the way to the end need not be exact."""

_REFINEMENT = 0.1
"""Of that error from span to span: at the edge of stability the state trembles by a share of it."""

_GROWTH = 2.0
"""Of the steps, at most: a step far beyond the stability of Runge and Kutta amplifies rounding
before anyone sees it."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A path of the KKT ODE.

    Args:
        times: (T,) float64, increasing.
        x: (T, ..., m) primal variables.
        u: (T, ..., k) multipliers.
    """

    times: Tensor
    x: Tensor
    u: Tensor


def integrate(
    program: ConeProgram,
    times: Tensor,
    *,
    start: tuple[Tensor, Tensor] | None = None,
    tolerance: float = 1e-8,
    method: str = "dopri5",
) -> Trajectory:
    """The path of one program, or of a batch as one ODE, by torchdiffeq.

    The batch shares its steps, which are those of its hardest member. The field is Lipschitz but
    not smooth: a step across a kink is rejected and made smaller.

    Args:
        program: any cone program(s).
        times: (T,) increasing; the first is that of the start.
        start: x (..., m) and u (..., k); the origin by default, as in the paper.
        tolerance: error of a step that is accepted, relative to the state; a thousandth of it
            absolute.
        method: an adaptive explicit method of torchdiffeq.
    """
    m = program.linear.shape[-1]
    x, u = start or (torch.zeros_like(program.linear), torch.zeros_like(program.bound))

    def field(_: Tensor, state: Tensor) -> Tensor:
        return torch.cat(kkt_field(program, state[..., :m], state[..., m:]), dim=-1)

    def worst(state: Tensor) -> Tensor:
        return state.square().mean(dim=-1).sqrt().max()

    path = odeint(
        field,
        torch.cat([x, u], dim=-1),
        times,
        rtol=tolerance,
        atol=1e-3 * tolerance,
        method=method,
        options={"norm": worst, "ifactor": _GROWTH},
    )
    return Trajectory(times, path[..., :m], path[..., m:])


def integrate_with_scipy(
    program: ConeProgram,
    times: Tensor,
    *,
    start: tuple[Tensor, Tensor] | None = None,
    tolerance: float = 1e-10,
    method: str = "LSODA",
) -> Trajectory:
    """The path of one program by `scipy.integrate.solve_ivp`: independent of torchdiffeq.

    Args:
        program: one cone program, float64 on the CPU.
        times: (T,) increasing; the first is that of the start.
        start: x (m,) and u (k,); the origin by default.
        tolerance: relative to the state; a hundredth of it absolute.
        method: of `solve_ivp`; LSODA and Radau know stiffness.

    Raises:
        SolverError: for a batch, or if the integration fails.
    """
    if program.linear.ndim != 1:
        raise SolverError("scipy integrates one program at a time; index the batch first")
    m = len(program.linear)
    x, u = start or (torch.zeros_like(program.linear), torch.zeros_like(program.bound))

    def field(_: float, state: NDArray[np.float64]) -> NDArray[np.float64]:
        point = torch.from_numpy(state)
        return torch.cat(kkt_field(program, point[:m], point[m:])).numpy()

    moments = times.numpy()
    with torch.no_grad():
        path = solve_ivp(
            field,
            (moments[0], moments[-1]),
            torch.cat([x, u]).numpy(),
            method=method,
            t_eval=moments,
            rtol=tolerance,
            atol=1e-2 * tolerance,
        )
    if not path.success:
        raise SolverError(f"{method} stopped at t = {path.t[-1]:g}: {path.message}")
    states = torch.from_numpy(path.y.T.copy())
    return Trajectory(times, states[:, :m], states[:, m:])


def residual(program: ConeProgram, x: Tensor, u: Tensor) -> Tensor:
    """(...,) size of the field at x (..., m) and u (..., k): zero at KKT points only."""
    return torch.linalg.vector_norm(torch.cat(kkt_field(program, x, u), dim=-1), dim=-1)


class KktOdeSolver(Solver):
    """Follows the KKT ODE from the origin until it rests; no repair, no polish.

    A batch is one ODE, from which problems are dropped as they finish: at rest, or proven
    infeasible. Where no forces exist u grows for ever, along a direction that is a proof; u itself,
    moved into the dual cones (`solvers.duality.recession_direction`), usually is one long before.

    Of 200 real grasps with caps, preloads and torque limits (Barrett hand, 3 to 8 contacts) 167 can
    be held. Judged optimal among them, and infeasible among the other 33:

    | horizon | `min_norm` | `sum_normal` |
    | --- | --- | --- |
    | 100 | 4, 31 | 0, 30 |
    | 400 | 152, 32 | 49, 32 |
    | 1000 | 161, 33 | 117, 33 |
    | 4000 | 164, 33 | 160, 33 |

    The rest are at the edge of feasibility, where the flow is slow. All 200 took 10 s (39 s with
    `sum_normal`) on one core, most of it for the last few.

    Args:
        horizon: time at which to give up.
        tolerance: size of the field that counts as rest; forces miss the constraints by no more
            than this, relative to the force scale. The judge allows 1e-12, and of inequalities
            nothing.

    Raises:
        SolverError: unless both are positive and finite.
    """

    objectives = ("min_norm", "sum_normal")

    def __init__(self, horizon: float = 4000.0, tolerance: float = 1e-9) -> None:
        self._horizon = real_number("horizon", horizon, 0.0, np.inf)
        self._tolerance = real_number("tolerance", tolerance, 0.0, np.inf)

    @torch.no_grad()
    def propose(self, problem: GraspForceProblem) -> Candidate:
        """The states at rest; at the horizon where there is no rest."""
        tensors = problem.to_torch()
        program = grasp_program(tensors)
        x, u = torch.zeros_like(program.linear), torch.zeros_like(program.bound)
        size = residual(program, x, u)
        proven = torch.zeros(len(problem), dtype=torch.bool)
        proofs = Multipliers(
            np.zeros((len(problem), 6)), np.zeros((len(problem), problem.n_joints))
        )
        time, accuracy = 0.0, _STEP_TOLERANCE
        while time < self._horizon:
            going = torch.nonzero((size > self._tolerance) & ~proven)[:, 0]
            if not len(going):
                break
            part = program[going]
            span = min(max(time, _FIRST_SPAN), self._horizon - time)
            ends = torch.tensor([0.0, span], dtype=torch.float64)
            path = integrate(part, ends, start=(x[going], u[going]), tolerance=accuracy)
            x[going], u[going] = path.x[-1], path.u[-1]
            size[going] = residual(part, path.x[-1], path.u[-1])
            index = going.numpy()
            proof = _along(problem[index], path.u[-1])
            proofs.equilibrium[index], proofs.torque[index] = proof.equilibrium, proof.torque
            proven[going] = torch.from_numpy(farkas_value(problem[index], proof) > FARKAS_TOLERANCE)
            time += span
            accuracy = max(_REFINEMENT * accuracy, self._tolerance)
        prices = grasp_multipliers(tensors, u).map(Tensor.numpy)
        settled = proven.numpy()
        rest = (size <= self._tolerance).numpy()
        return Candidate(
            forces=force_scale(problem)[:, None] * x.numpy(),
            multipliers=Multipliers(
                np.where(settled[:, None], proofs.equilibrium, prices.equilibrium),
                np.where(settled[:, None], proofs.torque, prices.torque),
            ),
            message=np.array(
                [
                    "" if done else f"no rest at t = {time:g}: the field's size is {left:.1e}"
                    for done, left in zip(rest | settled, size.tolist(), strict=True)
                ],
                dtype=np.str_,
            ),
        )


def _along(problem: GraspForceProblem, u: Tensor) -> Multipliers:
    """The multipliers nearest to u along which the dual grows for ever; float64 numpy."""
    form = canonical(problem)
    ray = canonical_multipliers(problem, u).map(Tensor.numpy)
    return form.multipliers(recession_direction(form.problem, ray))
