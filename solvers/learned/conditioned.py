"""The learned solver: one network for all grasps, whose answers are repaired, proven or passed on.

The network (`solvers.learned.network`) proposes multipliers; `solvers.exact.polish` improves them;
`solvers.solution.repair` turns them into forces that satisfy every constraint; what has no answer
then, or one whose certified gap is too large, goes to an exact solver. Every stage but the network
can be switched off. Like every answer, this one is judged by its constraints and its dual bound, so
that a poor guess shows as a large gap or as `failed`, never as a wrong certificate.

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

from solvers.arguments import real_number, whole_number
from solvers.arrays import Array, Mask
from solvers.base import Solver
from solvers.duality import (
    contact_duals,
    dual_bound,
    farkas_value,
    project_cones,
    recession_direction,
    relaxed,
    usable,
)
from solvers.exact.polish import polished
from solvers.exceptions import SolverError
from solvers.judge import EQUILIBRIUM_TOLERANCE, FARKAS_TOLERANCE, GAP_TOLERANCE, Status, judge
from solvers.kkt.multiplier_flow import best_iterate
from solvers.problem import (
    CanonicalProblem,
    GraspForceProblem,
    Multipliers,
    apply_transposed,
    canonical,
    needs_no_force,
)
from solvers.registry import available_solvers, make_solver
from solvers.solution import (
    Candidate,
    corrected_forces,
    is_balanced,
    is_feasible,
    shrunk_forces,
    tightened,
)

from .files import load_network, weights_path
from .network import ConditionedKktNetwork

DEFAULT_WEIGHTS = Path(__file__).parents[1] / "weights" / "conditioned.safetensors"

_TIGHTER = (0.1, 0.03, 0.01, 1e-3, 1e-4)
"""By how much the constraints are tightened, in turn, in the search for forces in the interior."""

_WIDER = (0.0, 0.03, 0.1, 0.01, 0.3, 1e-3)
"""By how much they are relaxed, in turn, in the search for a proof that there are none."""

_SLIGHTLY = 5e-11
"""By how much the constraints are tightened for the answer itself, so that rounding breaks none."""

_NO_ANSWER = "neither feasible forces nor a proof of infeasibility; polish, or allow a fallback"

_CHUNK = 4096
"""Problems per call of the network, which bounds the memory."""


class ConditionedSolver(Solver):
    """Network, Newton steps, repair, fallback.

    Args:
        polish_steps: Newton steps on the dual after the network, in float64. With none, the
            network alone is seen; four cost next to nothing and bring most gaps to rounding.
        repair: whether forces that miss a constraint are moved until they satisfy it, and proofs of
            infeasibility are looked for. Without, the forces are those that the multipliers price
            best, which are in equilibrium only as far as the multipliers are exact.
        tolerance: largest certified relative gap of a finished answer; all others go to the
            fallback, and infinity sends only those without an answer there.
        fallback: name of the solver for what is not finished. Its answer is taken where it is
            better, and not where it fails, too. None leaves feasible answers with the gap they
            have, and all others `failed`.
        weights: file of `scripts/train.py`, or a network; the shipped weights by default.

    Raises:
        SolverError: for steps that are no whole number of 0 or more, a repair that is not True or
            False, a tolerance that is not positive, an unknown fallback, or unusable weights.
    """

    objectives = ("min_norm",)

    def __init__(
        self,
        polish_steps: int = 4,
        repair: bool = True,
        tolerance: float = GAP_TOLERANCE,
        fallback: str | None = "dual_newton",
        weights: str | Path | ConditionedKktNetwork | None = None,
    ) -> None:
        if not isinstance(repair, bool):
            raise SolverError(f"repair must be True or False, not {repair!r}")
        if fallback is not None and fallback not in available_solvers():
            raise SolverError(
                f"the fallback {fallback!r} is no solver; choose one of "
                f"{', '.join(available_solvers())}, or None"
            )
        self._polish_steps = whole_number("polish_steps", polish_steps, 0)
        self._repair = repair
        self._tolerance = real_number("tolerance", tolerance, 0.0, np.inf, closed=True)
        self._fallback = None if fallback is None else make_solver(fallback)
        if isinstance(weights, ConditionedKktNetwork):
            self._network = weights.eval()
        else:
            path = weights_path(weights, DEFAULT_WEIGHTS)
            self._network = load_network(path, ConditionedKktNetwork)

    def propose(self, problem: GraspForceProblem) -> Candidate:
        """Forces and multipliers of a batch; see the class."""
        form = canonical(problem)
        inner = tightened(form, _SLIGHTLY)
        guess = self._multipliers(inner)
        if self._repair:
            forces, feasible = self._forces(form, inner, guess)
            multipliers, proven = self._prove(problem, form, guess, ~feasible)
        else:
            forces, feasible = _priced_forces(form, inner, guess)
            multipliers, proven = form.multipliers(guess), np.zeros_like(feasible)
        idle = needs_no_force(problem)
        for array in (forces, multipliers.equilibrium, multipliers.torque):
            array[idle] = 0.0
        feasible |= idle
        value = 0.5 * np.sum(forces**2, axis=-1)
        bound = dual_bound(form.problem, usable(form.problem, guess))
        finished = proven | idle | (feasible & (value - bound <= self._tolerance * value))
        candidate = Candidate(
            forces=form.scale[..., None] * forces,
            multipliers=multipliers,
            message=np.where(feasible | proven, "", _NO_ANSWER),
        )
        return self._fall_back(problem, candidate, np.flatnonzero(~finished))

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
        if self._polish_steps:
            guess = without_spurious_duals(form.problem, guess)
        return polished(form.problem, guess, self._polish_steps)

    def _forces(
        self, form: CanonicalProblem, inner: CanonicalProblem, guess: Multipliers
    ) -> tuple[Array, Mask]:
        """(B, 3n) forces in canonical units, and which of them satisfy every constraint.

        `inner` are the slightly tightened problems that the guess is for.
        """
        forces = corrected_forces(inner.problem, guess)
        feasible = is_feasible(form.problem, forces)
        for delta in _TIGHTER:
            rows = np.flatnonzero(~feasible)
            if not len(rows):
                break
            here = form[rows]
            tight = tightened(here, delta)
            interior = corrected_forces(tight.problem, self._multipliers(tight))
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
            for proof in (there, recession_direction(wider.problem, there)):
                accept(rows, proof)
        return multipliers, proven

    def _fall_back(
        self, problem: GraspForceProblem, candidate: Candidate, rows: NDArray[np.intp]
    ) -> Candidate:
        """The candidate with the answers of the exact solver in the rows where they are better."""
        if self._fallback is None or not len(rows):
            return candidate
        exact, verdict = self._fallback.judged(problem[rows].flat())
        mine = judge(problem[rows], candidate.forces[rows], candidate.multipliers[rows])
        failed = verdict.status == Status.FAILED.value
        # the gap of forces that are not feasible is NaN, and less than nothing
        better = ((mine.status == Status.FAILED.value) & ~failed) | (verdict.gap < mine.gap)
        rows, exact_rows = rows[better], np.flatnonzero(better)
        message = candidate.message.astype(object)
        candidate.forces[rows] = exact.forces[exact_rows]
        candidate.multipliers.equilibrium[rows] = exact.multipliers.equilibrium[exact_rows]
        candidate.multipliers.torque[rows] = exact.multipliers.torque[exact_rows]
        message[rows] = exact.message[exact_rows]
        return dataclasses.replace(candidate, message=message.astype(np.str_))


def without_spurious_duals(problem: GraspForceProblem, guess: Multipliers) -> Multipliers:
    """The guess with those torque prices set to zero that a step of the flow takes there.

    A price is spurious if it is smaller than the distance of the torque from its limit (both
    dimensionless): the proximal step of length one then ends at zero. A wrong nonzero price keeps
    its row in Newton's equation and costs steps. Of 2,083 feasible problems of objects kept out of
    training, 94 had a price in the shipped network's answer or in the exact one. They needed 1.86
    Newton steps to a relative dual gap of 1e-9 with this threshold, 2.14 without, and 1.97 with the
    best fixed one (prices below 0.001); one of 0.01 removes true prices and costs steps (2.25).

    Args:
        problem: canonical problems, float64 numpy, one batch dimension.
        guess: (B, 6) and (B, n_tau).
    """
    forces = project_cones(problem, -contact_duals(problem, guess))
    torque = apply_transposed(
        problem.hand_jacobian, forces.reshape(len(forces), 3 * problem.n_contacts)
    )
    price = guess.torque
    slack = np.where(price > 0, problem.torque_max - torque, torque - problem.torque_min)
    return Multipliers(guess.equilibrium, np.where(np.abs(price) < slack, 0.0, price))


def _priced_forces(
    form: CanonicalProblem, inner: CanonicalProblem, guess: Multipliers
) -> tuple[Array, Mask]:
    """(B, 3n) f^ = Pi_C(-q) as it is, and where it happens to satisfy every constraint."""
    prices = contact_duals(inner.problem, guess)
    forces = project_cones(inner.problem, -prices).reshape(len(prices), 3 * prices.shape[1])
    balanced = is_balanced(form.problem, forces, EQUILIBRIUM_TOLERANCE)
    return forces, balanced & is_feasible(form.problem, forces)
