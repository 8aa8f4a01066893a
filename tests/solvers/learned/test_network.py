import dataclasses
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

import solvers.learned.network as network_module
from solvers import GraspForceProblem, SolverError, solve
from solvers.arrays import Array
from solvers.duality import contact_duals, dual_bound, project_cones, projection_jacobian
from solvers.kkt.multiplier_flow import (
    best_iterate,
    evaluate,
    kkt_flow,
    momentum,
    newton_direction,
    stacked,
)
from solvers.learned.config import NetworkConfig
from solvers.learned.features import from_raw, to_raw
from solvers.learned.files import load_network, read_metadata, save_network
from solvers.learned.network import ConditionedKktNetwork, joined
from solvers.problem import CanonicalProblem, Multipliers, canonical
from tests.support.problems import random_batch, random_rotation, skew
from tests.support.seeds import reseeded, seeded


def random_network(seed: int = 0) -> ConditionedKktNetwork:
    """A float64 network whose corrections are large enough to matter."""
    generator = torch.Generator().manual_seed(reseeded(seed))
    network = ConditionedKktNetwork(NetworkConfig(steps=3)).double()
    for parameter in network.parameters():
        scale = 0.2 if parameter.ndim == 1 else 0.3 / math.sqrt(parameter.shape[1])
        torch.nn.init.normal_(parameter, std=scale, generator=generator)
    return network


def ask(
    network: ConditionedKktNetwork, problem: GraspForceProblem
) -> tuple[Array, Array, CanonicalProblem]:
    """Contact prices (steps + 1, B, n, 3) and torque prices of all iterates, original units."""
    tensors = problem.to_torch()
    form = canonical(tensors)
    with torch.no_grad():
        iterates = network(form)
    multipliers = form.multipliers(iterates)
    return contact_duals(tensors, multipliers).numpy(), multipliers.torque.numpy(), form


def turned_tangents(problem: GraspForceProblem, angles: Array) -> tuple[GraspForceProblem, Array]:
    """The problem with each contact's tangents turned by its angle, and the (B, n, 3, 3) turns."""
    batch, n = problem.friction.shape
    turns = np.zeros((batch, n, 3, 3))
    turns[..., 0, 0] = turns[..., 1, 1] = np.cos(angles)
    turns[..., 1, 0] = np.sin(angles)
    turns[..., 0, 1] = -np.sin(angles)
    turns[..., 2, 2] = 1.0
    columns = np.einsum("bwni,bnij->bwnj", problem.grasp_map.reshape(batch, 6, n, 3), turns)
    rows = np.einsum("bnik,bnij->bnjk", problem.hand_jacobian.reshape(batch, n, 3, -1), turns)
    changed = problem.replace(
        grasp_map=columns.reshape(problem.grasp_map.shape),
        hand_jacobian=rows.reshape(problem.hand_jacobian.shape),
    )
    return changed, turns


@pytest.fixture(scope="module")
def problem() -> GraspForceProblem:
    """Some with torque limits that matter, some with preload or caps, 3 to 8 contacts."""
    rng = seeded(0)
    loose = random_batch(rng, 12)
    tight = loose.replace(
        torque_min=0.05 * loose.torque_min,
        torque_max=0.05 * loose.torque_max,
        external_torque=np.zeros_like(loose.external_torque),
    )
    fields = ("grasp_map", "hand_jacobian", "friction", "torque_min", "torque_max")
    fields += ("external_wrench", "external_torque", "normal_min", "normal_max", "contact_mask")
    return GraspForceProblem(
        **{name: np.concatenate([getattr(loose, name), getattr(tight, name)]) for name in fields}
    )


def same(a: Array, b: Array) -> None:
    np.testing.assert_allclose(a, b, rtol=1e-7, atol=1e-9 * np.abs(a).max())


Change = Callable[[GraspForceProblem], tuple[GraspForceProblem, float, float]]


def moved_frame(problem: GraspForceProblem) -> tuple[GraspForceProblem, float, float]:
    rotation = random_rotation(seeded(1))
    adjoint = np.kron(np.eye(2), rotation)
    adjoint[3:, :3] = skew(np.array([0.03, -0.05, 0.02])) @ rotation
    wrench = problem.external_wrench @ adjoint.T
    return problem.replace(grasp_map=adjoint @ problem.grasp_map, external_wrench=wrench), 1, 1


