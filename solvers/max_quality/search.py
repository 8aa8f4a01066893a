"""Forces of the highest quality, and a proof of how much better any others could be.

q_lrw of forces with normal components a is the least over wrench directions d of the largest
a_i h_i(d), h_i(d) how far contact i reaches in that direction per newton: neither convex nor
concave in a. But a contact's share alone decides whether it covers a direction, and there are few
contacts: branch and bound over who covers what (`solvers.compiled.quality.covering`) finds the best
shares for a set of directions and a polyhedron around the possible normal forces. Directions are
added where the forces found are weakest, cuts where they are not possible, until the bound meets
what is reached.
"""

from dataclasses import dataclass

import numpy as np

from solvers.arguments import real_number, whole_number
from solvers.arrays import Array
from solvers.base import Solver
from solvers.compiled.quality.covering import COVERED, PROVEN
from solvers.exact.chain import answered_in_turn
from solvers.exceptions import SolverError
from solvers.problem import MAX_QUALITY, GraspForceProblem
from solvers.quality.cuts import CutMultipliers, NormalForces, Ray
from solvers.quality.directions import spread_directions, weak_directions
from solvers.quality.friction_discs import support_bounds
from solvers.quality.proof import CoverProof, unit_discs
from solvers.quality.share_tree import ShareTree, share_thresholds
from solvers.quality.verdict import quality_bounds
from solvers.solution import Candidate

from .preload import effort, rounded_inwards, within, without_padding

_DIRECTIONS = 1024
_MOST_VISITS = 200_000
_CLIMBS = 20
_LEAST_RISE = 3e-3
_EDGES = 6

_INWARDS = 1e-7
"""Share of the normal forces that is given away, so that there is an inside."""

_ROOM = 1e-6
"""Share of the budget that is left where a cone program's tolerance exceeded it, for the last step
of every solver to move in."""

_LEAST_MORE = 1e-3
"""By how much the smallest budget that is searched exceeds the least effort, which may be none: it
is no smaller share of the whole budget, either."""

_MOST_BUDGETS = 24


@dataclass(frozen=True, eq=False)
class Bracket:
    """Forces and what is proven about their quality.

    Args:
        forces: (3n,) N, the best found.
        quality: N, lower bound of their q_lrw.
        proof: of the most that any forces have.
    """

    forces: Array
    quality: float
    proof: CoverProof

    def utility(self, weight: float) -> float:
        """N: quality less effort times `weight`."""
        return self.quality - weight * float(self.forces[2::3].sum())


