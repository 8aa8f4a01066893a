"""One ansatz, two networks: the paper's is the conditioned one without a problem, from zero."""

from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from torch import Tensor

from solvers.duality import dual_bound
from solvers.kkt.ansatz import Ansatz, ansatz, inner_values, interpolated
from solvers.kkt.multiplier_flow import kkt_flow
from solvers.learned.config import NetworkConfig
from solvers.learned.network import ConditionedKktNetwork, joined, split
from solvers.paper.instance_network import InstanceNetwork
from solvers.problem import CanonicalProblem, canonical
from tests.solvers.learned.test_network import random_network
from tests.support.problems import random_batch
from tests.support.seeds import SEEDS, seeded

STEPS = 3


class WithoutProblem(ConditionedKktNetwork):
    """The conditioned network with p dropped and y0 = 0: NN(t) is the paper's layer of tanh."""

    def __init__(self, paper: InstanceNetwork) -> None:
        super().__init__(NetworkConfig(steps=STEPS))
        self.paper = paper

    def start(self, problem: CanonicalProblem) -> Tensor:
        return torch.zeros((), dtype=torch.float64)

    def inner(self, times: Tensor, problem: CanonicalProblem) -> tuple[Tensor, Tensor]:
        return self.paper.inner(times, None)


@pytest.fixture(scope="module")
def form() -> CanonicalProblem:
    """Float64 torch; half of the problems with torque limits that matter."""
    batch = random_batch(seeded(0), 12)
    share = np.where(np.arange(12) % 2 == 0, 1.0, 0.05)[:, None]
    return canonical(batch.replace(torque_max=share * batch.torque_max).to_torch())


def random_times(rng: np.random.Generator, count: int, end: float) -> Tensor:
    return torch.as_tensor(np.concatenate([[0.0, end], rng.uniform(0.0, end, count)]))


@given(seed=SEEDS)
def test_conditioned_form_without_problem_and_start_is_the_papers_formula(seed: int) -> None:
    rng = seeded(seed)
    outputs, hidden = int(rng.integers(1, 30)), int(rng.integers(1, 120))
    paper = InstanceNetwork(outputs, hidden=hidden, seed=seed)
    with torch.no_grad():
        for weight in paper.parameters():
            weight.copy_(torch.as_tensor(rng.normal(size=weight.shape)))
    conditioned = WithoutProblem(paper)
    times = random_times(rng, 20, 10.0)
    anything: Any = object()
    with torch.no_grad():
        value, slope = conditioned.with_derivative(times, anything)
        same_value, same_slope = paper.with_derivative(times)
        assert torch.equal(value, same_value)
        assert torch.equal(slope, same_slope)
        whole = torch.arange(STEPS + 1, dtype=torch.float64)
        assert torch.equal(conditioned.with_derivative(whole, anything)[0], paper(whole))

    # equation 16 and its derivative by hand
    w1, b1, w2, b2 = (weight.detach().numpy() for weight in paper.parameters())
    for t, state, change in zip(times.numpy(), value.numpy(), slope.numpy(), strict=True):
        units = np.tanh(w1[:, 0] * t + b1)
        inner, rate = w2 @ units + b2, w2 @ ((1.0 - units**2) * w1[:, 0])
        np.testing.assert_allclose(state, (1 - np.exp(-t)) * inner, rtol=1e-11, atol=1e-11)
        expected = np.exp(-t) * inner + (1 - np.exp(-t)) * rate
        np.testing.assert_allclose(change, expected, rtol=1e-11, atol=1e-11)


def test_both_networks_are_the_ansatz_and_nothing_else() -> None:
    for network in (InstanceNetwork, ConditionedKktNetwork):
        assert issubclass(network, Ansatz)
        assert "with_derivative" not in vars(network)


def test_answers_of_the_conditioned_network_are_read_from_its_ansatz(
    form: CanonicalProblem,
) -> None:
    network = random_network()
    whole = torch.arange(network.config.steps + 1, dtype=torch.float64)
    with torch.no_grad():
        states, _ = network.with_derivative(whole, form)
        answer = joined(network(form))
        inner, _ = network.inner(whole, form)
    assert torch.equal(states, answer)
    assert torch.equal(answer[0], network.start(form))
    share = -torch.expm1(-whole)[:, None, None]
    torch.testing.assert_close(answer, network.start(form) + share * inner)
    assert torch.all(dual_bound(form.problem, split(answer)).diff(dim=0) >= -1e-9)


def test_trajectory_starts_along_the_flow(form: CanonicalProblem) -> None:
    network = random_network()
    zero = torch.zeros(1, dtype=torch.float64)
    with torch.no_grad():
        (state,), (slope,) = network.with_derivative(zero, form)
    torch.testing.assert_close(slope, joined(kkt_flow(form.problem, split(state))))


def test_derivative_of_the_conditioned_trajectory_is_exact(form: CanonicalProblem) -> None:
    network = random_network()
    times = torch.tensor([0.01, 0.2, 0.9, 1.4, 2.5, 2.99], dtype=torch.float64)
    step = 1e-6
    with torch.no_grad():
        _, slope = network.with_derivative(times, form)
        ahead, _ = network.with_derivative(times + step, form)
        behind, _ = network.with_derivative(times - step, form)
    size = 1e-8 * float(ahead.abs().max())
    torch.testing.assert_close(slope, (ahead - behind) / (2 * step), rtol=1e-6, atol=size)


@given(seed=SEEDS)
def test_inner_values_invert_the_ansatz(seed: int) -> None:
    rng = seeded(seed)
    states, first = (torch.as_tensor(rng.normal(size=size)) for size in ((5, 2, 3), (2, 3)))
    values = inner_values(states, first)
    assert torch.equal(values[0], first)
    whole = torch.arange(5, dtype=torch.float64)
    there, _ = ansatz(states[0], *interpolated(values, whole), whole)
    torch.testing.assert_close(there, states)


@given(seed=SEEDS)
def test_interpolation_is_linear_between_whole_times(seed: int) -> None:
    rng = seeded(seed)
    values = torch.as_tensor(rng.normal(size=(4, 2)))
    times = random_times(rng, 10, 3.0)
    got, slope = interpolated(values, times)
    for column in range(2):
        expected = np.interp(times, np.arange(4), values[:, column])
        np.testing.assert_allclose(got[:, column], expected, rtol=1e-12, atol=1e-12)
    part = np.minimum(np.floor(times.numpy()).astype(int), 2)
    np.testing.assert_array_equal(slope, values.diff(dim=0)[part])
