"""The paper's grasp, for real: a Barrett hand that touches an object with three fingertips.

The paper grasps a PyBullet object with a Barrett hand in three points (its section "Grasp Analysis
Problem"), and prints neither the contacts nor the object. Here such a grasp is searched for.
"""

from contextlib import closing
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gfo_env.conditions import (
    FRICTION_FACTOR,
    FRICTION_RANGE,
    MASS_RANGE,
    PRELOAD,
    STANDARD_GRAVITY,
)
from gfo_env.contacts import Contacts, is_force_closure
from gfo_env.exceptions import AcquisitionError, QualityError
from gfo_env.grasps.acquisition import Grasp, attempt
from gfo_env.grasps.problem import problem_fields
from gfo_env.hand import BARRETT_BH8_280
from gfo_env.objects import GraspObject, ObjectSet
from gfo_env.simulation import Simulation
from solvers import GraspForceProblem, GraspForceSolution, solve
from solvers.arrays import Array

PRINTED_NORMAL_FORCES = (38.333, 35.823, 34.805)
"""Sizes of the paper's x_13, x_23 and x_33, of fingers 1 to 3. It prints all of them negative: as
normal forces they would pull, which its own friction cone forbids."""

FORCES = ("unit", "commanded", "commanded x 10", "printed sizes")
"""What a program may have the contacts press with: 1, the optimal forces, ten times these, or
`PRINTED_NORMAL_FORCES`."""

_FINGERS = ("f1", "f2", "f3")
_MASS = float(np.mean(MASS_RANGE))
_FRICTION = float(np.mean(FRICTION_RANGE))
_GRAVITY = np.array([0.0, 0.0, STANDARD_GRAVITY])
_MOST_ATTEMPTS = 500


@dataclass(frozen=True, eq=False)
class PaperGrasp:
    """A grasp as in the paper: three contacts, one a finger, with forces that carry the object.

    Args:
        seed: of the search.
        attempt: number of the attempt that acquired it.
        grasp: acquired.
        grasp_object: an unseen object of random_urdfs, as it was grasped.
        mass: kg, of the object when it is carried.
        friction: the true coefficient; the forces are planned with `FRICTION_FACTOR` of it.
        gravity: (3,) m/s2, hand frame: out of the palm, which faces down.
        problem: of carrying the weight at least effort.
        solution: of the problem, optimal.
    """

    seed: int
    attempt: int
    grasp: Grasp
    grasp_object: GraspObject
    mass: float
    friction: float
    gravity: Array
    problem: GraspForceProblem
    solution: GraspForceSolution

    @property
    def object_id(self) -> str:
        """The object's name in its set."""
        return self.grasp.object_id

    @property
    def radius(self) -> float:
        """Largest distance of the object's surface from its centre of mass, m."""
        return self.grasp_object.radius

    @property
    def contacts(self) -> Contacts:
        """The three contacts, object frame."""
        return self.grasp.contacts

    @property
    def fingers(self) -> NDArray[np.int64]:
        """(3,) the finger of each contact: 1, 2 or 3."""
        return 1 + np.array([_FINGERS.index(_finger(link)) for link in self.contacts.links])

    @property
    def forces(self) -> Array:
        """(3, 3) N, commanded: two tangential components and the normal one of each contact."""
        return np.reshape(self.solution.forces, (-1, 3))

    def normal_forces(self, forces: str = "commanded") -> Array:
        """(3,) N, what the contacts press with; `forces` is one of `FORCES`.

        Raises:
            QualityError: it is not.
        """
        match forces:
            case "unit":
                return np.ones(len(self.contacts))
            case "commanded":
                return self.forces[:, 2]
            case "commanded x 10":
                return 10.0 * self.forces[:, 2]
            case "printed sizes":
                return np.array(PRINTED_NORMAL_FORCES)[self.fingers - 1]
        raise QualityError(f"forces must be one of {', '.join(FORCES)}, not {forces!r}")


def acquire(seed: int = 0) -> PaperGrasp:
    """The first grasp of a seeded search that is the paper's: deterministic, a few seconds.

    Objects are unseen ones of random_urdfs in a random order. The grasp has exactly three contacts,
    one a finger and none on the palm, is in force closure, and has optimal forces that carry the
    object's weight in the hand, palm down, with every contact preloaded.

    Raises:
        AcquisitionError: the seed is negative, or 500 attempts have yielded none.
    """
    if seed < 0:
        raise AcquisitionError(f"seed must be 0 or more, not {seed}")
    objects = ObjectSet("random_urdfs", "test")
    order = np.random.default_rng(seed).permutation(len(objects))
    with closing(Simulation()) as simulation:
        for number in range(_MOST_ATTEMPTS):
            grasp_object = objects[objects.object_ids[order[number % len(order)]]]
            result = attempt(grasp_object, simulation, np.random.default_rng([seed, number]))
            if result.grasp is None or not _one_contact_a_finger(result.grasp.contacts):
                continue
            problem = _carrying_problem(result.grasp)
            solution = solve(problem)
            if str(solution.status) == "optimal" and _closes(result.grasp.contacts, _FRICTION):
                return PaperGrasp(
                    seed=seed,
                    attempt=number,
                    grasp=result.grasp,
                    grasp_object=grasp_object,
                    mass=_MASS,
                    friction=_FRICTION,
                    gravity=_GRAVITY,
                    problem=problem,
                    solution=solution,
                )
    raise AcquisitionError(
        f"none of {_MOST_ATTEMPTS} attempts with seed {seed} was a grasp by three fingertips that "
        "carries its object; try another seed"
    )


def _finger(link: int) -> str:
    return "palm" if link < 0 else BARRETT_BH8_280.link_names[link].split("_")[0]


def _one_contact_a_finger(contacts: Contacts) -> bool:
    return sorted(_finger(link) for link in contacts.links) == [*_FINGERS]


def _closes(contacts: Contacts, friction: float) -> bool:
    return is_force_closure(contacts.positions, contacts.normals, np.full(len(contacts), friction))


def _carrying_problem(grasp: Grasp) -> GraspForceProblem:
    load = np.append(_MASS * _GRAVITY, np.zeros(3))
    return GraspForceProblem(
        **problem_fields(
            grasp,
            BARRETT_BH8_280,
            load,
            _GRAVITY,
            friction=FRICTION_FACTOR * _FRICTION,
            preload=PRELOAD,
        )
    )
