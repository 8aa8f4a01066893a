"""The structured exact solver for many problems at once, on a GPU or any other torch device.

The concave dual of a `min_norm` problem has 6 + n_tau variables, whatever the number of contacts;
a semismooth Newton method with a line search on the dual value (`solvers.exact.torch_newton`)
maximises it for a whole batch in fixed-shape float64 operations. The host looks in only every few
iterations, to drop the problems that are finished: solved and checked against every constraint
(`solvers.exact.torch_finish`), or proven infeasible (`solvers.duality.recession`).

`solve_tensors` takes and returns tensors that never leave their device. On a CPU it is correct but
slow, about 0.25 ms a problem on one core in large batches: `dual_newton` is made for that.
"""

import dataclasses
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from solvers.arguments import real_number
from solvers.base import Solver
from solvers.duality import recession_direction, relaxed
from solvers.exceptions import SolverError
from solvers.judge import GAP_TOLERANCE, Status
from solvers.problem import (
    CanonicalProblem,
    GraspForceProblem,
    Multipliers,
    as_problem,
    canonical,
    needs_no_force,
)
from solvers.solution import Candidate

from .torch_finish import FinishedForces, finished_forces
from .torch_newton import (
    Direction,
    Point,
    ascent_step,
    cholesky_qr,
    cold_start,
    direction,
    evaluate_dual,
    given_torques,
    tightened,
)
from .torch_verdict import proofs, proven_bound

STATUS_CODES = tuple(Status)
"""Status of a code in `TensorSolution.status`."""

_CHECKS = (5, 7, 10, 14, 20)
_LATE_CHECKS = (20, 30, 40, 60, 80)
"""After how many Newton steps the host asks what is finished; the few problems that are not after
the last of the first row start again, together, by the second."""

_FIRST_PROOF = 7
"""Steps after which a check also looks for proofs of infeasibility."""

_COMPACT = 0.8
"""Share of a batch still open below which the finished problems are dropped from it."""

_STUCK = 1e-2
_LATE_STUCK = 1e-6
"""Residuals above these, at first and of the few that start again, may mean that there are no
forces: worth a look for a proof."""

_MARGIN = 1e-3
_WIDER = (0.03, 0.1, 0.01, 0.3)
"""By how much the constraints are relaxed to prove infeasibility: at once, and in turn at last."""

_LARGEST_CHUNK = 65536
_CHUNK = {"cpu": 2048}
"""Problems at once; on a CPU, as many as stay in its cache."""

_NO_ANSWER = "neither the forces nor a proof passed its own test; use the solver 'dual_newton'"


@dataclass(frozen=True, eq=False)
class TensorSolution:
    """Answers as tensors on the problem's device; all arrays are float64 but the status.

    Args:
        forces: (..., 3n) N; NaN where infeasible, the last attempt where failed.
        equilibrium_dual: (..., 6) nu; with lambda a Farkas vector where infeasible.
        torque_dual: (..., n_tau) lambda.
        objective: (...,) N^2; NaN unless the forces are feasible.
        dual_bound: (...,) N^2, a proven lower bound on the optimum.
        gap: (...,) (objective - dual_bound) / objective; NaN unless the forces are feasible.
        status: (...,) int8, indices into `STATUS_CODES`: what `solvers.judge.judge` says of these
            forces and multipliers.
    """

    forces: Tensor
    equilibrium_dual: Tensor
    torque_dual: Tensor
    objective: Tensor
    dual_bound: Tensor
    gap: Tensor
    status: Tensor

    def is_status(self, status: Status) -> Tensor:
        """(...,) bool, where this is the status."""
        return self.status == STATUS_CODES.index(status)


class DualNewtonTorchSolver(Solver):
    """Semismooth Newton on the dual, batched on a torch device.

    Args:
        device: torch's name of it, "cuda:0" say; a GPU if there is one, else the CPU.
        tolerance: relative gap at which a problem counts as finished.

    Raises:
        SolverError: for a device that torch does not know, or a tolerance not between 0 and 1.
    """

    objectives = ("min_norm",)

    def __init__(self, device: str | None = None, tolerance: float = 1e-12) -> None:
        _check_tolerance(tolerance)
        try:
            found = torch.device(device or ("cuda" if torch.cuda.is_available() else "cpu"))
        except (RuntimeError, TypeError) as error:
            raise SolverError(f"torch knows no device {device!r}: {error}") from error
        self._device = found
        self._tolerance = tolerance

    def propose(self, problem: GraspForceProblem) -> Candidate:
        """Forces and multipliers of a batch; see the class."""
        tensors = problem.to_torch(device=self._device)
        solution = solve_tensors(tensors, tolerance=self._tolerance)
        failed = solution.is_status(Status.FAILED).tolist()
        return Candidate(
            forces=solution.forces.cpu().numpy(),
            multipliers=Multipliers(
                solution.equilibrium_dual.cpu().numpy(), solution.torque_dual.cpu().numpy()
            ),
            message=np.array([_NO_ANSWER if bad else "" for bad in failed], dtype=np.str_),
        )


