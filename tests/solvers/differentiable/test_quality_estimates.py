"""q_lrw on tensors: close to the hull from above, with the gradient of finite differences."""

import numpy as np
import pytest
import torch

from solvers import SolverError
from solvers.differentiable import quality_estimates
from solvers.differentiable.quality import least_directions
from solvers.problem import GraspForceProblem
from solvers.quality.directions import unit_wrenches, weakest_directions
from solvers.quality.verdict import QUALITY_WIDTH, quality_bounds
from tests.support.quality_problems import quality_batch
from tests.support.seeds import seeded


def batch(seed: int) -> tuple[GraspForceProblem, np.ndarray]:
    rng = seeded(seed)
    problem = quality_batch(rng, *[4, 5, 6, 7] * 6, friction=0.8).flat()
    normal = rng.uniform(0.5, 2.0, problem.friction.shape) * problem.contact_mask
    return problem, normal


def test_estimates_are_close_above_the_hull() -> None:
    problem, normal = batch(0)
    found = quality_estimates(problem.to_torch(), torch.as_tensor(normal)).numpy()
    compiled, _ = weakest_directions(problem, normal)
    bounds = [
        quality_bounds(problem[i].without_padding(), normal[i][problem.contact_mask[i]])
        for i in range(len(problem))
    ]
    lower = np.array([bound.lower for bound in bounds])
    upper = np.array([bound.upper for bound in bounds])
    closes = lower > 1e-3
    assert closes.sum() > 10
    for estimate in (found, compiled):
        assert (estimate >= lower * (1 - 1e-9)).all()
        assert (estimate[upper == 0.0] <= 1e-6).all()
    error = found[closes] / lower[closes] - 1.0
    # the interval is up to one per cent wide itself
    assert np.median(error) < 0.03
    assert error.max() < 0.3


def test_facet_normals_bring_the_estimate_to_the_hull() -> None:
    problem, normal = batch(1)
    tensors = problem.to_torch()
    for i in range(6):
        one = problem[i].without_padding()
        pressed = normal[i][problem.contact_mask[i]]
        bounds = quality_bounds(one, pressed)
        if bounds.lower == 0.0:
            continue
        estimate = quality_estimates(
            one.to_torch(), torch.as_tensor(pressed), torch.as_tensor(bounds.directions)
        )
        # the upper end may come from a direction of an earlier round, which is not among these
        assert bounds.lower <= float(estimate) <= bounds.upper * (1 + QUALITY_WIDTH)
    assert quality_estimates(tensors, torch.as_tensor(normal)).shape == (len(problem),)


def test_directions_are_unit_and_sorted() -> None:
    problem, normal = batch(2)
    tensors = problem.to_torch()
    wrenches = unit_wrenches(tensors)
    directions = least_directions(wrenches, tensors.friction, torch.as_tensor(normal))
    np.testing.assert_allclose(directions.norm(dim=-1), 1.0, rtol=1e-12)
    along = torch.einsum("bkd,bndx->bknx", directions, wrenches)
    support = along[..., 2] + tensors.friction[:, None] * along[..., :2].norm(dim=-1)
    farthest = (torch.as_tensor(normal)[:, None] * support).amax(dim=-1)
    assert (farthest.diff(dim=1) >= -1e-12).all()


def test_gradients_are_those_along_the_weakest_direction() -> None:
    """The envelope theorem: the direction itself may be held."""
    problem, normal = batch(3)
    tensors = problem.to_torch()
    names = ("friction", "grasp_map", "characteristic_length")
    leaves = {name: getattr(tensors, name).clone().requires_grad_() for name in names}
    force = torch.tensor(normal, requires_grad=True)
    value = quality_estimates(tensors.derived(**leaves), force)
    gradients = torch.autograd.grad(value.sum(), [force, *leaves.values()])
    directions = least_directions(
        unit_wrenches(tensors), tensors.friction, torch.as_tensor(normal)
    ).numpy()[:, 0]
    closes = value.detach().numpy() > 1e-2
    rng = seeded(4)

    def reaches(pressed: np.ndarray, changed: GraspForceProblem) -> np.ndarray:
        scaled = np.array(changed.grasp_map)
        scaled[:, 3:] /= changed.characteristic_length[:, None, None]
        parts = np.einsum("bd,bdk->bk", directions, scaled).reshape(*pressed.shape, 3)
        support = parts[..., 2] + changed.friction * np.hypot(parts[..., 0], parts[..., 1])
        return np.where(changed.contact_mask, pressed * support, -np.inf)

    def along(pressed: np.ndarray, changed: GraspForceProblem) -> np.ndarray:
        return reaches(pressed, changed).max(axis=1)

    np.testing.assert_allclose(along(normal, problem)[closes], value.detach().numpy()[closes])
    # where two contacts reach equally far, there is a kink
    second, first = np.sort(reaches(normal, problem), axis=1)[:, -2:].T
    smooth = closes & (second < first * (1.0 - 1e-5))
    assert smooth.sum() > 0.8 * closes.sum()
    for name, gradient in zip(("force", *names), gradients, strict=True):
        start = normal if name == "force" else getattr(problem, name)
        move = 1e-6 * rng.standard_normal(start.shape) * start
        ends = [
            along(start + sign * move, problem)
            if name == "force"
            else along(normal, problem.derived(**{name: start + sign * move}))
            for sign in (1.0, -1.0)
        ]
        exact = (gradient.numpy() * move).reshape(len(problem), -1).sum(axis=1)
        np.testing.assert_allclose(
            (ends[0] - ends[1])[smooth] / 2.0, exact[smooth], rtol=1e-4, atol=1e-13
        )


def test_others_than_tensors_of_quality_are_refused() -> None:
    problem, normal = batch(5)
    with pytest.raises(SolverError, match="torch tensors"):
        quality_estimates(problem, torch.as_tensor(normal))
    with pytest.raises(SolverError, match="max_quality"):
        quality_estimates(problem.constraints().to_torch(), torch.as_tensor(normal))
