"""The paper's network: one instance of one problem, fitted to the KKT ODE by collocation.

Basumatary et al., "Grasp Force Optimization as a Bilinear Matrix Inequality Problem", section 3,
after Wu and Lisser, "A deep learning approach for solving linear programming problems", 2023:
y(t) = (1 - e^-t) NN(t) with NN of one input, 100 units of tanh and one output for each component of
y = (x, u) (equation 16) is fitted to y' = phi(y) on [0, 10] in steps of 0.01 (equation 17), and the
answer is y(10). Nothing is learned that another problem could use.
"""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn.utils import parameters_to_vector, skip_init

from solvers.arguments import real_number, whole_number
from solvers.base import InstanceSolver
from solvers.exceptions import SolverError
from solvers.kkt import ConeProgram, grasp_multipliers, grasp_program, kkt_field
from solvers.kkt.ansatz import Ansatz
from solvers.problem import GraspForceProblem, force_scale
from solvers.solution import Candidate

HORIZON = 10.0
"""T of the paper."""

ITERATIONS = 1000
"""Of the fit, as in the paper's figures of the loss."""

_STEPS = 1000
"""Of the grid of times; 0.01 each with the paper's T."""

_FIRST_TIME = 2e-3
"""Share of the horizon at which the first unit of the hidden layer turns."""

_STEEPNESS = 8.0
"""Of a unit at its centre, over the time of its centre."""

_OUTPUT_WEIGHT = 0.02
"""Largest initial weight of the output layer."""

_MEMORY = 200
"""Pairs of steps and gradients that L-BFGS keeps."""

_EVALUATIONS = 25
"""Of the loss in one line search, at most; nearly all need one."""


class InstanceNetwork(Ansatz):
    """y(t) = (1 - e^-t) NN(t), with NN of one input, a layer of tanh and `outputs` outputs.

    It is the ansatz of `solvers.kkt.ansatz` without a problem, started at zero. The paper does not
    print the initial weights. Each hidden unit here turns about a time of its own, within a quarter
    of that time; the times are log-uniform up to the horizon, one in each of as many equal parts.
    The ODE has a boundary layer at zero, in which the usual initial weights leave hardly a unit.

    Args:
        outputs: components of y, n + m in the paper.
        hidden: units of tanh.
        horizon: T.
        seed: of the initial weights; torch's global generator is left alone.
    """

    def __init__(
        self, outputs: int, *, hidden: int = 100, horizon: float = HORIZON, seed: int = 0
    ) -> None:
        super().__init__()
        self.horizon = horizon
        generator = torch.Generator().manual_seed(seed)

        def uniform(*shape: int) -> Tensor:
            return torch.rand(*shape, generator=generator, dtype=torch.float64)

        self.hidden = skip_init(nn.Linear, 1, hidden, dtype=torch.float64)
        self.output = skip_init(nn.Linear, hidden, outputs, dtype=torch.float64)
        with torch.no_grad():
            centre = horizon * _FIRST_TIME ** ((torch.arange(hidden) + uniform(hidden)) / hidden)
            slope = _STEEPNESS / centre * torch.sign(uniform(hidden) - 0.5)
            self.hidden.weight.copy_(slope[:, None])
            self.hidden.bias.copy_(-slope * centre)
            self.output.weight.copy_(_OUTPUT_WEIGHT * (2.0 * uniform(outputs, hidden) - 1.0))
            self.output.bias.copy_(_OUTPUT_WEIGHT * (2.0 * uniform(outputs) - 1.0))

    def forward(self, times: Tensor) -> Tensor:
        """(T, outputs) y at times (T,)."""
        return self.with_derivative(times)[0]

    def start(self, problem: object) -> Tensor:
        """() zero, whatever the problem."""
        return torch.zeros((), dtype=torch.float64)

    def inner(self, times: Tensor, problem: object) -> tuple[Tensor, Tensor]:
        """(T, outputs) NN and dNN/dt at times (T,), whatever the problem."""
        hidden = torch.tanh(self.hidden(times[:, None]))
        change = (1.0 - hidden**2) * self.hidden.weight[:, 0]
        return self.output(hidden), change @ self.output.weight.mT


@dataclass(frozen=True, eq=False)
class InstanceFit:
    """A fitted network, and its answer.

    Args:
        network: y(t).
        losses: (iterations,) the loss after each iteration; fewer if no descent was left.
        x: (m,) primal part of y(T).
        u: (k,) multipliers in y(T).
    """

    network: InstanceNetwork
    losses: NDArray[np.float64]
    x: Tensor
    u: Tensor


