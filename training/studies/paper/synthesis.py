"""Contact synthesis on held-out objects: where the hand touched, and where it should have."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rich.progress import Progress

from gfo_env.contacts import lowest_resisted_wrench
from gfo_env.grasps import GraspTable
from gfo_env.grasps.acquisition import Grasp
from gfo_env.grasps.attempts import grasp_of
from gfo_env.objects import ObjectSet, Patches
from gfo_env.synthesis import EDGES, ContactPlan, Improvement, improve
from solvers import GraspForceProblem, solve
from solvers.arrays import Array
from solvers.synthesis import (
    ContactFacets,
    SynthesisStatus,
    force_problems,
    internal_work,
    synthesise,
)
from training.measuring.jobs import run_all

FRICTION = 0.5
"""Coefficient of every contact in the comparison."""


@dataclass(frozen=True, eq=False)
class SynthesisResult:
    """One grasp, its contacts improved by both routes.

    Args:
        object_id: of the object.
        contacts: number of contacts.
        real: q_lrw of the grasp as it was: the simulator's contacts and normals.
        bmi: improved by rank-one semidefinite programs.
        gradient: improved along the duals' gradient.
        held: whether an internal force strictly inside the cones at the contacts after `bmi` exists
            in the judge's eyes, solved and judged anew.
        one_sided: how a synthesis ended whose contacts all lie on facets of one side.
        one_sided_work: the proof's `internal_work`, below zero; NaN without a proof.
    """

    object_id: str
    contacts: int
    real: float
    bmi: Improvement
    gradient: Improvement
    held: bool
    one_sided: SynthesisStatus
    one_sided_work: float


def compare_routes(
    objects: ObjectSet,
    table: GraspTable,
    count: int,
    *,
    workers: int = 1,
    progress: Progress | None = None,
) -> list[SynthesisResult]:
    """Improve one grasp of each of `count` objects by both routes, in the order of the table.

    Args:
        objects: that the grasps are of.
        table: grasps, of which the first of each object counts.
        count: how many objects.
        workers: processes.
        progress: a bar is added to it.
    """
    _, first = np.unique(table.object_id, return_index=True)
    chosen = np.sort(first)[:count]
    calls = [(objects, grasp_of(table, int(index))) for index in chosen]
    return run_all(_compare, calls, title="contact synthesis", workers=workers, progress=progress)


def is_solved(result: SynthesisResult) -> bool:
    """Whether its first synthesis, on the facets of the real grasp, ended at rank one."""
    return result.bmi.first is not None and result.bmi.first.status is SynthesisStatus.SOLVED


def solved_mask(results: list[SynthesisResult]) -> NDArray[np.bool_]:
    """(B,) `is_solved` of each."""
    return np.array([is_solved(result) for result in results])


def _compare(objects: ObjectSet, grasp: Grasp) -> SynthesisResult:
    grasp_object = objects[grasp.object_id]
    patches, length = Patches(grasp_object.solid), grasp_object.radius
    contacts = grasp.contacts
    friction = np.full(len(contacts), FRICTION)
    positions, normals = contacts.positions, contacts.normals
    real = lowest_resisted_wrench(positions, normals, friction, edges=EDGES, length=length)
    bmi = improve(patches, positions, normals, friction, length, "bmi")
    gradient = improve(patches, positions, normals, friction, length, "gradient")
    one_sided = _on_one_side(patches, bmi.before, friction, length)
    outcome = synthesise(one_sided, np.zeros((0, 6)))
    return SynthesisResult(
        object_id=grasp.object_id,
        contacts=len(contacts),
        real=real.lower,
        bmi=bmi,
        gradient=gradient,
        held=_has_internal_force(_facets(patches, bmi.after, friction, length), bmi.after),
        one_sided=outcome.status,
        one_sided_work=internal_work(one_sided, outcome.separating_wrench),
    )


def _facets(patches: Patches, plan: ContactPlan, friction: Array, length: float) -> ContactFacets:
    corners = tuple(patches[index].corners for index in plan.patches)
    return ContactFacets(corners, plan.normals, friction, length)


def _on_one_side(
    patches: Patches, plan: ContactPlan, friction: Array, length: float
) -> ContactFacets:
    """As many facets as the plan has contacts, those whose normals are nearest to the first's."""
    alignment = np.array([patch.normal for patch in patches.patches]) @ plan.normals[0]
    chosen = np.argsort(-alignment, kind="stable")[: len(plan.patches)]
    return ContactFacets(
        tuple(patches[int(index)].corners for index in chosen),
        np.array([patches[int(index)].normal for index in chosen]),
        friction,
        length,
    )


def _has_internal_force(facets: ContactFacets, plan: ContactPlan) -> bool:
    """Whether forces of at least 1 N each cancel, strictly inside the cones; judged."""
    problem = force_problems(facets, plan.positions, np.zeros((1, 6)))[0]
    strict: GraspForceProblem = problem.replace(
        normal_min=np.ones(len(facets)), friction=0.95 * problem.friction
    )
    return str(solve(strict, "clarabel").status) == "optimal"