class QualitySearch:
    """The search for one problem.

    Args:
        problem: one float64 numpy problem without padding, `max_quality`.
        tolerance: relative, between bound and quality, at which it ends.
        rounds: covers that are looked into at most, each by a conic program and often a hull.
        enough: N, a bound that need not be improved on.
    """

    def __init__(
        self, problem: GraspForceProblem, tolerance: float, rounds: int, enough: float = 0.0
    ) -> None:
        self.problem, self.tolerance, self.rounds, self.enough = problem, tolerance, rounds, enough
        self._set = NormalForces(problem)
        n = problem.n_contacts
        self._unit = unit_discs(problem)
        self._directions = [spread_directions(_DIRECTIONS)]
        self._thresholds = [share_thresholds(self._unit, *self._directions)]
        everyone = CutMultipliers(np.ones(n), np.zeros(6), np.zeros(problem.n_joints), 1.0)
        self._cuts = [everyone]
        self._ends = [float(problem.effort_budget)]
        self._forces, self._quality = np.full(3 * n, np.nan), 0.0

    def run(self) -> Bracket | None:
        """The bracket; None if no forces satisfy the constraints."""
        n = self.problem.n_contacts
        first = self._set.ray(np.ones(n))
        if first is None:
            return None
        self._forces = first.forces
        self._cut(first)
        for i in range(n):
            ray = self._set.ray(np.where(np.arange(n) == i, 1.0, 1e-9))
            if ray is not None:
                self._cut(ray)
        self._climb(first.forces)
        bound = self._search()
        proof = CoverProof(
            float(self.problem.effort_budget),
            bound,
            np.vstack(self._directions),
            tuple(self._cuts),
        )
        return Bracket(self._forces, self._quality, proof)

    def _search(self) -> float:
        """Branch and bound; the proven upper bound."""
        tree = ShareTree(self.problem.n_contacts)
        rounds = 0
        while tree.visited < _MOST_VISITS and not tree.full:
            floor = max(self._quality * (1.0 + self.tolerance), self.enough)
            outcome = tree.advance(
                np.vstack(self._thresholds),
                np.array([cut.prices for cut in self._cuts]),
                np.array(self._ends),
                floor,
            )
            if outcome.why == PROVEN:
                return floor
            if outcome.why == COVERED:
                if rounds == self.rounds:
                    break
                rounds += 1
                value = self._examine(tree.lower[outcome.node], outcome.value, floor)
                tree.push(outcome.node, value)
        return outcome.value

    def _examine(self, shares: Array, value: float, floor: float) -> float:
        """Make a cut, or find the directions that these shares leave uncovered; the new value."""
        ray = self._set.ray(np.maximum(shares, 1e-12 * shares.max()))
        if ray is None:
            return value
        if ray.end < value * (1.0 - 1e-6):
            self._cut(ray)
            value = ray.end
        if value > floor:
            normal = np.maximum(ray.forces[2::3], 1e-9 * self.problem.effort_budget)
            _, directions = weak_directions(self.problem, normal)
            least = self._unit.scaled(normal).support(directions).max(axis=1).min()
            self._add(directions)
            if least >= value * (1.0 - 0.5 * self.tolerance) or least > floor:
                before = self._quality
                self._measure(ray.forces)
                if self._quality > before * (1.0 + _LEAST_RISE):
                    self._climb(ray.forces)
        return value

    def _climb(self, forces: Array) -> None:
        """Ascend: who covers a direction goes on doing so, and all press as hard as allowed."""
        for _ in range(_CLIMBS):
            self._measure(forces)
            normal = np.maximum(forces[2::3], 0.0)
            thresholds = np.vstack(self._thresholds)
            reach = normal / thresholds
            owner = reach.argmax(axis=1)
            level = reach.max(axis=1).min()
            if level <= 0.0:
                return
            shares = np.zeros(len(normal))
            np.maximum.at(shares, owner, thresholds[np.arange(len(owner)), owner])
            ray = self._set.ray(shares)
            if ray is None:
                return
            self._cut(ray)
            if ray.length < level * (1.0 + _LEAST_RISE):
                return
            forces = ray.forces

    def _measure(self, forces: Array) -> None:
        """Learn the weakest directions of forces; keep the best forces."""
        normal = np.maximum(forces[2::3], 0.0)
        width = self.tolerance / 3.0
        pressing = normal > 1e-9 * normal.max()
        bounds = support_bounds(
            self._unit.scaled(normal)[pressing],
            _EDGES,
            lambda lower, upper: upper - lower <= width * upper,
        )
        self._add(bounds.directions)
        if bounds.lower > self._quality:
            self._forces, self._quality = forces, bounds.lower

    def _add(self, directions: Array) -> None:
        self._directions.append(directions)
        self._thresholds.append(share_thresholds(self._unit, directions))

    def _cut(self, ray: Ray) -> None:
        self._cuts.append(ray.cut)
        self._ends.append(ray.end)


