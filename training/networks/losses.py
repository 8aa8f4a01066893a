"""What the network can be trained for, without any solved example.

`dual_loss` asks for the largest proven lower bound, which is the certified gap but for a constant.
`collocation_loss` asks for a trajectory of the KKT ODE, as equation 17 of Basumatary et al. does
for one instance. `training_loss` mixes the two.
"""

import torch
from torch import Tensor

from solvers.duality import dual_bound
from solvers.exact.polish import dual_residual, polished
from solvers.kkt.ansatz import ansatz, inner_values, interpolated
from solvers.kkt.multiplier_flow import kkt_flow
from solvers.learned.network import joined, split
from solvers.problem import CanonicalProblem, Multipliers

_FLOOR = 0.05
"""Below this bound (in units of the squared force scale) the logarithm goes on more gently; the
optimum is at least 1/4, because the forces are at least as large as load and preload."""

_CEILING = 1000.0
"""Nothing is gained beyond: forces of 45 times the force scale, or no feasible forces at all."""

_NEWTON_STEPS = 10
_SOLVED = 1e-6
"""After so many Newton steps, this residual (in units of the force scale) tells solved problems."""

_UNSOLVED_WEIGHT = 0.05
"""Of the other problems: most are infeasible, and their bounds, which grow without end, would drown
the small gaps of all others."""


_COLLOCATION_TIMES = 4
"""For each step of the network, evenly spread."""


def training_loss(
    canonical: CanonicalProblem, iterates: Multipliers, weights: Tensor, collocation: float
) -> Tensor:
    """() (1 - c) dual loss + c collocation loss; a loss with no share in it is not computed.

    Args:
        canonical: B problems, torch.
        iterates: (steps + 1, B, .) multipliers from the network; the first is the start.
        weights: (B,) of the problems, from `problem_weights`.
        collocation: c, from 0 to 1.
    """
    total = torch.zeros((), dtype=weights.dtype, device=weights.device)
    if collocation < 1.0:
        total = total + (1.0 - collocation) * dual_loss(canonical, iterates, weights)
    if collocation > 0.0:
        total = total + collocation * collocation_loss(canonical, iterates, weights)
    return total


def problem_weights(canonical: CanonicalProblem, iterates: Multipliers) -> Tensor:
    """(B,) one for problems that Newton steps from the last iterate solve, little for all others.

    Args:
        canonical: B problems, float64 numpy.
        iterates: (steps + 1, B, .) multipliers from the network.
    """
    last = iterates[-1].map(lambda part: part.detach().cpu().double().numpy())
    end = polished(canonical.problem, last, _NEWTON_STEPS)
    solved = torch.as_tensor(dual_residual(canonical.problem, end) < _SOLVED)
    device, dtype = iterates.equilibrium.device, iterates.equilibrium.dtype
    return torch.where(solved, 1.0, _UNSOLVED_WEIGHT).to(device, dtype)


def dual_loss(canonical: CanonicalProblem, iterates: Multipliers, weights: Tensor) -> Tensor:
    """Mean of -log(dual bound) over problems and iterates t > 0, each worth twice the one before.

    A relative gap is a difference of such logarithms, so that problems of every size count alike.
    The bound needs no label: it never exceeds the optimum, where it is tight.

    Args:
        canonical: B problems, torch.
        iterates: (steps + 1, B, .) multipliers from the network; the first is the start.
        weights: (B,) of the problems, from `problem_weights`.
    """
    bound = dual_bound(canonical.problem, iterates[1:])
    reached = torch.log(bound.clamp(min=_FLOOR, max=_CEILING))
    shortfall = torch.log1p((_FLOOR - bound).clamp(min=0.0) / _FLOOR)
    per_iterate = ((shortfall - reached) @ weights) / weights.sum()
    growing = 2.0 ** torch.arange(len(bound), dtype=bound.dtype, device=bound.device)
    return (growing @ per_iterate) / growing.sum()


def collocation_loss(canonical: CanonicalProblem, iterates: Multipliers, weights: Tensor) -> Tensor:
    """Mean of |y' - Phi(y)|^2 over (1 + |y|^2), over problems and times: equation 17, relative.

    Phi is the flow of the multipliers (`solvers.kkt.multiplier_flow.kkt_flow`), y(t; p) the ansatz
    through the iterates (`solvers.kkt.ansatz`), in which NN(t, p) is linear between whole times, y'
    its exact derivative. The times lie evenly within the steps.

    Args:
        canonical: B problems, torch.
        iterates: (steps + 1, B, .) multipliers from the network; the first is the start.
        weights: (B,) of the problems, from `problem_weights`.
    """
    problem, states = canonical.problem, joined(iterates)
    count = _COLLOCATION_TIMES * (len(states) - 1)
    parts = torch.arange(count, dtype=states.dtype, device=states.device)
    times = (parts + 0.5) / _COLLOCATION_TIMES
    first = joined(kkt_flow(problem, split(states[0])))
    value, slope = interpolated(inner_values(states, first), times)
    path, velocity = ansatz(states[0], value, slope, times)
    residual = velocity - joined(kkt_flow(problem, split(path)))
    size = 1.0 + path.detach().square().sum(dim=-1)
    relative = residual.square().sum(dim=-1) / size
    return (relative.mean(dim=0) @ weights) / weights.sum()
