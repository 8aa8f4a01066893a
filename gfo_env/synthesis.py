"""Better places for the contacts of a grasp: on its facets, then across their edges."""

import time
from dataclasses import dataclass
from typing import Literal

import numpy as np

from gfo_env.contacts import checked_contacts, lowest_resisted_wrench
from gfo_env.exceptions import QualityError
from gfo_env.objects import Patches
from solvers.arrays import Array
from solvers.exceptions import SolverError
from solvers.quality.friction_discs import FrictionDiscs, critical_directions
from solvers.synthesis import ContactFacets, ContactSynthesis, SynthesisStatus, ascend, synthesise

Route = Literal["bmi", "gradient"]
"""How contacts move on given facets: by rank-one SDPs, or by the gradient of the duals."""

EDGES = 8
"""Edges of the pyramids by which q_lrw is compared."""

NEAR = 0.003
"""m: facets this close to a contact are those that it may belong to, or cross to."""

LEAST_GAIN = 1e-3
"""Relative gain of q_lrw below which a round or a hop counts as none."""

_LOADS = 6
_MOST_LOADS = 12
_ROUNDS = 3
_HOPS = 20
_TRIALS = 2
_ALIGNED = 0.9
_DISTANCE_WEIGHT = 20.0


@dataclass(frozen=True, eq=False)
class ContactPlan:
    """Contacts on patches of a surface.

    Args:
        patches: (n,) index of each contact's patch.
        positions: (n, 3) m, object frame.
        normals: (n, 3) unit, into the object.
        quality: lower bound of q_lrw at unit normal forces, N per N.
        synthesis: that put the contacts there; None if they were given, or the gradient did.
    """

    patches: tuple[int, ...]
    positions: Array
    normals: Array
    quality: float
    synthesis: ContactSynthesis | None = None


@dataclass(frozen=True, eq=False)
class Improvement:
    """What an improvement of contacts began with, and where it ended.

    Args:
        before: the contacts, put on the facets that fit them best.
        on_facets: the best found on those facets; `before` if nothing was better.
        after: the best found on any facets.
        first: the first synthesis on the facets of `before`, however it ended; None for the
            gradient.
        hops: how often a contact crossed to another facet.
        solves: semidefinite programs, or force problems for the gradient.
        seconds: wall time.
    """

    before: ContactPlan
    on_facets: ContactPlan
    after: ContactPlan
    first: ContactSynthesis | None
    hops: int
    solves: int
    seconds: float


def improve(
    patches: Patches,
    positions: Array,
    normals: Array,
    friction: Array,
    length: float,
    route: Route = "bmi",
) -> Improvement:
    """Move contacts over a surface to raise q_lrw at unit normal forces.

    On given facets, positions are chosen that carry the wrenches that the grasp resists worst; the
    worst are looked up anew after each round. Then contacts try the facets next to them, the most
    promising first, until none helps. The hand is not asked: where its fingers can reach is another
    question.

    Args:
        patches: of the object's surface, object frame.
        positions: (n, 3) m, of the contacts to start from.
        normals: (n, 3) unit, into the object; they choose between the facets around an edge.
        friction: (n,) mu.
        length: m, divisor of torques in q_lrw: the object's largest radius.
        route: how contacts move on given facets.

    Raises:
        ProblemError, QualityError: an argument is malformed.
        SolverError: there is no such route.
    """
    started = time.perf_counter()
    if not isinstance(patches, Patches):
        raise QualityError(f"patches must be Patches of a mesh, not {type(patches).__name__}")
    checked_contacts(positions, normals, friction)
    search = _Search(patches, friction, length, route)
    before = search.attach(positions, normals)
    on_facets = best = search.settle(before)
    hops = 0
    while hops < _HOPS:
        trials = (search.settle(start) for start in search.moves(best)[:_TRIALS])
        better = next((plan for plan in trials if _gains(plan, best)), None)
        if better is None:
            break
        best, hops = better, hops + 1
    seconds = time.perf_counter() - started
    return Improvement(before, on_facets, best, search.first, hops, search.solves, seconds)