def collocation_loss(network: InstanceNetwork, program: ConeProgram, times: Tensor) -> Tensor:
    """() mean over the times of |dy/dt - phi(y)|^2: equation 17, with the squared norm for l."""
    m = program.linear.shape[-1]
    state, derivative = network.with_derivative(times)
    field = torch.cat(kkt_field(program, state[:, :m], state[:, m:]), dim=-1)
    return (derivative - field).square().sum(dim=-1).mean()


class _Loss:
    """The loss at the network's weights and its gradient there, in `grad` as optimisers ask for it.

    Kept from one call to the next: each iteration of torch's L-BFGS begins with the loss at the
    weights that the line search before it ended with.
    """

    def __init__(self, network: InstanceNetwork, program: ConeProgram, times: Tensor) -> None:
        self._network, self._program, self._times = network, program, times
        self._weights = list(network.parameters())
        self._at: Tensor | None = None

    def __call__(self) -> Tensor:
        here = parameters_to_vector(self._weights).detach()
        if self._at is None or not torch.equal(here, self._at):
            loss = collocation_loss(self._network, self._program, self._times)
            for weight, gradient in zip(
                self._weights, torch.autograd.grad(loss, self._weights), strict=True
            ):
                weight.grad = gradient
            self._at, self._loss = here, loss.detach()
        return self._loss


def fit(
    program: ConeProgram,
    *,
    seed: int = 0,
    iterations: int = ITERATIONS,
    horizon: float = HORIZON,
) -> InstanceFit:
    """Fit a network to the KKT ODE of one program.

    The paper prints no optimiser. This is L-BFGS in float64 on the whole grid of times. On the
    paper's benchmark it leaves a loss of 7e-5 and an objective 0.009 % from the optimum (medians of
    twelve seeds; at most 0.03 %, and 0.07 % with the oldest kernels of torch); Adam, at its best
    rate of 0.01 and with as many iterations, 1.8 and up to 0.5 % from the same initial weights, 3.3
    and up to 5 % from the usual uniform ones.

    Args:
        program: one cone program, float64.
        seed: of the initial weights.
        iterations: of L-BFGS.
        horizon: T, cut into 1000 steps.

    Raises:
        SolverError: for a batch of programs.
    """
    if program.linear.ndim != 1:
        raise SolverError("a network is fitted to one program; index the batch first")
    m, k = len(program.linear), len(program.bound)
    network = InstanceNetwork(m + k, horizon=horizon, seed=seed)
    weights = list(network.parameters())
    times = torch.linspace(0.0, horizon, _STEPS + 1, dtype=torch.float64)
    optimizer = torch.optim.LBFGS(
        weights,
        max_iter=1,
        max_eval=_EVALUATIONS,
        tolerance_grad=0.0,
        tolerance_change=0.0,
        history_size=_MEMORY,
        line_search_fn="strong_wolfe",
    )
    evaluate = _Loss(network, program, times)
    losses = [float(evaluate())]
    for _ in range(iterations):
        optimizer.step(evaluate)
        losses.append(float(evaluate()))
        if not losses[-1] < losses[-2]:
            break
    with torch.no_grad():
        state = network(times[-1:])[0]
    return InstanceFit(network, np.array(losses[1:]), state[:m], state[m:])


class InstanceNetworkSolver(InstanceSolver):
    """A network fitted to each problem anew; its state at the horizon is the answer, as it is.

    Args:
        seed: of the initial weights.
        iterations: of the fit.
        horizon: T.

    The network follows the ODE closely, but at the paper's T = 10 the ODE of a grasp is still far
    from its rest, and no answer satisfies the constraints: docs/paper.md has the figures for real
    grasps, for this T and for T = 100.

    Raises:
        SolverError: unless seed and iterations are whole numbers, and horizon and iterations
            positive.
    """

    objectives = ("min_norm", "sum_normal")

    def __init__(
        self, seed: int = 0, iterations: int = ITERATIONS, horizon: float = HORIZON
    ) -> None:
        self._seed = whole_number("seed", seed, 0)
        real_number("iterations", iterations, 0.0, np.inf)
        self._iterations = whole_number("iterations", iterations, 1)
        self._horizon = real_number("horizon", horizon, 0.0, np.inf)

    def propose_one(self, problem: GraspForceProblem) -> Candidate:
        """Forces and multipliers of y(T)."""
        tensors = problem.to_torch()
        answer = fit(
            grasp_program(tensors),
            seed=self._seed,
            iterations=self._iterations,
            horizon=self._horizon,
        )
        return Candidate(
            forces=float(force_scale(problem)) * answer.x.numpy(),
            multipliers=grasp_multipliers(tensors, answer.u).map(Tensor.numpy),
            message=np.array("a fitted trajectory at its horizon, which enforces no constraint"),
        )