def in_millimetres(problem: GraspForceProblem) -> tuple[GraspForceProblem, float, float]:
    rows = np.array([1.0, 1.0, 1.0, 1e3, 1e3, 1e3])
    torques = {
        name: 1e3 * getattr(problem, name)
        for name in ("hand_jacobian", "torque_min", "torque_max", "external_torque")
    }
    changed = problem.replace(
        grasp_map=rows[:, None] * problem.grasp_map,
        external_wrench=rows * problem.external_wrench,
        **torques,
    )
    return changed, 1, 1e-3


def in_kilonewtons(problem: GraspForceProblem) -> tuple[GraspForceProblem, float, float]:
    names = ("external_wrench", "torque_min", "torque_max", "external_torque")
    names += ("normal_min", "normal_max")
    return problem.replace(**{name: 1e-3 * getattr(problem, name) for name in names}), 1e-3, 1e-3


@pytest.mark.parametrize("change", [moved_frame, in_millimetres, in_kilonewtons])
def test_units_and_object_frame_do_not_matter(problem: GraspForceProblem, change: Change) -> None:
    network = random_network()
    prices, torques, _ = ask(network, problem)
    other, force, torque = change(problem)
    changed_prices, changed_torques, _ = ask(network, other)
    assert np.any(torques != 0)
    same(changed_prices, force * prices)
    same(changed_torques, torque * torques)


def test_prices_turn_with_the_tangents(problem: GraspForceProblem) -> None:
    network = random_network()
    prices, torques, _ = ask(network, problem)
    angles = seeded(2).uniform(0.0, 2.0 * np.pi, problem.friction.shape)
    changed, turns = turned_tangents(problem, angles)
    turned_prices, turned_torques, _ = ask(network, changed)
    same(np.einsum("bnij,sbnj->sbni", turns, turned_prices), prices)
    same(turned_torques, torques)


def test_order_of_contacts_joints_and_padding_do_not_matter(problem: GraspForceProblem) -> None:
    network = random_network()
    prices, torques, _ = ask(network, problem)
    rng = seeded(3)
    order, joints = rng.permutation(problem.n_contacts), rng.permutation(problem.n_joints)
    columns = (3 * order[:, None] + np.arange(3)).ravel()
    arrays = {
        name: getattr(problem, name)[:, order]
        for name in ("friction", "normal_min", "normal_max", "contact_mask")
    } | {
        name: getattr(problem, name)[:, joints]
        for name in ("torque_min", "torque_max", "external_torque")
    }
    shuffled = problem.replace(
        grasp_map=problem.grasp_map[:, :, columns],
        hand_jacobian=problem.hand_jacobian[:, columns][:, :, joints],
        **arrays,
    )
    other_prices, other_torques, _ = ask(network, shuffled.pad(problem.n_contacts + 2))
    same(other_prices[..., : problem.n_contacts, :], prices[..., order, :])
    assert np.all(other_prices[..., problem.n_contacts :, :] == 0)
    same(other_torques, torques[..., joints])


def test_corrections_of_the_random_network_are_taken(problem: GraspForceProblem) -> None:
    learned, _, form = ask(random_network(), problem)
    plain, _, _ = ask(ConditionedKktNetwork(NetworkConfig(steps=3)).double(), problem)
    assert np.mean(np.abs(learned - plain).max(axis=(-1, -2))[1:] > 1e-3) > 0.5
    assert len(form.problem) == len(problem)


def reference_fista(problem: GraspForceProblem, steps: int) -> list[float]:
    """Dual values of textbook FISTA on one canonical problem; it restarts rather than fall."""
    a = np.vstack([problem.grasp_map, problem.hand_jacobian.T])
    step = 1.0 / np.linalg.norm(a, 2) ** 2

    def value(point: Array) -> float:
        return float(dual_bound(problem, Multipliers(point[:6], point[6:])))

    def euler(point: Array) -> Array:
        prices = contact_duals(problem, Multipliers(point[:6], point[6:]))
        gradient = a @ project_cones(problem, -prices).ravel()
        moved = point[6:] + step * gradient[6:]
        above = np.maximum(moved - step * problem.torque_max, 0.0)
        below = np.minimum(moved - step * problem.torque_min, 0.0)
        nu = point[:6] + step * (gradient[:6] + problem.external_wrench)
        return np.concatenate([nu, above + below])

    here = before = np.concatenate([2.0 * problem.external_wrench, 0.0 * problem.torque_max])
    values = [value(here)]
    for k in range(steps):
        new = euler(here)
        ahead = before + (1.0 + momentum(k)) * (new - before)
        best = max((ahead, new, here), key=value)
        before, here = (new if best is ahead else best), best
        values.append(value(here))
    return values


