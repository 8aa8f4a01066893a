"""The ansatz of the paper, with a problem as its second argument: y0(p) + (1 - e^-t) NN(t, p).

Basumatary et al., "Grasp Force Optimization as a Bilinear Matrix Inequality Problem", equation 16,
write a trajectory of the KKT ODE as y(t) = (1 - e^-t) NN(t), which starts at zero whatever NN is,
and fit NN to one instance. Given the problem p as well, one network does for all of them:

    y(t; p) = y0(p) + (1 - e^-t) NN(t, p).

With p dropped and y0 = 0 the second is the first. `solvers.paper.instance_network` is that case,
with a layer of tanh for NN; `solvers.learned.network` has a recurrence for NN(t, p), known at whole
times and linear in between.
"""

from abc import ABC, abstractmethod
from typing import Any

import torch
from torch import Tensor, nn


class Ansatz(nn.Module, ABC):
    """y(t; p) = y0(p) + (1 - e^-t) NN(t, p): a subclass gives y0 and NN, and NN's slope."""

    @abstractmethod
    def start(self, problem: Any) -> Tensor:
        """y0(p), of shape (m,), (B, m) for a batch of problems, or () where all are the same."""

    @abstractmethod
    def inner(self, times: Tensor, problem: Any) -> tuple[Tensor, Tensor]:
        """NN(t, p) and its derivative in t at times (T,): both (T, m), or (T, B, m)."""

    def with_derivative(self, times: Tensor, problem: Any = None) -> tuple[Tensor, Tensor]:
        """y and dy/dt at times (T,), exact, of the shape of NN; see `ansatz`."""
        return ansatz(self.start(problem), *self.inner(times, problem), times)


def ansatz(start: Tensor, value: Tensor, slope: Tensor, times: Tensor) -> tuple[Tensor, Tensor]:
    """y = y0 + (1 - e^-t) NN and dy/dt = e^-t NN + (1 - e^-t) dNN/dt.

    Args:
        start: y0, of a shape that broadcasts with one time of `value`.
        value: (T, ..., m) NN.
        slope: (T, ..., m) dNN/dt.
        times: (T,).
    """
    decay = torch.exp(-times).reshape(-1, *[1] * (value.ndim - 1))
    return start + (1.0 - decay) * value, decay * value + (1.0 - decay) * slope


def inner_values(states: Tensor, first_slope: Tensor) -> Tensor:
    """NN at t = 0, 1, ..., K of a trajectory: the ansatz, solved for it.

    At zero the states leave NN open. It is the slope dy/dt there, so that the slope of the ODE at
    the start makes the ansatz satisfy the ODE at t = 0.

    Args:
        states: (K + 1, ..., m) y at whole times, the first of them y0.
        first_slope: (..., m) dy/dt at zero.
    """
    times = torch.arange(1, len(states), dtype=states.dtype, device=states.device)
    share = -torch.expm1(-times).reshape(-1, *[1] * (states.ndim - 1))
    return torch.cat([first_slope[None], (states[1:] - states[0]) / share])


def interpolated(values: Tensor, times: Tensor) -> tuple[Tensor, Tensor]:
    """A function that is linear between its values at t = 0, 1, ..., K, and its slope.

    Args:
        values: (K + 1, ..., m).
        times: (T,) from 0 to K. At whole times the slope is that of the part that follows; at K, of
            the last part.
    """
    part = times.floor().long().clamp(max=len(values) - 2)
    share = (times - part).reshape(-1, *[1] * (values.ndim - 1))
    slope = values[part + 1] - values[part]
    return values[part] + share * slope, slope
