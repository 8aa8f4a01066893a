"""Throughput on a GPU: the structured solver and the network with Newton steps, both in torch."""

import dataclasses
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from solvers import GraspForceProblem

if TYPE_CHECKING:
    from solvers.exact.torch_finish import FinishedForces

SIZES = (4096, 65536)
CERTIFIED = 1e-6

_REPEATS = 5
_NEWTON_STEPS = 2


@dataclass(frozen=True)
class DeviceThroughput:
    """One solver on one device at one batch size.

    Args:
        device: its name.
        title: of the solver.
        size: of the batch.
        seconds: median time of a batch, its tensors already on the device.
        certified: share of the batch with a certified gap of `CERTIFIED` or a proof that there are
            no forces.
    """

    device: str
    title: str
    size: int
    seconds: float
    certified: float

    @property
    def per_second(self) -> float:
        """Problems certified in a second."""
        return self.size * self.certified / self.seconds


def device_throughput(
    draw: Callable[[int], GraspForceProblem], sizes: Sequence[int] = SIZES, device: str = "cuda"
) -> list[DeviceThroughput]:
    """Time the torch solvers on a device, each batch drawn anew.

    Args:
        draw: problems, by their number.
        sizes: of the batches.
        device: torch's name of it.
    """
    import torch

    name = torch.cuda.get_device_name(device) if device.startswith("cuda") else device
    figures = []
    for size in sizes:
        problems = draw(size).to_torch(device=device)
        for title, solver in (
            ("dual Newton (torch)", _exact),
            (f"network ({_NEWTON_STEPS} Newton steps)", _network(device)),
        ):
            seconds, certified = _time(solver, problems, device)
            figures.append(DeviceThroughput(name, title, size, seconds, certified))
    return figures


def _time(
    solver: Callable[[GraspForceProblem], Any], problems: GraspForceProblem, device: str
) -> tuple[float, float]:
    import torch

    wait = torch.cuda.synchronize if device.startswith("cuda") else (lambda: None)
    certified = float(solver(problems).double().mean())
    times = []
    for _ in range(_REPEATS):
        wait()
        started = time.perf_counter()
        solver(problems)
        wait()
        times.append(time.perf_counter() - started)
    return float(np.median(times)), certified


def _exact(problems: GraspForceProblem) -> Any:
    """(B,) certified by the structured solver."""
    from solvers.exact.dual_newton_torch import solve_tensors
    from solvers.judge import Status

    solution = solve_tensors(problems)
    return (solution.gap.abs() <= CERTIFIED) | solution.is_status(Status.INFEASIBLE)


def _network(device: str) -> Callable[[GraspForceProblem], Any]:
    """The network with Newton steps, as a function that returns (B,) certified."""
    import torch

    from solvers.exact.torch_finish import finished_forces
    from solvers.exact.torch_newton import (
        ascent_step,
        cholesky_qr,
        direction,
        evaluate_dual,
        tightened,
    )
    from solvers.kkt.multiplier_flow import best_iterate
    from solvers.learned.conditioned import DEFAULT_WEIGHTS
    from solvers.learned.files import load_network
    from solvers.learned.network import ConditionedKktNetwork
    from solvers.problem import canonical

    network = load_network(DEFAULT_WEIGHTS, ConditionedKktNetwork).to(device)

    @torch.inference_mode()
    def solve(problems: GraspForceProblem) -> Any:
        form = canonical(problems, cholesky_qr)
        single = form.problem.to_torch(dtype=torch.float32, device=device)
        best = best_iterate(single, network(dataclasses.replace(form, problem=single)))
        inner = tightened(form.problem)
        here = evaluate_dual(inner, best.map(torch.Tensor.double))
        ahead = direction(inner, here)
        for _ in range(_NEWTON_STEPS):
            here = ascent_step(inner, here, ahead)
            ahead = direction(inner, here)
        found: FinishedForces = finished_forces(problems, form, here, ahead)
        return found.gap.abs() <= CERTIFIED

    return solve
