"""What enters the solvers: one error of their own for whatever has another shape, type or range."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch

from solvers import (
    OBJECTIVES,
    Candidate,
    GraspForceError,
    GraspForceProblem,
    Multipliers,
    ProblemError,
    SolverError,
    UnknownSolverError,
    available_solvers,
    judge,
    make_solver,
    solve,
)
from solvers.conic import ConicProgram
from solvers.differentiable import contact_supports, optimal_forces, optimal_value
from solvers.differentiable import quality_estimates as estimates
from solvers.duality import cone_slope, contact_duals, dual_bound, farkas_value, project_cones
from solvers.exact.dual_newton import solve_flat
from solvers.exact.dual_newton_torch import solve_tensors
from solvers.judge import force_residuals, judge_flat
from solvers.passive_resistance import (
    most_passive_resistance,
    passive_resistance,
    settled_torque,
)
from solvers.problem import MAX_QUALITY, canonical, least_force, residuals
from solvers.quality.directions import weakest_directions, weakest_support
from solvers.quality.proof import CoverProof
from solvers.quality.share_tree import ShareTree
from solvers.quality.verdict import judge_quality, quality_bounds
from solvers.solution import judge_candidate
from solvers.synthesis import ContactFacets, ascend, force_problems, internal_work, synthesise
from tests.support.problems import random_batch, random_problem
from tests.support.seeds import seeded

PROBLEM = random_problem(seeded(0))
BATCH = random_batch(seeded(1), 3)
N, JOINTS = PROBLEM.n_contacts, PROBLEM.n_joints
NONE = Multipliers(np.zeros(6), np.zeros(JOINTS))
QUALITY = PROBLEM.replace(
    objective=MAX_QUALITY, effort_budget=100.0, characteristic_length=0.04, normal_min=None
)
FACETS = ContactFacets(
    corners=tuple(
        np.array([[1.0, 1, side], [1, -1, side], [-1, -1, side], [-1, 1, side]]) * 0.02
        for side in (-1.0, 1.0)
    ),
    normals=np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]),
    friction=np.full(2, 0.5),
    length=0.04,
)

_RESIDUALS = {
    name: getattr(residuals, name)
    for name in (
        "contact_wrench",
        "joint_torques",
        "equilibrium_residual",
        "friction_violation",
        "normal_violation",
        "torque_violation",
        "objective_value",
    )
}


@pytest.mark.parametrize("length", [0, 1, 3 * N - 1, 3 * N + 1, 300])
def test_forces_of_another_length_are_refused(length: int) -> None:
    forces = np.ones(length)
    wanted = rf"forces has shape \({length},\) but must have \({3 * N},\)"
    for call in (
        lambda: judge(PROBLEM, forces, NONE),
        lambda: force_residuals(PROBLEM, forces),
        lambda: settled_torque(PROBLEM, forces, 0.04),
        *(lambda measure=measure: measure(PROBLEM, forces) for measure in _RESIDUALS.values()),
    ):
        with pytest.raises(ProblemError, match=wanted):
            call()
    answers = np.ones((3, length))
    with pytest.raises(ProblemError, match=r"forces has shape .* but must have \(3, "):
        judge_flat(BATCH, answers, Multipliers(np.zeros((3, 6)), np.zeros((3, JOINTS))))
    with pytest.raises(ProblemError, match="forces has shape"):
        judge(BATCH, forces, Multipliers(np.zeros((3, 6)), np.zeros((3, JOINTS))))


@pytest.mark.parametrize(
    ("equilibrium", "torque", "named"),
    [
        (np.zeros(5), np.zeros(JOINTS), r"multipliers.equilibrium has shape .*5,?\) .* 6\)|\(6,\)"),
        (np.zeros(60), np.zeros(JOINTS), r"multipliers.equilibrium has shape"),
        (np.zeros(6), np.zeros(JOINTS - 1), r"multipliers.torque has shape"),
        (np.zeros(6), np.zeros(0), r"multipliers.torque has shape"),
        (np.zeros(6), np.zeros(800), r"multipliers.torque has shape"),
    ],
)
def test_multipliers_of_another_shape_are_refused(
    equilibrium: np.ndarray, torque: np.ndarray, named: str
) -> None:
    multipliers = Multipliers(equilibrium, torque)
    with pytest.raises(ProblemError, match=named):
        judge(PROBLEM, np.ones(3 * N), multipliers)
    tensors = multipliers.map(torch.tensor)
    for problem, given in ((BATCH, multipliers), (BATCH.to_torch(), tensors)):
        for bound in (dual_bound, farkas_value, contact_duals):
            with pytest.raises(ProblemError, match=named):
                bound(problem, Multipliers(given.equilibrium[..., None, :], given.torque))


def test_answers_in_any_layout_of_memory_are_judged_alike() -> None:
    solution = solve(BATCH)
    multipliers = Multipliers(solution.equilibrium_dual, solution.torque_dual)
    expected = judge(BATCH, solution.forces, multipliers)
    twice = np.repeat(solution.forces, 2, axis=1)
    variants: list[Any] = [
        np.asfortranarray(solution.forces),
        twice[:, ::2],
        solution.forces[::-1].copy()[::-1],
        solution.forces.astype(solution.forces.dtype.newbyteorder()),
        solution.forces.tolist(),
        torch.tensor(solution.forces, requires_grad=True),
    ]
    fixed = solution.forces.copy()
    fixed.flags.writeable = False
    for forces in (*variants, fixed):
        verdict = judge(BATCH, forces, multipliers)
        for name, array in vars(expected).items():
            np.testing.assert_array_equal(getattr(verdict, name), array)


@pytest.mark.parametrize("forces", [None, "none", [[1.0], [1.0, 2.0]], np.ones(3 * N) * 1j, {}])
def test_what_are_no_numbers_is_refused(forces: Any) -> None:
    with pytest.raises(ProblemError, match="forces"):
        judge(PROBLEM, forces, NONE)
    with pytest.raises(ProblemError, match="forces"):
        force_residuals(PROBLEM, forces)


def test_problems_of_unchecked_shapes_do_not_reach_compiled_code() -> None:
    flat = BATCH.flat()
    answer = np.ones((3, 3 * flat.n_contacts)), Multipliers(np.zeros((3, 6)), np.zeros((3, JOINTS)))
    for name in ("grasp_map", "hand_jacobian", "torque_max", "external_wrench", "contact_mask"):
        short = flat.derived(**{name: getattr(flat, name)[..., :-1]})
        for call in (
            lambda short=short: judge_flat(short, *answer),
            lambda short=short: solve_flat(short),
            lambda short=short: make_solver("interior_point").judged(short),
        ):
            with pytest.raises(ProblemError, match=f"{name} has shape"):
                call()
    with pytest.raises(ProblemError, match="one batch dimension"):
        solve_flat(PROBLEM)
    with pytest.raises(ProblemError, match=r"call problem\.to_numpy"):
        solve_flat(BATCH.to_torch())
    # another type or layout is no error: what the code sees is a copy of the right one
    single = flat.derived(grasp_map=np.asfortranarray(flat.grasp_map, dtype=np.float32))
    exact = flat.derived(grasp_map=flat.grasp_map.astype(np.float32).astype(np.float64))
    np.testing.assert_array_equal(solve_flat(single).forces, solve_flat(exact).forces)


def _quality_calls() -> dict[str, Callable[[], Any]]:
    flat, tensors = QUALITY.reshape(1), QUALITY.to_torch()
    wrenches = torch.zeros(1, N, 6, 3)
    few = np.ones((1, N - 1))
    none = Multipliers(np.zeros((1, 6)), np.zeros((1, JOINTS)))
    return {
        "weakest_support, normal": lambda: weakest_support(
            QUALITY.grasp_map, QUALITY.friction, few[0], 0.04
        ),
        "weakest_support, grasp map": lambda: weakest_support(
            QUALITY.grasp_map[:, 1:], QUALITY.friction, np.ones(N), 0.04
        ),
        "weakest_directions, normal": lambda: weakest_directions(flat, few),
        "weakest_directions, starts": lambda: weakest_directions(
            flat, np.ones((1, N)), np.ones((9, 6))
        ),
        "weakest_directions, a single problem": lambda: weakest_directions(QUALITY, np.ones(N)),
        "quality_bounds, normal": lambda: quality_bounds(QUALITY, few[0]),
        "quality_bounds, objective": lambda: quality_bounds(PROBLEM, np.ones(N)),
        "judge_quality, forces": lambda: judge_quality(flat, few, none),
        "judge_quality, proofs": lambda: judge_quality(flat, np.ones((1, 3 * N)), none, ((), ())),
        "judge, objective": lambda: judge(QUALITY, np.ones(3 * N), NONE),
        "estimates, normal": lambda: estimates(tensors, torch.ones(N - 1)),
        "estimates, directions": lambda: estimates(tensors, torch.ones(N), torch.ones(4, 5)),
        "contact_supports": lambda: contact_supports(
            wrenches, torch.ones(1, N - 1), torch.ones(1, 2, 6), torch.ones(1, N)
        ),
        "share tree, prices": lambda: ShareTree(3).advance(
            np.ones((4, 3)), np.ones((2, 2)), np.ones(2), 0.0
        ),
        "share tree, ends": lambda: ShareTree(3).advance(
            np.ones((4, 3)), np.ones((2, 3)), np.ones(1), 0.0
        ),
    }


@pytest.mark.parametrize("name", list(_quality_calls()))
def test_arrays_of_quality_are_checked(name: str) -> None:
    with pytest.raises(ProblemError):
        _quality_calls()[name]()


def test_proofs_of_other_shapes_prove_nothing() -> None:
    proof = CoverProof(100.0, 50.0, np.eye(6), ())
    assert isinstance(proof.holds(QUALITY), bool)
    assert not CoverProof(100.0, 50.0, np.eye(5), ()).holds(QUALITY)
    assert not CoverProof(100.0, 50.0, np.zeros((0, 6)), ()).holds(QUALITY)


@pytest.mark.parametrize(
    "call",
    [
        lambda: project_cones(PROBLEM, np.ones((N - 1, 3))),
        lambda: cone_slope(PROBLEM, np.ones(3 * N)),
        lambda: least_force(PROBLEM, np.ones(5)),
        lambda: canonical(None),  # type: ignore[arg-type]
        lambda: ConicProgram(BATCH),
        lambda: passive_resistance(BATCH, np.ones(3 * N), np.eye(6), 0.04, joint_friction=0.0),
        lambda: passive_resistance(PROBLEM, np.ones(9), np.eye(6), 0.04, joint_friction=0.0),
        lambda: passive_resistance(PROBLEM, np.ones(3 * N), np.eye(5), 0.04, joint_friction=0.0),
        lambda: most_passive_resistance(
            PROBLEM,
            "much",
            np.eye(6),
            0.04,
            joint_friction=0.0,  # type: ignore[arg-type]
        ),
        lambda: most_passive_resistance(None, 1.0, np.eye(6), 0.04, joint_friction=0.0),  # type: ignore[arg-type]
        lambda: synthesise(None, np.eye(6)),  # type: ignore[arg-type]
        lambda: synthesise(FACETS, np.eye(5)),
        lambda: ascend(FACETS, np.eye(6), np.zeros((3, 3))),
        lambda: ascend(FACETS, np.zeros((0, 6)), FACETS.centre),
        lambda: force_problems(FACETS, FACETS.centre[:1], np.eye(6)),
        lambda: force_problems(FACETS, FACETS.centre, np.eye(5)),
        lambda: internal_work(FACETS, np.ones(5)),
        lambda: FACETS.grasp_map(np.zeros((5, 3))),
        lambda: optimal_forces(None),  # type: ignore[arg-type]
        lambda: optimal_value("problem"),  # type: ignore[arg-type]
        lambda: solve_tensors(None),  # type: ignore[arg-type]
        lambda: judge(None, np.ones(12), NONE),  # type: ignore[arg-type]
        lambda: judge(PROBLEM, np.ones(3 * N), (np.zeros(6), np.zeros(8))),  # type: ignore[arg-type]
        lambda: judge_candidate(BATCH.flat(), None),  # type: ignore[arg-type]
        lambda: judge_candidate(
            BATCH.flat(),
            Candidate(
                np.zeros((3, 3 * N)),
                Multipliers(np.zeros((3, 6)), np.zeros((3, JOINTS))),
                np.array(["", ""]),
            ),
        ),
    ],
)
def test_bad_arguments_are_errors_of_the_project(call: Callable[[], Any]) -> None:
    with pytest.raises(GraspForceError):
        call()


@pytest.mark.parametrize("problem", [None, 3, "problem", {}, np.ones(3), PROBLEM.grasp_map])
def test_what_is_no_problem_is_not_solved(problem: Any) -> None:
    for call in (
        lambda: solve(problem),
        lambda: solve(problem, "pseudoinverse"),
        lambda: make_solver("dual_newton").solve(problem),
        lambda: GraspForceProblem.stack([PROBLEM, problem]),
    ):
        with pytest.raises(ProblemError, match=f"must be given, not {type(problem).__name__}"):
            call()


@pytest.mark.parametrize(
    "strangers",
    [
        None,
        3,
        PROBLEM,
        BATCH,
        [],
        [PROBLEM, PROBLEM.to_torch()],
        [PROBLEM, PROBLEM.replace(objective="sum_normal")],
        [PROBLEM, QUALITY],
        [PROBLEM, BATCH],
    ],
    ids=str,
)
def test_strangers_do_not_stack(strangers: Any) -> None:
    with pytest.raises(ProblemError):
        GraspForceProblem.stack(strangers)


@pytest.mark.parametrize("name", [None, 3, [], ("dual_newton",), b"dual_newton"])
def test_names_of_solvers_are_strings(name: Any) -> None:
    with pytest.raises(UnknownSolverError, match="unknown solver"):
        make_solver(name)
    with pytest.raises(SolverError, match="a name or an object with solve"):
        solve(PROBLEM, name)


def test_a_class_is_no_solver() -> None:
    with pytest.raises(SolverError, match="a name or an object with solve"):
        solve(PROBLEM, type(make_solver("dual_newton")))  # type: ignore[arg-type]


_WHOLE = [1.5, "4", None, True, -1, np.nan, [1], np.float64(2.0)]
_POSITIVE = [0.0, -1.0, np.nan, "1e-9", None, True, [0.1], 1e-9 + 0j]


@pytest.mark.parametrize(
    ("solver", "setting", "values"),
    [
        ("dual_newton", "threads", [0, *_WHOLE]),
        ("interior_point", "threads", [0, *_WHOLE]),
        ("clarabel", "tolerance", [1.0, *_POSITIVE]),
        ("dual_newton_torch", "tolerance", [1.0, *_POSITIVE]),
        ("dual_newton_torch", "device", ["nowhere", 1.5]),
        ("lmi", "backend", ["nobody", 3]),
        ("conditioned", "polish_steps", _WHOLE),
        ("conditioned", "tolerance", _POSITIVE),
        ("conditioned", "repair", [1, None, "yes"]),
        ("conditioned", "fallback", ["nobody", 3, True]),
        ("conditioned", "weights", [3, ["a", "b"]]),
        ("quality", "weights", [3, ["a", "b"]]),
        ("quality_search", "rounds", [0, *_WHOLE]),
        ("quality_search", "tolerance", [1e-4, 1.0, *_POSITIVE]),
        ("kkt_ode", "horizon", [np.inf, *_POSITIVE]),
        ("kkt_ode", "tolerance", [np.inf, *_POSITIVE]),
        ("instance_network", "seed", _WHOLE),
        ("instance_network", "iterations", [0, *_WHOLE]),
        ("instance_network", "horizon", [np.inf, *_POSITIVE]),
    ],
)
def test_settings_of_another_type_or_range_are_refused(
    solver: str, setting: str, values: list[Any]
) -> None:
    factory = type(make_solver(solver))
    for value in values:
        for make in (lambda **given: make_solver(solver, **given), factory):
            with pytest.raises(SolverError, match=setting):
                make(**{setting: value})


@pytest.mark.parametrize("objective", [*OBJECTIVES, MAX_QUALITY])
@pytest.mark.parametrize("name", available_solvers())
def test_no_problems_have_no_answers(name: str, objective: str) -> None:
    solver = make_solver(name)
    if objective not in solver.objectives:
        return
    like = QUALITY if objective == MAX_QUALITY else PROBLEM.replace(objective=objective)
    for shape in ((0,), (2, 0)):
        none = GraspForceProblem.stack([like, like])[[False, False]].reshape(*shape)
        for problem in (none, none.to_torch()):
            solution = solve(problem, name)
            assert tuple(solution.forces.shape) == (*shape, 3 * N)
            assert tuple(solution.equilibrium_dual.shape) == (*shape, 6)
            assert tuple(solution.torque_dual.shape) == (*shape, JOINTS)
            for array in (solution.status, solution.message, solution.gap, solution.verdict.size):
                assert tuple(array.shape) == shape
            assert tuple(solution.torque_violation().shape) == shape


@pytest.mark.parametrize("joints", [0, JOINTS])
@pytest.mark.parametrize("shape", [(0,), (2, 0)])
def test_no_problems_have_no_gradients(shape: tuple[int, ...], joints: int) -> None:
    fields = {name: getattr(PROBLEM, name) for name in ("grasp_map", "friction")}
    limits = dict.fromkeys(("torque_min", "torque_max"), np.zeros(joints))
    none = GraspForceProblem(
        **fields,
        **limits,
        hand_jacobian=PROBLEM.hand_jacobian[:, :joints],
        external_wrench=np.zeros((*shape, 6)),
    ).to_torch()
    load = none.external_wrench.clone().requires_grad_()
    problem = none.replace(external_wrench=load)
    for solver in ("dual_newton", "dual_newton_torch"):
        optimum = optimal_forces(problem, solver)
        value = optimal_value(problem, solver)
        assert tuple(optimum.forces.shape) == (*shape, 3 * N)
        assert tuple(value.value.shape) == optimum.status.shape == shape
        (optimum.forces.sum() + value.value.sum()).backward()
        assert load.grad is not None
        assert load.grad.shape == load.shape


def test_no_problems_have_no_quality() -> None:
    none = QUALITY.reshape(1)[[False]]
    assert weakest_directions(none, np.zeros((0, N)))[0].shape == (0,)
    nothing = torch.zeros(0, N, dtype=torch.float64)
    for directions in (None, torch.zeros(0, 3, 6, dtype=torch.float64)):
        assert estimates(none.to_torch(), nothing, directions).shape == (0,)
