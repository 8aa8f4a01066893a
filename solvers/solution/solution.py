"""The answer to a grasp force problem: forces with the certificate that the judge gave them."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from array_api_compat import is_torch_array

from solvers.exceptions import ProblemError
from solvers.judge import Verdict, judge_flat
from solvers.problem import MAX_QUALITY, GraspForceProblem, Multipliers, as_problem, residuals

if TYPE_CHECKING:
    from solvers.quality.proof import CoverProof


@dataclass(frozen=True, eq=False)
class Candidate:
    """What a solver proposes, before it is judged: float64 numpy arrays, batched like its problem.

    Args:
        forces: (..., 3n) N; NaN where the solver has none.
        multipliers: nu and lambda; NaN where the solver has none.
        message: (...,) strings, the solver's own words; "" where it has nothing to say.
        proofs: for `max_quality`: of each problem, see `solvers.quality.proof`.
    """

    forces: np.ndarray
    multipliers: Multipliers
    message: np.ndarray
    proofs: "tuple[tuple[CoverProof, ...], ...] | None" = None


def judge_candidate(problem: GraspForceProblem, candidate: Candidate) -> Verdict:
    """The judge's verdict on a candidate for a flat problem, see `GraspForceProblem.flat`.

    Raises:
        ProblemError: for what is no candidate, or one whose arrays have other shapes.
    """
    if not isinstance(candidate, Candidate):
        raise ProblemError(f"a Candidate must be given to judge, not {type(candidate).__name__}")
    if np.size(candidate.message) != math.prod(as_problem(problem).batch_shape):
        raise ProblemError(
            f"message has shape {np.shape(candidate.message)} but must have {problem.batch_shape}"
        )
    if problem.objective == MAX_QUALITY:
        # its proofs take Clarabel, numba and scipy, and seconds to load, for one objective
        from solvers.quality.verdict import judge_quality

        return judge_quality(problem, candidate.forces, candidate.multipliers, candidate.proofs)
    return judge_flat(problem, candidate.forces, candidate.multipliers)


@dataclass(frozen=True, eq=False)
class GraspForceSolution:
    """Forces, their certificate, and how well they do. Arrays are of the problem's kind and batch.

    The judge measures the solver's float64 answer; `forces` and all other arrays are that answer in
    the problem's data type. In float32 they can miss the constraints by 1e-7 of their size, which
    changes no verdict.

    Args:
        problem: the problem that was solved.
        forces: (..., 3n) N. Where `status` is `failed` these are the solver's last attempt and
            violate a constraint; where it is `infeasible` they mean nothing. NaN if there is none.
        status: (...,) numpy strings: `optimal`, `feasible`, `infeasible` or `failed`, decided by
            the judge and not by the solver; compare it with a string or a `Status`.
        objective: (...,) objective at the forces; NaN unless they are feasible.
        dual_bound: (...,) a proven lower bound on the optimum.
        gap: (...,) (objective - dual_bound) / |objective|, a proven bound on the relative loss; NaN
            unless the forces are feasible.
        equilibrium_dual: (..., 6) nu. Where `status` is `infeasible`, nu and lambda are the proof.
        torque_dual: (..., n_tau) lambda.
        message: (...,) numpy strings with the solver's explanation of a failure.
        verdict: every measurement of the judge, float64 numpy; for `max_quality` the interval of
            q_lrw among them.
    """

    problem: GraspForceProblem
    forces: Any
    status: np.ndarray
    objective: Any
    dual_bound: Any
    gap: Any
    equilibrium_dual: Any
    torque_dual: Any
    message: np.ndarray
    verdict: Verdict

    @classmethod
    def packed(cls, problem: GraspForceProblem, candidate: Candidate, verdict: Verdict) -> Self:
        """A judged candidate in the problem's batch dimensions and kind of array."""
        like, batch = problem.grasp_map, problem.batch_shape
        tensors = is_torch_array(like)

        def pack(array: np.ndarray, core: int = 0) -> Any:
            array = array.reshape(batch + array.shape[array.ndim - core :])
            if not tensors:
                return array.astype(like.dtype, copy=False)
            import torch

            return torch.tensor(array, dtype=like.dtype, device=like.device)

        return cls(
            problem=problem,
            forces=pack(candidate.forces, 1),
            status=verdict.status.reshape(batch),
            objective=pack(verdict.objective),
            dual_bound=pack(verdict.dual_bound),
            gap=pack(verdict.gap),
            equilibrium_dual=pack(candidate.multipliers.equilibrium, 1),
            torque_dual=pack(candidate.multipliers.torque, 1),
            message=np.asarray(candidate.message, dtype=np.str_).reshape(batch),
            verdict=verdict.reshaped(batch),
        )

    def equilibrium_residual(self) -> Any:
        """(...,) N: the smallest change of the forces that would make G f = -w hold."""
        return residuals.equilibrium_residual(self.problem, self.forces)

    def friction_violation(self) -> Any:
        """(...,) N: largest excess of a tangential force over its friction limit."""
        return residuals.friction_violation(self.problem, self.forces)

    def normal_violation(self) -> Any:
        """(...,) N: largest shortfall from the preload or excess over the cap."""
        return residuals.normal_violation(self.problem, self.forces)

    def torque_violation(self) -> Any:
        """(...,) N·m: largest excess of a joint torque over its limits."""
        return residuals.torque_violation(self.problem, self.forces)

    def joint_torques(self) -> Any:
        """(..., n_tau) N·m: J_h' f + tau_ext, the torques that realise the forces."""
        return residuals.joint_torques(self.problem, self.forces)