class QualitySearchSolver(Solver):
    """Branch and bound over who resists what: nearly the best forces, and a bound that shows it.

    A second or two a problem and more, so for reference; `uniform_preload` is the quick way. With
    an effort weight smaller budgets are searched too, until the bound over all of them meets what
    is found. The memory of a search is bounded (`solvers.quality.share_tree`): with dozens of
    contacts it ends it before `rounds` do, with the bound that is proven by then.

    Args:
        tolerance: relative, between the bound and the quality of the forces, at which it ends.
        rounds: covers of directions that it looks into at most, for each budget.

    Raises:
        SolverError: unless 1e-3 <= tolerance < 1 and rounds >= 1.
    """

    objectives = (MAX_QUALITY,)

    def __init__(self, tolerance: float = 0.01, rounds: int = 400) -> None:
        self.tolerance = real_number("tolerance", tolerance, 0.0, 1.0)
        if self.tolerance < 1e-3:
            raise SolverError(f"tolerance must lie in [0.001, 1), not {tolerance!r}")
        self.rounds = whole_number("rounds", rounds, 1)

    def propose(self, problem: GraspForceProblem) -> Candidate:
        """The search's forces, made exactly feasible with the least effort that keeps them."""
        least = answered_in_turn(problem.constraints("sum_normal"))
        wanted = np.array(problem.normal_min)
        proofs: list[tuple[CoverProof, ...]] = []
        for index in range(len(problem)):
            mask = problem.contact_mask[index]
            one = problem[index].without_padding()
            pieces, forces = self._pieces(one, least.forces[index, 2::3][mask])
            proofs.append(pieces)
            if forces is not None:
                room = (1.0 - _INWARDS) * np.maximum(forces[2::3], 0.0)
                wanted[index, mask] = np.maximum(wanted[index, mask], room)
        wanted = np.minimum(wanted, problem.normal_max)
        held = problem.constraints("sum_normal").derived(normal_min=wanted)
        candidate = answered_in_turn(held)
        # a tolerance of the cone program may be effort beyond the budget
        budget = problem.effort_budget
        over = effort(candidate.forces) > rounded_inwards(budget, problem.n_contacts)
        room = np.where(over, np.maximum((1.0 - _ROOM) * budget, effort(least.forces)), np.inf)
        forces = without_padding(problem, within(least.forces, candidate.forces, room))
        return Candidate(forces, least.multipliers, candidate.message, tuple(proofs))

    def _pieces(
        self, problem: GraspForceProblem, least: Array
    ) -> tuple[tuple[CoverProof, ...], Array | None]:
        """Proofs by growing budget, and the best forces (3n,); None if those of least effort are.

        With a weight, budgets go down from the largest: what is proven for one tells from which
        smaller one on no forces can be worth more than those found by then.

        Args:
            problem: one, without padding.
            least: (n,) N, normal forces of the least effort there is; NaN if there are none.
        """
        weight, budget = float(problem.effort_weight), float(problem.effort_budget)
        effort = float(least.sum())
        if not effort < budget:
            return (), None
        found: dict[float, Bracket] = {}
        quality = quality_bounds(problem, least).lower
        worth = quality - weight * effort
        forces, enough = None, 0.0

        def search(limit: float) -> Bracket | None:
            nonlocal quality, worth, forces
            limited = problem.derived(effort_budget=np.float64(limit))
            bracket = QualitySearch(limited, self.tolerance, self.rounds, enough).run()
            if bracket is not None:
                found[limit] = bracket
                if bracket.utility(weight) > worth:
                    quality, worth = bracket.quality, bracket.utility(weight)
                    forces = bracket.forces
            return bracket

        smallest = max((1.0 + _LEAST_MORE) * effort, _LEAST_MORE * budget)
        if weight > 0.0 and smallest < budget:
            search(smallest)
        while budget > effort and len(found) < _MOST_BUDGETS:
            bracket = search(budget)
            if bracket is None or weight == 0.0:
                break
            settled = worth + self.tolerance * quality
            enough = settled + weight * effort
            following = (bracket.proof.bound - settled) / weight
            if following >= budget or following <= smallest:
                break
            budget = following
        return tuple(found[limit].proof for limit in sorted(found)), forces