@torch.no_grad()
def solve_tensors(problem: GraspForceProblem, tolerance: float = 1e-12) -> TensorSolution:
    """Solve `min_norm` problems of float64 tensors on whatever device they lie.

    Nothing is copied to the host but the number of problems that are still open, now and then. No
    gradients flow; `solvers.differentiable` has them.

    Args:
        problem: single or batched.
        tolerance: relative gap at which a problem counts as finished.

    Raises:
        SolverError: for other arrays, another data type, another objective, or a tolerance that
            is not between 0 and 1.
    """
    _check_tolerance(tolerance)
    grasp_map = as_problem(problem).grasp_map
    if not isinstance(grasp_map, Tensor) or grasp_map.dtype != torch.float64:
        raise SolverError("solve_tensors takes float64 tensors: call problem.to_torch() first")
    if problem.objective != "min_norm":
        raise SolverError(f"solve_tensors solves min_norm, not {problem.objective}")
    flat = problem.reshape(-1)
    answers = _Results(flat, tolerance)
    everything = torch.arange(len(flat), device=flat.friction.device)
    for rows in everything.split(_CHUNK.get(flat.friction.device.type, _LARGEST_CHUNK)):
        _climb(answers, _Open.at_start(flat, rows), _CHECKS, _STUCK)
    late = torch.nonzero(answers.open(everything))[:, 0]
    if len(late):
        work = _Open.at_start(flat, late)
        _prove_relaxed(answers, _climb(answers, work, _LATE_CHECKS, _LATE_STUCK))
    return answers.solution(flat, problem.batch_shape)


@dataclass(frozen=True, eq=False)
class _Open:
    """The problems that are not finished: `rows` says which of the batch they are."""

    rows: Tensor
    problem: GraspForceProblem
    form: CanonicalProblem
    inner: GraspForceProblem
    here: Point

    @classmethod
    def at_start(cls, batch: GraspForceProblem, rows: Tensor) -> "_Open":
        problem = batch[rows]
        form = canonical(problem, cholesky_qr)
        inner = tightened(form.problem)
        return cls(rows, problem, form, inner, evaluate_dual(inner, cold_start(inner)))

    def __getitem__(self, index: Tensor) -> "_Open":
        return _Open(*(part[index] for part in vars(self).values()))


