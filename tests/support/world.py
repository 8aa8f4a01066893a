"""Real grasps for the tests of the world: acquired once in a process, the same in every process."""

from dataclasses import dataclass
from functools import cache
from typing import Any

from gfo_env.grasps.acquisition import Grasp, attempt
from gfo_env.grasps.problem import problem_fields
from gfo_env.objects import GraspObject, ObjectSet
from gfo_env.simulation import Simulation
from solvers import GraspForceProblem
from tests.support.seeds import seeded


@dataclass(frozen=True, eq=False)
class Held:
    """A grasp with its object."""

    grasp: Grasp
    grasp_object: GraspObject


@cache
def held_out_objects() -> ObjectSet:
    """The held-out objects of random_urdfs."""
    return ObjectSet("random_urdfs", "test")


@cache
def real_grasps(count: int) -> tuple[Held, ...]:
    """The first `count` grasps of held-out objects."""
    objects = held_out_objects()
    simulation = Simulation()
    held: list[Held] = []
    number = 0
    while len(held) < count:
        grasp_object = objects[objects.object_ids[number % len(objects)]]
        result = attempt(grasp_object, simulation, seeded([11, number]))
        if result.grasp is not None:
            held.append(Held(result.grasp, grasp_object))
        number += 1
    simulation.close()
    return tuple(held)


def grasp_force_problem(*arguments: Any, **settings: Any) -> GraspForceProblem:
    """The validated problem of these `problem_fields`."""
    return GraspForceProblem(**problem_fields(*arguments, **settings))