def test_untrained_network_without_its_line_search_is_fista(
    problem: GraspForceProblem, monkeypatch: pytest.MonkeyPatch
) -> None:
    def nowhere(problem: GraspForceProblem, here: Multipliers, *_: object) -> Multipliers:
        return Multipliers(torch.zeros_like(here.equilibrium), torch.zeros_like(here.torque))

    monkeypatch.setattr(network_module, "newton_direction", nowhere)
    monkeypatch.setattr(network_module, "_LENGTHS", (1.0,))
    network = ConditionedKktNetwork().double()
    form = canonical(problem.to_torch())
    with torch.no_grad():
        bounds = dual_bound(form.problem, network(form)).numpy()
    canonical_numpy = canonical(problem).problem
    for index in range(len(problem)):
        expected = reference_fista(canonical_numpy[index], network.config.steps)
        np.testing.assert_allclose(bounds[:, index], expected, rtol=1e-9)


def test_newton_direction_solves_the_softened_newton_equation(problem: GraspForceProblem) -> None:
    form = canonical(problem.to_torch()).problem[:6]
    no_price = torch.zeros_like(form.torque_max)
    free = form.replace(torque_min=no_price - torch.inf, torque_max=no_price + torch.inf)
    y = 2.0 * form.external_wrench
    now = evaluate(free, Multipliers(y, no_price))
    softness = torch.rand(
        form.friction.shape, generator=torch.Generator().manual_seed(reseeded(0))
    ).double()
    step = newton_direction(free, Multipliers(y, no_price), now, softness)
    assert torch.all(step.torque == 0)
    for index in range(len(free)):
        one = free[index]

        def value(point: torch.Tensor, one: GraspForceProblem = one) -> torch.Tensor:
            bound: torch.Tensor = dual_bound(one, Multipliers(point, no_price[0]))
            return bound

        curvature = -torch.autograd.functional.hessian(value, y[index])
        soft = one.grasp_map * softness[index].repeat_interleave(3) @ one.grasp_map.mT
        expected = torch.linalg.solve(curvature + soft, now.equilibrium[index])
        torch.testing.assert_close(step.equilibrium[index], expected, rtol=0.02, atol=1e-3)


def test_momentum_is_that_of_fista() -> None:
    t = 1.0
    for step in range(5):
        following = (1.0 + math.sqrt(1.0 + 4.0 * t**2)) / 2.0
        assert momentum(step) == pytest.approx((t - 1.0) / following)
        t = following


def test_dual_value_never_falls_and_the_best_iterate_is_the_last(
    problem: GraspForceProblem,
) -> None:
    form = canonical(problem.to_torch())
    with torch.no_grad():
        iterates = random_network()(form)
    bounds = dual_bound(form.problem, iterates)
    assert torch.all(bounds.diff(dim=0) >= -1e-9)
    best = dual_bound(form.problem, best_iterate(form.problem, iterates))
    torch.testing.assert_close(best, bounds.max(dim=0).values)


def test_gradient_reaches_every_parameter(
    problem: GraspForceProblem, monkeypatch: pytest.MonkeyPatch
) -> None:
    # a step takes the best of several candidates, and a random network's own is that in few
    # problems, or in none, where its parameters have no part in the value: here it always is
    monkeypatch.setattr(
        network_module,
        "best_index",
        lambda problem, points: torch.zeros(len(problem), dtype=torch.long),
    )
    network = random_network()
    form = canonical(problem.to_torch())
    dual_bound(form.problem, network(form)).sum().backward()
    for name, parameter in network.named_parameters():
        assert parameter.grad is not None, name
        assert torch.all(torch.isfinite(parameter.grad)), name
        assert torch.any(parameter.grad != 0), name


def test_first_gradient_is_finite_without_limits_in_float32() -> None:
    free = random_batch(seeded(4), 8, torque_max=np.inf, normal_max=np.inf)
    form = canonical(free.to_torch(dtype=torch.float32))
    form = dataclasses.replace(form, problem=form.problem.to_torch(dtype=torch.float32))
    network = ConditionedKktNetwork()
    dual_bound(form.problem, network(form)).sum().backward()
    assert all(
        torch.all(torch.isfinite(p.grad)) for p in network.parameters() if p.grad is not None
    )


