"""The learned solver: one network for all grasps, whose answers are repaired, proven or passed on.

The network (`solvers.network`) proposes multipliers; `solvers.polish` can improve them;
`solvers.repair` turns them into forces that satisfy every constraint; what is left over goes to an
exact solver. Like every answer, this one is judged by its constraints and its dual bound, so that a
poor guess shows as a large gap or as `failed`, never as a wrong certificate.

The shipped weights were made by

    python scripts/train.py --grasps train.npz --output runs/conditioned --seed 0

on grasps from `python scripts/collect.py --grasps 10000 --output train.npz`; the file's metadata
says the rest.
"""

import dataclasses
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from .base import Solver
from .canonical import CanonicalProblem, canonical
from .certificates import Multipliers, farkas_value, usable
from .exceptions import SolverError
from .flow import best_iterate
from .infeasibility import recession, relaxed
from .judge import FARKAS_TOLERANCE
from .network import ConditionedKktNetwork
from .network_file import load_network
from .polish import polished
from .problem import GraspForceProblem
from .registry import available_solvers, make_solver
from .repair import corrected_forces, is_feasible, shrunk_forces, tightened
from .solution import Candidate

DEFAULT_WEIGHTS = Path(__file__).parent / "weights" / "conditioned.safetensors"

_TIGHTER = (0.1, 0.03, 0.01, 1e-3, 1e-4)
"""By how much the constraints are tightened, in turn, in the search for forces in the interior."""

_WIDER = (0.0, 0.03, 0.1, 0.01, 0.3, 1e-3)
"""By how much they are relaxed, in turn, in the search for a proof that there are none."""

_NO_ANSWER = "neither feasible forces nor a proof of infeasibility; polish, or allow a fallback"

_CHUNK = 4096
"""Problems per call of the network, which bounds the memory."""

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


class ConditionedSolver(Solver):
    """Network, Newton steps, repair, fallback.

    Args:
        polish_steps: Newton steps on the dual after the network, in float64. With none, the
            network alone is seen; four cost next to nothing and bring most gaps to rounding.
        fallback: name of the solver for the problems that end neither feasible nor proven
            infeasible; None leaves them `failed`.
        weights: file of `scripts/train.py`, or a network; the shipped weights by default.

    Raises:
        SolverError: for a negative number of steps, an unknown fallback, or unusable weights.
    """

    objectives = ("min_norm",)

    def __init__(
        self,
        polish_steps: int = 4,
        fallback: str | None = "clarabel",
        weights: str | Path | ConditionedKktNetwork | None = None,
    ) -> None:
        if polish_steps < 0:
            raise SolverError(f"polish_steps is {polish_steps}; it cannot be negative")
        if fallback is not None and fallback not in available_solvers():
            raise SolverError(
                f"the fallback {fallback!r} is no solver; choose one of "
                f"{', '.join(available_solvers())}, or None"
            )
        self._polish_steps = polish_steps
        self._fallback = None if fallback is None else make_solver(fallback)
        if isinstance(weights, ConditionedKktNetwork):
            self._network = weights.eval()
        else:
            self._network = load_network(DEFAULT_WEIGHTS if weights is None else Path(weights))

    def propose(self, problem: GraspForceProblem) -> Candidate:
        """Forces and multipliers of a batch; see the class."""
        form = canonical(problem)
        guess = self._multipliers(form)
        forces, feasible = self._forces(form, guess)
        multipliers, proven = self._prove(problem, form, guess, ~feasible)
        candidate = Candidate(
            forces=form.scale[..., None] * forces,
            multipliers=multipliers,
            message=np.where(feasible | proven, "", _NO_ANSWER),
        )
        return self._fall_back(problem, candidate, np.flatnonzero(~feasible & ~proven))

    def _multipliers(self, form: CanonicalProblem) -> Multipliers:
        """(B, .) the network's best iterates, polished; canonical units, float64."""
        nu = np.zeros_like(form.problem.external_wrench)
        price = np.zeros_like(form.problem.torque_min)
        for start in range(0, len(form.problem), _CHUNK):
            rows = slice(start, start + _CHUNK)
            part = form[rows]
            tensors = part.problem.to_torch(dtype=torch.float32)
            with torch.inference_mode():
                iterates = self._network(dataclasses.replace(part, problem=tensors))
                best = best_iterate(tensors, iterates)
            nu[rows], price[rows] = best.equilibrium.numpy(), best.torque.numpy()
        guess = usable(form.problem, Multipliers(nu, price))
        return polished(form.problem, guess, self._polish_steps)

    def _forces(self, form: CanonicalProblem, guess: Multipliers) -> tuple[Array, Mask]:
        """(B, 3n) forces in canonical units, and which of them satisfy every constraint."""
        forces = corrected_forces(form.problem, guess)
        feasible = is_feasible(form.problem, forces)
        for delta in _TIGHTER:
            rows = np.flatnonzero(~feasible)
            if not len(rows):
                break
            here = form[rows]
            inner = tightened(here, delta)
            interior = corrected_forces(inner.problem, self._multipliers(inner))
            found = is_feasible(here.problem, interior)
            shrunk = shrunk_forces(here.problem, forces[rows], interior)
            forces[rows[found]] = shrunk[found]
            feasible[rows[found]] = True
        return forces, feasible

    def _prove(
        self, problem: GraspForceProblem, form: CanonicalProblem, guess: Multipliers, wanted: Mask
    ) -> tuple[Multipliers, Mask]:
        """(B, .) the guess in original units, proofs in its place where they hold; (B,) where."""
        multipliers = form.multipliers(guess)
        proven = np.zeros_like(wanted)

        def accept(rows: NDArray[np.intp], scaled: Multipliers) -> None:
            proof = usable(problem[rows], form[rows].multipliers(scaled))
            holds = farkas_value(problem[rows], proof) > FARKAS_TOLERANCE
            multipliers.equilibrium[rows[holds]] = proof.equilibrium[holds]
            multipliers.torque[rows[holds]] = proof.torque[holds]
            proven[rows[holds]] = True

        for delta in _WIDER:
            rows = np.flatnonzero(wanted & ~proven)
            if not len(rows):
                break
            wider = relaxed(form[rows], delta)
            there = self._multipliers(wider)
            for proof in (there, recession(wider.problem, there)):
                accept(rows, proof)
        return multipliers, proven

    def _fall_back(
        self, problem: GraspForceProblem, candidate: Candidate, rows: NDArray[np.intp]
    ) -> Candidate:
        """The candidate with the answers of the exact solver in the rows that have none."""
        if self._fallback is None or not len(rows):
            return candidate
        exact = self._fallback.propose(problem[rows])
        candidate.forces[rows] = exact.forces
        candidate.multipliers.equilibrium[rows] = exact.multipliers.equilibrium
        candidate.multipliers.torque[rows] = exact.multipliers.torque
        message = candidate.message.astype(object)
        message[rows] = exact.message
        return dataclasses.replace(candidate, message=message.astype(np.str_))