def _gains(plan: ContactPlan, best: ContactPlan) -> bool:
    return plan.quality > (1.0 + LEAST_GAIN) * best.quality


class _Search:
    """The steps of an improvement, with a count of what they cost."""

    def __init__(self, patches: Patches, friction: Array, length: float, route: Route) -> None:
        self._patches, self._friction, self._length = patches, friction, length
        moves = {"bmi": self._by_bmi, "gradient": self._by_gradient}
        if not isinstance(route, str) or route not in moves:
            raise SolverError(f"unknown route {route!r}; choose one of {', '.join(moves)}")
        self._move = moves[route]
        self.first: ContactSynthesis | None = None
        self.solves = 0

    def attach(self, positions: Array, normals: Array) -> ContactPlan:
        """The contacts on the patches next to them whose normals fit best."""
        chosen, points = [], []
        for position, normal in zip(positions, normals, strict=True):
            near = self._patches.near(position, NEAR) or self._patches.near(position, np.inf)
            fit = {
                index: self._patches[index].normal @ normal
                - _DISTANCE_WEIGHT * np.linalg.norm(point - position)
                for index, point in near.items()
            }
            index = max(fit, key=lambda index: fit[index])
            chosen.append(index)
            points.append(near[index])
        return self._plan(tuple(chosen), np.array(points))

    def settle(self, start: ContactPlan) -> ContactPlan:
        """The best contacts found on the facets of `start`; `start` itself if none is better."""
        corners = tuple(self._patches[index].corners for index in start.patches)
        facets = ContactFacets(corners, start.normals, self._friction, self._length)
        best = at = start
        loads = np.zeros((0, 6))
        for _ in range(_ROUNDS):
            fresh = critical_directions(self._discs(at), EDGES, _LOADS, _ALIGNED)
            if len(loads):
                fresh = fresh[(fresh @ loads.T).max(axis=1) < _ALIGNED]
            if not len(fresh):
                break
            loads = np.vstack([loads, fresh])[-_MOST_LOADS:]
            moved = self._move(facets, loads, at)
            if moved is None or not _gains(moved, best):
                break
            best = at = moved
        return best

    def moves(self, plan: ContactPlan) -> list[ContactPlan]:
        """One contact moved to a facet next to it, for every contact and facet; best first."""
        found = []
        for contact, position in enumerate(plan.positions):
            for index, point in self._patches.near(position, NEAR).items():
                if index != plan.patches[contact]:
                    patches, positions = list(plan.patches), plan.positions.copy()
                    patches[contact], positions[contact] = index, point
                    found.append(self._plan(tuple(patches), positions))
        return sorted(found, key=lambda plan: -plan.quality)

    def _by_bmi(self, facets: ContactFacets, loads: Array, at: ContactPlan) -> ContactPlan | None:
        result = synthesise(facets, loads)
        self.solves += result.steps
        self.first = self.first or result
        if result.status is not SynthesisStatus.SOLVED:
            return None
        return self._plan(at.patches, result.positions, result)

    def _by_gradient(
        self, facets: ContactFacets, loads: Array, at: ContactPlan
    ) -> ContactPlan | None:
        try:
            result = ascend(facets, loads, at.positions)
        except SolverError:  # not in force closure, and so without a gradient
            self.solves += len(loads)
            return None
        self.solves += result.evaluations
        return self._plan(at.patches, result.positions)

    def _discs(self, plan: ContactPlan) -> FrictionDiscs:
        unit = np.ones(len(plan.positions))
        return FrictionDiscs.of_contacts(
            plan.positions, plan.normals, self._friction, unit, self._length
        )

    def _plan(
        self,
        patches: tuple[int, ...],
        positions: Array,
        synthesis: ContactSynthesis | None = None,
    ) -> ContactPlan:
        normals = np.array([self._patches[index].normal for index in patches])
        quality = lowest_resisted_wrench(
            positions, normals, self._friction, edges=EDGES, length=self._length
        )
        return ContactPlan(patches, positions, normals, quality.lower, synthesis)