def test_network_without_joints() -> None:
    rng = seeded(5)
    batch = random_batch(rng, 4)
    empty = np.zeros((4, 0))
    problem = batch.replace(
        hand_jacobian=np.zeros((4, 3 * batch.n_contacts, 0)),
        torque_min=empty,
        torque_max=empty,
        external_torque=empty,
    )
    prices, torques, _ = ask(random_network(), problem)
    assert np.all(np.isfinite(prices))
    assert torques.shape == (4, 4, 0)


def test_evaluation_is_the_gradient_of_the_dual(problem: GraspForceProblem) -> None:
    form = canonical(problem.to_torch()).problem
    generator = torch.Generator().manual_seed(reseeded(0))
    y = torch.randn(form.external_wrench.shape, generator=generator, dtype=torch.float64)
    y.requires_grad_(True)
    here = Multipliers(y, torch.zeros_like(form.torque_max))
    dual_bound(form, here).sum().backward()
    torch.testing.assert_close(y.grad, evaluate(form, here).equilibrium.detach())


def test_flow_is_that_of_the_evaluation_for_any_number_of_points(
    problem: GraspForceProblem,
) -> None:
    form = canonical(problem.to_torch()).problem
    generator = torch.Generator().manual_seed(reseeded(0))
    points = [
        Multipliers(
            torch.randn(form.external_wrench.shape, generator=generator, dtype=torch.float64),
            torch.randn(form.torque_min.shape, generator=generator, dtype=torch.float64),
        )
        for _ in range(3)
    ]
    together = kkt_flow(form, stacked(points))
    for index, point in enumerate(points):
        now = evaluate(form, point)
        torch.testing.assert_close(together.equilibrium[index], now.equilibrium)
        price = torch.where(
            point.torque + now.torque > form.torque_max,
            point.torque + now.torque - form.torque_max,
            (point.torque + now.torque - form.torque_min).clamp(max=0.0),
        )
        torch.testing.assert_close(together.torque[index], price - point.torque)


def test_flow_rests_at_the_optimum(problem: GraspForceProblem) -> None:
    exact = solve(problem, "clarabel")
    rows = np.flatnonzero(exact.status == "optimal")
    assert len(rows) > 12
    form = canonical(problem[rows].to_torch())
    prices = Multipliers(
        torch.as_tensor(exact.equilibrium_dual[rows]), torch.as_tensor(exact.torque_dual[rows])
    )
    there = from_raw(form, prices)
    assert torch.any(there.torque.abs() > 1e-3)
    error = torch.linalg.vector_norm(joined(kkt_flow(form.problem, there)), dim=-1)
    size = 1.0 + torch.linalg.vector_norm(joined(there), dim=-1)
    assert float((error / size).max()) < 1e-6
    away = Multipliers(there.equilibrium + 0.1, there.torque)
    error = torch.linalg.vector_norm(joined(kkt_flow(form.problem, away)), dim=-1)
    assert float(error.min()) > 1e-3


def test_raw_coordinates_are_the_problem_as_it_was_given(problem: GraspForceProblem) -> None:
    tensors = problem.to_torch()
    form = canonical(tensors)
    generator = torch.Generator().manual_seed(reseeded(0))
    y = torch.randn(form.problem.external_wrench.shape, generator=generator, dtype=torch.float64)
    point = Multipliers(y, torch.randn(form.problem.torque_min.shape, generator=generator).double())
    raw, prices = to_raw(form, point)
    for name in ("grasp_map", "hand_jacobian", "external_wrench", "normal_min", "normal_max"):
        torch.testing.assert_close(getattr(raw, name), getattr(tensors, name))
    torch.testing.assert_close(raw.torque_max, tensors.torque_max - tensors.external_torque)
    expected = form.multipliers(point)
    torch.testing.assert_close(prices.equilibrium, expected.equilibrium)
    torch.testing.assert_close(prices.torque, expected.torque)
    back = from_raw(form, stacked([prices, prices]))
    torch.testing.assert_close(back.equilibrium, stacked([point, point]).equilibrium)
    torch.testing.assert_close(back.torque, stacked([point, point]).torque)


def test_network_in_raw_coordinates_starts_alike_and_climbs(problem: GraspForceProblem) -> None:
    form = canonical(problem.to_torch())
    raw = ConditionedKktNetwork(NetworkConfig(steps=3, coordinates="raw")).double()
    other = ConditionedKktNetwork(NetworkConfig(steps=3)).double()
    with torch.no_grad():
        iterates, force = raw(form), other(form)
    torch.testing.assert_close(iterates.equilibrium[0], force.equilibrium[0])
    assert torch.all(dual_bound(form.problem, iterates).diff(dim=0) >= -1e-9)
    assert not torch.allclose(iterates.equilibrium[1:], force.equilibrium[1:])