class _Results:
    """The best answers so far of a whole batch; where zero forces hold, they are the optimum."""

    def __init__(self, problem: GraspForceProblem, tolerance: float) -> None:
        idle = needs_no_force(problem)

        def filled(*shape: int, otherwise: float) -> Tensor:
            array = problem.friction.new_full((len(problem), *shape), otherwise)
            return array.masked_fill(idle.reshape(-1, *[1] * len(shape)), 0.0)

        self.forces = filled(3 * problem.n_contacts, otherwise=torch.nan)
        self.equilibrium = filled(6, otherwise=torch.nan)
        self.torque = filled(problem.n_joints, otherwise=torch.nan)
        self.objective = filled(otherwise=torch.nan)
        self.dual_bound = filled(otherwise=-torch.inf)
        self.gap = filled(otherwise=torch.inf)
        self.exact = idle.clone()
        self.converged = idle
        self.proven = torch.zeros_like(idle)
        self._tolerance = tolerance

    def open(self, rows: Tensor) -> Tensor:
        """(R,) bool, True where nothing is final yet."""
        return ~self.converged[rows] & ~self.proven[rows]

    def unsolved(self, rows: Tensor) -> Tensor:
        """(R,) bool, True where there are neither feasible forces nor a proof."""
        return torch.isinf(self.gap[rows]) & ~self.proven[rows]

    def offer(self, rows: Tensor, new: FinishedForces) -> None:
        """Keep an answer where its gap is smaller, or where there is none as exact so far."""
        exact = self.exact[rows]
        better = (new.exact == exact) & (new.gap < self.gap[rows])
        better = better | (new.exact & ~exact) | self.unsolved(rows)

        def keep(old: Tensor, fresh: Tensor) -> None:
            chosen = better.reshape(-1, *[1] * (fresh.ndim - 1))
            old[rows] = torch.where(chosen, fresh, old[rows])

        keep(self.forces, new.forces)
        keep(self.equilibrium, new.multipliers.equilibrium)
        keep(self.torque, new.multipliers.torque)
        keep(self.objective, new.objective)
        keep(self.dual_bound, new.dual_bound)
        keep(self.gap, new.gap)
        keep(self.exact, new.exact)
        done = new.distance <= self._tolerance
        self.converged[rows] = self.converged[rows] | done

    def accept_proofs(self, work: _Open, scaled: Multipliers) -> None:
        """Keep multipliers (canonical units) where they prove that there are no forces."""
        proof, holds = proofs(work.problem, work.form.multipliers(scaled))
        rows = work.rows
        holds = holds & self.unsolved(rows)
        self.proven[rows] = self.proven[rows] | holds
        for old, fresh in ((self.equilibrium, proof.equilibrium), (self.torque, proof.torque)):
            old[rows] = torch.where(holds[:, None], fresh, old[rows])

    def solution(self, problem: GraspForceProblem, shape: tuple[int, ...]) -> TensorSolution:
        """All answers, with their status, in batch dimensions of this shape."""
        multipliers = Multipliers(self.equilibrium, self.torque)
        proven = proofs(problem, multipliers)[1]
        bound = torch.where(proven, proven_bound(problem, multipliers), self.dual_bound)
        feasible = torch.isfinite(self.gap) & ~proven
        code = torch.full_like(proven, STATUS_CODES.index(Status.FAILED), dtype=torch.int8)
        for where, status in (
            (proven, Status.INFEASIBLE),
            (feasible, Status.FEASIBLE),
            (feasible & (self.gap.abs() <= GAP_TOLERANCE), Status.OPTIMAL),
        ):
            code = torch.where(where, STATUS_CODES.index(status), code)
        padding = ~problem.contact_mask.repeat_interleave(3, dim=-1)
        forces = torch.where(proven[:, None], torch.nan, self.forces)

        def shaped(array: Tensor) -> Tensor:
            return array.reshape((*shape, *array.shape[1:]))

        return TensorSolution(
            forces=shaped(torch.where(padding, 0.0, forces)),
            equilibrium_dual=shaped(self.equilibrium),
            torque_dual=shaped(self.torque),
            objective=shaped(torch.where(feasible, self.objective, torch.nan)),
            dual_bound=shaped(bound),
            gap=shaped(torch.where(feasible, self.gap, torch.nan)),
            status=shaped(code.to(torch.int8)),
        )


def _climb(answers: _Results, work: _Open, checks: tuple[int, ...], stuck: float) -> _Open:
    """Newton steps until the last of the checks, or until all is done; what is left then."""
    for iteration in range(checks[-1] + 1):
        ahead = direction(work.inner, work.here)
        if iteration in checks:
            answers.offer(work.rows, finished_forces(work.problem, work.form, work.here, ahead))
            if iteration >= _FIRST_PROOF:
                _prove(answers, work, ahead, stuck)
            still = torch.nonzero(answers.open(work.rows))[:, 0]
            if not len(still):
                break
            if len(still) < _COMPACT * len(work.rows):
                work, ahead = work[still], ahead[still]
        work = dataclasses.replace(work, here=ascent_step(work.inner, work.here, ahead))
    return work


def _prove(answers: _Results, work: _Open, ahead: Direction, stuck: float) -> None:
    """Test the multipliers where the residual is larger than `stuck` as proofs of infeasibility."""
    index = torch.nonzero((ahead.residual > stuck) & answers.unsolved(work.rows))[:, 0]
    if not len(index):
        return
    work = work[index]
    here, step = work.here.multipliers, ahead.step[index]
    # on the way to infinity the step is the direction in which the dual value grows
    leaves = (step[:, 6:] * here.torque < 0) & ~given_torques(work.inner)
    moved = torch.where(leaves, 0.0, step[:, 6:])
    ray = Multipliers(step[:, :6], moved)
    wider = relaxed(work.form, _MARGIN).problem
    for proof in (
        here,
        ray,
        recession_direction(wider, here),
        recession_direction(work.form.problem, ray),
    ):
        answers.accept_proofs(work, proof)


def _prove_relaxed(answers: _Results, work: _Open) -> None:
    """Look for proofs with the multipliers of relaxed problems, for the few that are left."""
    for delta in _WIDER:
        index = torch.nonzero(answers.unsolved(work.rows))[:, 0]
        if not len(index):
            return
        work = work[index]
        wider = relaxed(work.form, delta).problem
        here = evaluate_dual(wider, cold_start(wider))
        for _ in range(_CHECKS[-1]):
            here = ascent_step(wider, here, direction(wider, here))
        for proof in (here.multipliers, recession_direction(wider, here.multipliers)):
            answers.accept_proofs(work, proof)


def _check_tolerance(tolerance: float) -> None:
    real_number("tolerance", tolerance, 0.0, 1.0)
