"""Grasp force problems of every degenerate kind, their answers held against Clarabel and exactly.

A problem begins as one of `tests.support.problems` and is then twisted, once or several times. What
twists leave proper must be solved; what they make singular, or drive out of any range, may also be
refused.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from solvers import OBJECTIVES, GraspForceProblem, ProblemError, Solver, make_solver, solve
from solvers.exact.dual_newton import DualNewtonSolver
from solvers.exact.dual_newton_torch import DualNewtonTorchSolver
from solvers.exact.interior_point import InteriorPointSolver
from solvers.problem import MAX_QUALITY
from tests.fuzz.oracle import truth
from tests.fuzz.outcome import WrongAnswer, tell
from tests.support.problems import forces_in_cones, random_problem
from tests.support.promises import broken_promises

EXACT = ("dual_newton", "interior_point", "clarabel", "conditioned", "dual_newton_torch")
"""Settle every problem that Clarabel settles."""

OTHERS = ("lmi", "kkt_ode", "instance_network", "pseudoinverse", "equal_squeeze")
"""May fail, and may not be wrong."""

QUALITY = ("quality", "quality_search", "uniform_preload")

_FRICTION = (0.0, 1e-8, 0.3, 1.0, 1e3)
_SHARP = (DualNewtonSolver, InteriorPointSolver, DualNewtonTorchSolver)
_OBJECTIVE_ERROR = 1e-7
"""Of the optimum, that these may make."""

_GAP = 1e-6
"""That others may, which end at the gap of what is called optimal."""


@dataclass
class Draft:
    """A problem in the making.

    Args:
        rng: source of everything random.
        fields: of the problem, its objective among them.
        forces: (3n,) N, in the cones of the problem before it was twisted.
        proper: whether it must be solved; else it may be refused, too.
        twists: what was done to it.
    """

    rng: np.random.Generator
    fields: dict[str, Any]
    forces: Any
    proper: bool = True
    twists: list[str] = field(default_factory=list)

    def __getitem__(self, name: str) -> Any:
        return self.fields[name]

    def __setitem__(self, name: str, value: Any) -> None:
        self.fields[name] = value

    @property
    def joints(self) -> int:
        return len(self["torque_min"])

    @property
    def contacts(self) -> int:
        return len(self["friction"])

    def torques(self) -> Any:
        """(n_tau,) N·m of the forces that it began with."""
        return self["hand_jacobian"].T @ self.forces + self["external_torque"]

    def solved(self) -> None:
        """Make the forces that it began with balance the load, within the torque limits."""
        torque = self.torques()
        self["external_wrench"] = -self["grasp_map"] @ self.forces
        self["torque_min"] = np.minimum(self["torque_min"], torque - 1e-3)
        self["torque_max"] = np.maximum(self["torque_max"], torque + 1e-3)

    def some_joints(self) -> Any:
        """A mask with at least one joint, if there are any."""
        chosen = self.rng.random(self.joints) < 0.4
        chosen[self.rng.integers(self.joints) if self.joints else slice(0)] = True
        return chosen


def _pin(draft: Draft) -> None:
    """Torques that are given: reachable ones, zero, or any."""
    chosen = draft.some_joints()
    value = {
        "reachable": draft.torques(),
        "zero": np.zeros(draft.joints),
        "any": draft.torques() + 0.05 * draft.rng.standard_normal(draft.joints),
    }[draft.rng.choice(["reachable", "reachable", "zero", "any"])]
    for name in ("torque_min", "torque_max"):
        draft[name] = np.where(chosen, value, draft[name])


def _nearly_pin(draft: Draft) -> None:
    """Limits that all but coincide."""
    chosen, torque = draft.some_joints(), draft.torques()
    width = 10.0 ** draft.rng.uniform(-17, -6, draft.joints)
    draft["torque_min"] = np.where(chosen, torque - width, draft["torque_min"])
    draft["torque_max"] = np.where(chosen, torque + width, draft["torque_max"])


def _redundant(draft: Draft) -> None:
    """Two joints that feel the same, or one that feels what the object does; both pinned."""
    if draft.joints < 2:
        return
    rng, jacobian = draft.rng, draft["hand_jacobian"].copy()
    one, other = rng.choice(draft.joints, 2, replace=False)
    if rng.random() < 0.5:
        jacobian[:, one] = jacobian[:, other] * rng.uniform(0.5, 2.0)
    else:
        jacobian[:, one] = draft["grasp_map"].T @ rng.normal(0.0, [0.03] * 3 + [1.0] * 3)
    if rng.random() < 0.5:
        noise = 10.0 ** rng.uniform(-14, -4)
        jacobian[:, one] += 0.05 * noise * rng.standard_normal(len(jacobian))
    draft["hand_jacobian"] = jacobian
    for name in ("torque_min", "torque_max"):
        value = draft[name].copy()
        value[[one, other]] = draft.torques()[[one, other]]
        draft[name] = value


def _coincident(draft: Draft) -> None:
    """Contacts at one place, which feel the same."""
    one, other = draft.rng.choice(draft.contacts, 2, replace=False)
    to, source = slice(3 * one, 3 * one + 3), slice(3 * other, 3 * other + 3)
    for name, axis in (("grasp_map", 1), ("hand_jacobian", 0)):
        array = np.moveaxis(draft[name].copy(), axis, 0)
        array[to] = array[source]
        draft[name] = np.moveaxis(array, 0, axis)
    draft.proper = draft.proper and _rank(draft["grasp_map"]) == 6


def _rank(grasp_map: Any) -> int:
    return int(np.linalg.matrix_rank(grasp_map, tol=1e-6 * np.abs(grasp_map).max()))


def _mixed_friction(draft: Draft) -> None:
    draft["friction"] = draft.rng.choice(_FRICTION, draft.contacts)


def _caps_are_preloads(draft: Draft) -> None:
    chosen = draft.rng.random(draft.contacts) < draft.rng.choice([0.4, 1.0])
    normal = np.maximum(draft.forces[2::3], 0.0) * draft.rng.choice([1.0, 1.0, 3.0])
    draft["normal_min"] = np.where(chosen, normal, draft["normal_min"])
    draft["normal_max"] = np.where(chosen, normal, np.maximum(draft["normal_max"], normal))


def _load(draft: Draft) -> None:
    size = draft.rng.choice([0.0, 1e-160, *10.0 ** draft.rng.uniform(-9, 9, 6)])
    draft["external_wrench"] = draft["external_wrench"] * size
    draft.proper = draft.proper and size != 1e-160
    if draft.rng.random() < 0.7:
        draft["normal_min"] = np.zeros(draft.contacts)


def _length(draft: Draft) -> None:
    """Another unit of length."""
    unit = 10.0 ** draft.rng.uniform(-6, 6)
    rows = np.repeat([1.0, unit], 3)
    draft["grasp_map"] = draft["grasp_map"] * rows[:, None]
    draft["external_wrench"] = draft["external_wrench"] * rows
    for name in ("hand_jacobian", "torque_min", "torque_max", "external_torque"):
        draft[name] = draft[name] * unit


def _unit_of_force(draft: Draft) -> None:
    unit = 10.0 ** draft.rng.uniform(-6, 6)
    draft.forces = unit * draft.forces
    for name in (
        *("torque_min", "torque_max", "external_torque"),
        *("external_wrench", "normal_min", "normal_max"),
    ):
        draft[name] = draft[name] * unit


def _extreme_entries(draft: Draft) -> None:
    """Numbers whose squares overflow, or vanish."""
    rng = draft.rng
    name = rng.choice(["grasp_map", "hand_jacobian", "external_wrench", "torque_max", "normal_max"])
    number = rng.choice([1e200, 1e-160, 1e300, 1e-310, 1e155])
    array = draft[name].copy()
    if array.size and rng.random() < 0.5:
        array.flat[rng.integers(array.size)] = number
    else:
        array = array * number
    draft[name] = array
    draft.proper = False


def _nearly_singular(draft: Draft) -> None:
    """A grasp map that has all but lost its rank."""
    left, values, right = np.linalg.svd(draft["grasp_map"], full_matrices=False)
    values[-1] = values[0] * 10.0 ** draft.rng.uniform(-12, -3)
    draft["grasp_map"] = (left * values) @ right
    if draft.rng.random() < 0.7:
        draft.solved()
    draft.proper = draft.proper and values[-1] > 1e-7 * values[0]


def _free_joints(draft: Draft) -> None:
    """Limits that are missing, on one side or both."""
    for name, number in (("torque_min", -np.inf), ("torque_max", np.inf)):
        draft[name] = np.where(draft.rng.random(draft.joints) < 0.6, number, draft[name])


def _uncapped(draft: Draft) -> None:
    draft["normal_max"] = np.full(draft.contacts, np.inf)


def _edge(draft: Draft) -> None:
    """Forces that alone keep all constraints, or all but alone."""
    draft.solved()
    torque, room = draft.torques(), 10.0 ** draft.rng.uniform(-12, -2)
    draft.proper = draft.proper and room > 1e-7  # what numbers can still tell apart
    draft["torque_min"], draft["torque_max"] = torque - room, torque + room
    normal = draft.forces[2::3]
    draft["normal_min"] = np.maximum(normal - room, 0.0)
    draft["normal_max"] = np.maximum(normal + room, 0.0)


def _too_few(draft: Draft) -> None:
    """One contact or two, which cannot balance every wrench."""
    draft.proper, kept = False, int(draft.rng.integers(1, 3))
    for name in ("friction", "normal_min", "normal_max", "contact_mask"):
        draft[name] = draft[name][:kept]
    draft["grasp_map"] = draft["grasp_map"][:, : 3 * kept]
    draft["hand_jacobian"] = draft["hand_jacobian"][: 3 * kept]


Twist = Callable[[Draft], None]

TWISTS: tuple[Twist, ...] = (
    _pin,
    _nearly_pin,
    _redundant,
    _coincident,
    _mixed_friction,
    _caps_are_preloads,
    _load,
    _length,
    _unit_of_force,
    _extreme_entries,
    _nearly_singular,
    _free_joints,
    _uncapped,
    _edge,
    _too_few,
)


def name_of(change: Callable[..., Any]) -> str:
    """Of a function, for people."""
    return change.__name__.strip("_").replace("_", " ")


def draft(
    rng: np.random.Generator,
    objective: str,
    most_contacts: int = 200,
    twists: Sequence[Twist] | None = None,
) -> Draft:
    """A problem, not made yet, with these twists or some that are drawn."""
    contacts = int(
        rng.choice([3, 4, 4, 5, 6, 8, 12, 40, 200], p=[0.2, *[0.14] * 5, 0.08, 0.015, 0.005])
    )
    joints = int(rng.choice([0, 1, 2, 8, 8, 8, 15, 30]))
    base = random_problem(rng, min(contacts, most_contacts), objective=objective)
    fields = {name: value for name, value in vars(base).items() if value is not None}
    jacobian = base.hand_jacobian
    if joints != base.n_joints:
        more = 0.05 * rng.standard_normal((len(jacobian), joints))
        more[rng.random(more.shape) < 0.5] = 0.0
        fields["hand_jacobian"] = np.hstack([jacobian[:, : min(joints, 8)], more])[:, :joints]
        limit = rng.uniform(0.5, 2.0, (2, joints))
        fields["torque_min"], fields["torque_max"] = -limit[0], limit[1]
        fields["external_torque"] = rng.uniform(-0.05, 0.05, joints)
    result = Draft(rng, fields, forces_in_cones(rng, base))
    if rng.random() < 0.6:
        result.solved()
    if twists is None:
        chosen = np.sort(rng.choice(len(TWISTS), rng.integers(1, 4), replace=False))
        twists = [TWISTS[index] for index in chosen]
    for twist in twists:
        twist(result)
        result.twists.append(name_of(twist))
    return result


def made(draft_: Draft) -> GraspForceProblem:
    """The problem of a draft; a refusal of what is proper is wrong."""
    try:
        return GraspForceProblem(**draft_.fields)
    except ProblemError as error:
        if draft_.proper:
            raise WrongAnswer(f"a proper problem ({draft_.twists}) is refused: {error}") from error
        raise


def prepare() -> None:
    """Compile the kernels and load the networks."""
    rng = np.random.default_rng(0)
    for objective in OBJECTIVES:
        for name in EXACT:
            if objective in make_solver(name).objectives:
                solve(random_problem(rng, 4, objective=objective), name)


def try_exact(rng: np.random.Generator) -> str:
    """A problem of one solver that must settle it as Clarabel does."""
    return _tried(rng, EXACT, (0.5, 0.2, 0.1, 0.1, 0.1), settles=True)


def try_any(rng: np.random.Generator) -> str:
    """A problem of a solver that may fail, but may not be wrong."""
    return _tried(rng, OTHERS, (0.1, 0.1, 0.1, 0.35, 0.35), settles=False)


def _tried(
    rng: np.random.Generator, names: tuple[str, ...], chances: tuple[float, ...], *, settles: bool
) -> str:
    name = str(rng.choice(names, p=chances))
    settings = {"iterations": 20} if name == "instance_network" else {}
    solver = make_solver(name, **settings)
    drafted = draft(rng, str(rng.choice(solver.objectives)), 200 if settles else 8)
    tell(f"{name}, {drafted['objective']}, {drafted.contacts} contacts, {drafted.twists}")
    return answered(solver, drafted, settles=settles)


def answered(solver: Solver, drafted: Draft, *, settles: bool = True) -> str:
    """Solve a problem; what is wrong with the answer, or with its refusal, is raised."""
    problem = made(drafted)
    answer = solver.solve(problem)
    broken = broken_promises(problem, answer)
    if broken:
        raise WrongAnswer(broken[0])
    return compared(problem, solver, answer, settles=settles and drafted.proper)


def compared(problem: GraspForceProblem, solver: Solver, answer: Any, *, settles: bool) -> str:
    """Hold an answer that keeps its promises against what Clarabel settles.

    Forces that keep all constraints, and proofs that there are none, are known exactly by now: at
    the edge between them Clarabel, which has tolerances, may see the other side.
    """
    known, status = truth(problem), str(answer.status)
    if known.status == "unknown":
        return f"{status}, nothing known"
    if known.status == status == "optimal":
        allowed = _OBJECTIVE_ERROR if isinstance(solver, _SHARP) else _GAP
        # where prices are enormous, what Clarabel misses makes it fall below what is proven
        best = max(known.objective, float(answer.dual_bound))
        error = abs(float(answer.objective) - best)
        if error > allowed * abs(best) + known.accuracy:
            share = error / max(abs(best), known.accuracy)
            raise WrongAnswer(f"optimal, and {share:.1e} from Clarabel's optimum")
    if settles and status in ("failed", "feasible"):
        raise WrongAnswer(
            f"{status} (gap {float(answer.gap):.1e}, {str(answer.message)!r}), and Clarabel "
            f"finds it {known.status}"
        )
    return f"{status}, as Clarabel says"


def try_quality(rng: np.random.Generator) -> str:
    """A problem of quality: the budget may be too small, effort may have a price."""
    name = str(rng.choice(QUALITY))
    drafted = draft(rng, "sum_normal", int(rng.choice([8, 64], p=[0.9, 0.1])))
    least = truth(made(drafted)).objective
    drafted["objective"] = MAX_QUALITY
    budget = float(rng.choice([0.5, 1.0, 1.01, 2.0, 10.0])) * (least if least > 0 else 10.0)
    drafted["effort_budget"] = budget
    drafted["characteristic_length"] = float(rng.choice([0.04, 1e-6, 1e6]))
    drafted["effort_weight"] = float(rng.choice([0.0, 0.01, 1.0]))
    tell(f"{name}, {drafted.contacts} contacts, {drafted.twists}")
    problem = made(drafted)
    answer = make_solver(name).solve(problem)
    broken = broken_promises(problem, answer)
    if broken:
        raise WrongAnswer(broken[0])
    idle = bool(answer.verdict.quality_lower == 0) and answer.objective > 1e-9 * budget
    if str(answer.status) == "feasible" and idle and not problem.external_wrench.any():
        torque, zero = problem.external_torque, problem.normal_min.any()
        held = ((problem.torque_min <= torque) & (torque <= problem.torque_max)).all()
        if held and not zero:
            raise WrongAnswer(f"effort of {float(answer.objective):.1e} where none is better")
    return str(answer.status)


def try_batch(rng: np.random.Generator, name: str | None = None) -> str:
    """Batches of none, of one, of several dimensions: answers are those of single problems."""
    name = name or str(rng.choice([*EXACT, "pseudoinverse", "equal_squeeze"]))
    solver = make_solver(name)
    objective = str(rng.choice(solver.objectives))
    shape = [(0,), (2, 0), (1,), (2, 2), (0, 3)][rng.integers(5)]
    count = int(np.prod(shape))
    contacts = int(rng.integers(3, 7))
    problems = [random_problem(rng, contacts, objective=objective) for _ in range(max(count, 1))]
    if rng.random() < 0.3:
        empty = {"hand_jacobian": np.zeros((3 * contacts, 0))}
        empty |= dict.fromkeys(("torque_min", "torque_max", "external_torque"), np.zeros(0))
        problems = [problem.replace(**empty) for problem in problems]
    if count:
        batch = GraspForceProblem.stack(problems).reshape(*shape)
    else:
        batch = problems[0].replace(external_wrench=np.zeros((*shape, 6)))
    tell(f"{name}, {objective}, batch {shape}")
    answer = solver.solve(batch)
    if answer.forces.shape != (*shape, 3 * contacts) or answer.status.shape != shape:
        raise WrongAnswer(f"forces of shape {answer.forces.shape}")
    for index in np.ndindex(*shape):
        broken = broken_promises(batch, answer, index)
        if broken:
            raise WrongAnswer(broken[0])
        if str(solver.solve(batch[index]).status) != str(answer.status[index]):
            raise WrongAnswer(f"the status at {index} is another one alone")
    return "alike"