def test_no_steps_are_the_start(problem: GraspForceProblem) -> None:
    form = canonical(problem.to_torch())
    iterates = ConditionedKktNetwork(NetworkConfig(steps=0)).double()(form)
    assert iterates.equilibrium.shape[0] == 1
    assert torch.equal(iterates.equilibrium[0], 2.0 * form.problem.external_wrench)
    assert torch.all(iterates.torque == 0)


@pytest.mark.parametrize("size", [1.0, 10.0, 60.0])
def test_projection_jacobian_is_the_derivative(problem: GraspForceProblem, size: float) -> None:
    points = size * seeded(6).standard_normal((*problem.friction.shape, 3))
    exact = projection_jacobian(problem, points)
    step = 1e-6
    for axis in range(3):
        offset = step * np.eye(3)[axis]
        ahead = project_cones(problem, points + offset)
        behind = project_cones(problem, points - offset)
        np.testing.assert_allclose(exact[..., axis], (ahead - behind) / (2 * step), atol=1e-6)


def test_file_keeps_weights_configuration_and_metadata(tmp_path: Path) -> None:
    network = ConditionedKktNetwork(NetworkConfig(steps=2, width=8))
    path = tmp_path / "network.safetensors"
    save_network(network, path, {"command": "python scripts/train.py"})
    loaded = load_network(path, ConditionedKktNetwork)
    assert loaded.config == network.config
    assert read_metadata(path, ConditionedKktNetwork)["command"] == "python scripts/train.py"
    content = path.read_bytes()
    for _ in range(10):
        save_network(loaded, path, {"command": "python scripts/train.py"})
        assert path.read_bytes() == content
    for name, value in network.state_dict().items():
        assert torch.equal(loaded.state_dict()[name], value)


def test_bad_files_are_refused(tmp_path: Path) -> None:
    missing, text, other = (tmp_path / name for name in ("missing", "text", "other"))
    text.write_text("no weights")
    from safetensors.torch import save_file

    save_file({"a": torch.ones(1)}, other)
    with pytest.raises(SolverError, match="no weights at"):
        load_network(missing, ConditionedKktNetwork)
    with pytest.raises(SolverError, match="not a safetensors file"):
        load_network(text, ConditionedKktNetwork)
    with pytest.raises(SolverError, match="format"):
        load_network(other, ConditionedKktNetwork)


def test_damaged_weights_are_refused(tmp_path: Path) -> None:
    network = ConditionedKktNetwork(NetworkConfig(steps=2, width=8))
    path = tmp_path / "network.safetensors"
    save_network(network, path, {"command": "train"})
    whole = path.read_bytes()
    rng = seeded(0)
    expected = network.state_dict()
    for length in rng.integers(len(whole), size=50):
        path.write_bytes(whole[:length])
        with pytest.raises(SolverError, match=str(path)):
            load_network(path, ConditionedKktNetwork)
    header = 8 + int.from_bytes(whole[:8], "little")
    places = [*rng.integers(header, size=100), *rng.integers(header, len(whole), size=100)]
    for place in places:
        flipped = bytearray(whole)
        flipped[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(flipped)
        try:
            found = load_network(path, ConditionedKktNetwork).state_dict()
        except SolverError:
            continue
        assert place < header  # the command, say; never a weight
        assert all(torch.equal(found[name], value) for name, value in expected.items())


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"width\\": 8', '"width\\": 9'),
        ('"width\\": 8', '"wi\\": 8, \\"x\\": 8'),
        ('"steps\\": 2', '"steps\\": 1e9'),
        ('"steps\\": 2', '"steps\\": [2]'),
        ('"width\\": 8', '"width\\": 99999999'),
    ],
)
def test_configurations_that_do_not_fit_are_refused(tmp_path: Path, old: str, new: str) -> None:
    path = tmp_path / "network.safetensors"
    save_network(ConditionedKktNetwork(NetworkConfig(steps=2, width=8)), path, {})
    whole = path.read_bytes()
    length = int.from_bytes(whole[:8], "little")
    header = whole[8 : 8 + length].rstrip()
    assert old.encode() in header
    header = header.replace(old.encode(), new.encode())
    path.write_bytes(len(header).to_bytes(8, "little") + header + whole[8 + length :])
    with pytest.raises(SolverError, match="configuration"):
        load_network(path, ConditionedKktNetwork)
