"""Every public function with one argument spoilt: an answer, or an error of the project's own."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import trimesh

from gfo_env.contacts import (
    contact_frames,
    grasp_map,
    has_interior_internal_force,
    is_force_closure,
    lowest_resisted_wrench,
    quality_estimate,
)
from gfo_env.objects import Patches
from gfo_env.policy import SolverPolicy
from gfo_env.synthesis import improve
from solvers import GraspForceProblem, Multipliers, available_solvers, judge, make_solver, solve
from solvers.differentiable import optimal_forces, optimal_value, quality_estimates
from solvers.exact.dual_newton_torch import solve_tensors
from solvers.judge import force_residuals
from solvers.passive_resistance import (
    most_passive_resistance,
    passive_resistance,
    settled_torque,
)
from solvers.synthesis import ContactFacets, ascend, synthesise
from tests.fuzz import hostile
from tests.fuzz.outcome import WrongAnswer, tell
from tests.support.problems import random_problem
from tests.support.quality_problems import quality_problem

_QUICK = ("dual_newton", "interior_point", "clarabel", "conditioned", "dual_newton_torch")
_SETTINGS: dict[str, dict[str, Any]] = {
    "dual_newton": {"threads": 1},
    "interior_point": {"threads": 1},
    "clarabel": {"tolerance": 1e-10},
    "conditioned": {
        "polish_steps": 4,
        "repair": True,
        "tolerance": 1e-6,
        "fallback": "dual_newton",
        "weights": None,
    },
    "dual_newton_torch": {"device": None, "tolerance": 1e-12},
    "quality_search": {"tolerance": 0.01, "rounds": 400},
    "quality": {"weights": None},
}


@dataclass(frozen=True)
class Call:
    """A function with arguments that are right.

    Args:
        function: to be called.
        arguments: by name.
    """

    function: Callable[..., Any]
    arguments: dict[str, Any]


def _problem(rng: np.random.Generator, **overrides: Any) -> GraspForceProblem:
    return random_problem(rng, int(rng.integers(3, 6)), **overrides)


def _fields(problem: GraspForceProblem) -> dict[str, Any]:
    return {name: value for name, value in vars(problem).items() if value is not None}


def _of_problem(rng: np.random.Generator) -> Call:
    return Call(GraspForceProblem, _fields(_problem(rng)))


def _of_tensors(rng: np.random.Generator) -> Call:
    return Call(GraspForceProblem, _fields(_problem(rng).to_torch()))


def _of_quality_problem(rng: np.random.Generator) -> Call:
    return Call(GraspForceProblem, _fields(quality_problem(rng, 4)))


def _replace(rng: np.random.Generator) -> Call:
    problem = _problem(rng)
    return Call(problem.replace, _fields(problem))


def _stack(rng: np.random.Generator) -> Call:
    problems = [_problem(rng), _problem(rng)]
    return Call(
        lambda first, second: GraspForceProblem.stack([first, second]),
        {"first": problems[0], "second": problems[1]},
    )


def _stack_of(rng: np.random.Generator) -> Call:
    return Call(GraspForceProblem.stack, {"problems": [_problem(rng), _problem(rng)]})


def _pad(rng: np.random.Generator) -> Call:
    return Call(_problem(rng).pad, {"n_contacts": 8})


def _solve(rng: np.random.Generator) -> Call:
    return Call(solve, {"problem": _problem(rng), "solver": str(rng.choice(_QUICK))})


def _solver(rng: np.random.Generator) -> Call:
    name = str(rng.choice(list(_SETTINGS)))
    quality = name.startswith("quality")
    problem = quality_problem(rng, 3) if quality else _problem(rng)

    def made(**settings: Any) -> Any:
        return make_solver(name, **settings).solve(problem)

    return Call(made, dict(_SETTINGS[name]))


def _make(rng: np.random.Generator) -> Call:
    return Call(make_solver, {"name": str(rng.choice(available_solvers()))})


def _judge(rng: np.random.Generator) -> Call:
    problem = _problem(rng)
    if rng.random() < 0.5:
        problem = GraspForceProblem.stack([problem, problem])
    answer = solve(problem)

    def judged(problem: Any, forces: Any, nu: Any, torque: Any) -> Any:
        return vars(judge(problem, forces, Multipliers(nu, torque)))

    return Call(
        judged,
        {
            "problem": problem,
            "forces": answer.forces,
            "nu": answer.equilibrium_dual,
            "torque": answer.torque_dual,
        },
    )


def _residuals(rng: np.random.Generator) -> Call:
    problem = _problem(rng)
    return Call(force_residuals, {"problem": problem, "forces": solve(problem).forces})


def _tensor_solver(rng: np.random.Generator) -> Call:
    return Call(solve_tensors, {"problem": _problem(rng).to_torch(), "tolerance": 1e-12})


def _differentiable(rng: np.random.Generator) -> Call:
    function = (optimal_forces, optimal_value)[rng.integers(2)]
    return Call(function, {"problem": _problem(rng).to_torch(), "solver": "dual_newton"})


def _estimates(rng: np.random.Generator) -> Call:
    problem = quality_problem(rng, 4).to_torch()
    return Call(quality_estimates, {"problem": problem, "normal": torch.rand(4).double() + 0.1})


def _resistance(rng: np.random.Generator) -> Call:
    problem = _problem(rng, normal_max=40.0)
    common = {
        "disturbances": np.vstack([np.eye(6)[:2], -np.eye(6)[:2]]),
        "length": 0.04,
        "joint_friction": 0.01,
    }
    forces = solve(problem).forces
    if rng.random() < 0.3:
        return Call(settled_torque, {"problem": problem, "forces": forces, "length": 0.04})
    if rng.random() < 0.5:
        return Call(passive_resistance, {"problem": problem, "forces": forces, **common})
    return Call(most_passive_resistance, {"problem": problem, "budget": 50.0, **common})


def _points(rng: np.random.Generator) -> dict[str, Any]:
    directions = rng.standard_normal((4, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return {"positions": 0.04 * directions, "normals": -directions, "friction": np.full(4, 0.6)}


def _quality(rng: np.random.Generator) -> Call:
    points = _points(rng)
    if rng.random() < 0.3:
        return Call(is_force_closure, points)
    if rng.random() < 0.3:
        return Call(has_interior_internal_force, points)
    more = {"normal_forces": np.ones(4), "edges": 8, "length": 0.04, "relative_width": 0.01}
    return Call(lowest_resisted_wrench, points | more)


def _maps(rng: np.random.Generator) -> Call:
    points = _points(rng)
    frames = contact_frames(points["normals"])
    if rng.random() < 0.3:
        return Call(contact_frames, {"normals": points["normals"]})
    if rng.random() < 0.5:
        return Call(grasp_map, {"positions": points["positions"], "frames": frames})
    return Call(
        quality_estimate,
        {
            "grasp_map": grasp_map(points["positions"], frames),
            "friction": points["friction"],
            "normal_forces": np.ones(4),
            "length": 0.04,
        },
    )


_CORNERS = np.array([[0.02, 0.02], [-0.02, 0.02], [-0.02, -0.02], [0.02, -0.02]])


def _facets() -> dict[str, Any]:
    sides = []
    for axis, sign in ((0, 1.0), (0, -1.0), (1, 1.0)):
        ring = np.insert(_CORNERS, axis, 0.02 * sign, axis=1)
        normal = np.zeros(3)
        normal[axis] = -sign
        sides.append((ring, normal))
    rings, normals = zip(*sides, strict=True)
    return {
        "corners": rings,
        "normals": np.array(normals),
        "friction": np.full(3, 0.8),
        "length": 0.04,
    }


def _synthesis(rng: np.random.Generator) -> Call:
    if rng.random() < 0.6:
        return Call(ContactFacets, _facets())
    facets, loads = ContactFacets(**_facets()), np.eye(6)[:1]
    if rng.random() < 0.3:
        return Call(synthesise, {"facets": facets, "loads": loads})
    return Call(ascend, {"facets": facets, "loads": loads, "positions": facets.centre})


def _improve(rng: np.random.Generator) -> Call:
    box = trimesh.creation.box((0.04, 0.06, 0.08))
    if rng.random() < 0.3:
        return Call(Patches, {"mesh": box})
    positions = np.array([[0.02, 0.02, -0.03], [-0.02, 0.01, 0.02], [-0.01, 0.03, 0.03]])
    return Call(
        improve,
        {
            "patches": Patches(box),
            "positions": positions,
            "normals": np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]),
            "friction": np.full(3, 0.8),
            "length": 0.054,
            "route": "gradient",
        },
    )


def _policy(rng: np.random.Generator) -> Call:
    if rng.random() < 0.5:
        return Call(
            SolverPolicy, {"solver": "dual_newton", "max_force": 20.0, "friction_factor": 0.8}
        )
    problem = _problem(rng, normal_max=20.0).pad(8)
    names = ("grasp_map", "hand_jacobian", "friction", "torque_min", "torque_max")
    names += ("external_torque", "external_wrench", "normal_min", "normal_max", "contact_mask")
    observation = {
        name: np.nan_to_num(np.asarray(getattr(problem, name), dtype=np.float32), posinf=20).ravel()
        for name in names
    }
    policy = SolverPolicy("dual_newton")
    return Call(lambda **given: policy.predict(given), observation)


CALLS: dict[str, Callable[[np.random.Generator], Call]] = {
    maker.__name__.strip("_"): maker
    for maker in (
        *(_of_problem, _of_tensors, _of_quality_problem, _replace, _stack, _stack_of, _pad),
        *(_solve, _solver, _make, _judge, _judge, _residuals, _tensor_solver, _differentiable),
        *(_estimates, _resistance, _quality, _maps, _synthesis, _improve, _policy),
    )
}


def prepare() -> None:
    """Compile what the calls need: each once as it should be."""
    for index, maker in enumerate(CALLS.values()):
        call = maker(np.random.default_rng(index))
        call.function(**call.arguments)


def try_arguments(rng: np.random.Generator) -> str:
    """One argument of one call spoilt; what is answered must be answered twice alike."""
    name = str(rng.choice(list(CALLS)))
    call = CALLS[name](rng)
    argument = str(rng.choice(list(call.arguments)))
    given = call.arguments[argument]
    array = isinstance(given, np.ndarray | torch.Tensor) and given.ndim > 0
    what, value, must = hostile.of_array(rng, given) if array else hostile.of_scalar(rng)
    tell(f"{name}({argument}: {what})")
    answer = call.function(**{**call.arguments, argument: value})
    if must:
        raise WrongAnswer("it is answered")
    if name in ("judge", "residuals", "quality", "maps"):
        again = call.function(**{**call.arguments, argument: value})
        if not _alike(answer, again):
            raise WrongAnswer("it has two answers")
    return "answered"


def _alike(one: Any, other: Any) -> bool:
    if isinstance(one, dict):
        return all(_alike(one[key], other[key]) for key in one)
    if hasattr(one, "__dataclass_fields__"):
        return _alike(vars(one), vars(other))
    return repr(np.asarray(one).tolist()) == repr(np.asarray(other).tolist())
