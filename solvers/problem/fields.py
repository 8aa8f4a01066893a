"""The array fields of a problem: their names, their dimensions, and the sizes that they give."""

from dataclasses import dataclass
from types import ModuleType
from typing import Any

from array_api_compat import array_namespace

ARRAY_FIELDS = (
    "grasp_map",
    "hand_jacobian",
    "friction",
    "torque_min",
    "torque_max",
    "external_wrench",
    "external_torque",
    "normal_min",
    "normal_max",
    "contact_mask",
)
"""The array fields of a problem, in the order of the class."""

QUALITY_FIELDS = ("effort_budget", "characteristic_length", "effort_weight")
"""The fields that only problems of quality have, one number a problem."""

CORE_NDIM = {
    **{name: 2 if name in ("grasp_map", "hand_jacobian") else 1 for name in ARRAY_FIELDS},
    **dict.fromkeys(QUALITY_FIELDS, 0),
}
"""Dimensions of each field without the batch."""

WRENCH_SIZE = 6


def core_shapes(contacts: int, joints: int) -> dict[str, tuple[int, ...]]:
    """Shapes of the fields without the batch."""
    return {
        "grasp_map": (WRENCH_SIZE, 3 * contacts),
        "hand_jacobian": (3 * contacts, joints),
        "external_wrench": (WRENCH_SIZE,),
        **dict.fromkeys(("torque_min", "torque_max", "external_torque"), (joints,)),
        **dict.fromkeys(("friction", "normal_min", "normal_max", "contact_mask"), (contacts,)),
        **dict.fromkeys(QUALITY_FIELDS, ()),
    }


@dataclass(frozen=True, eq=False, kw_only=True)
class ProblemFields:
    """The data of a `GraspForceProblem`, which says what each is and checks them."""

    grasp_map: Any
    hand_jacobian: Any
    friction: Any
    torque_min: Any
    torque_max: Any
    external_wrench: Any
    external_torque: Any = None
    normal_min: Any = None
    normal_max: Any = None
    contact_mask: Any = None
    objective: str = "min_norm"
    effort_budget: Any = None
    characteristic_length: Any = None
    effort_weight: Any = None

    @property
    def xp(self) -> ModuleType:
        """The array namespace of the fields: array_api_compat's numpy or torch."""
        return array_namespace(self.grasp_map)

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """The leading dimensions; () for a single problem."""
        return tuple(self.friction.shape[:-1])

    @property
    def n_contacts(self) -> int:
        """Contacts per problem, padding included."""
        return int(self.friction.shape[-1])

    @property
    def n_joints(self) -> int:
        """Joint torques per problem."""
        return int(self.torque_min.shape[-1])
