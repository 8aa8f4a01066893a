"""From contact points to a grasp: frames, grasp map, rank, closure, q_lrw.

Arrays are checked where they come in, and wrong ones are a `GeometryError` or `QualityError` that
names the shape wanted. For compiled code and loops, and so without checks: `balances`,
`contact_arrays`, `contact_geometry`, `grasp_map_of`, `is_projected`, `merge_points`,
`number_table`.
"""

from .closure import closes, is_projected
from .contacts import (
    LEAST_FORCE,
    Contacts,
    contact_frames,
    contact_geometry,
    grasp_map,
    grasp_map_of,
    merge,
    merge_points,
    read_contacts,
)
from .engine import POINT_NUMBERS, RawContacts, contact_arrays, number_table
from .estimate import quality_estimate
from .quality import (
    QualityInterval,
    checked_contacts,
    has_interior_internal_force,
    is_force_closure,
    lowest_resisted_wrench,
)
from .rank import balances, can_balance
from .surface import Surface

__all__ = [
    "LEAST_FORCE",
    "POINT_NUMBERS",
    "Contacts",
    "QualityInterval",
    "RawContacts",
    "Surface",
    "balances",
    "can_balance",
    "checked_contacts",
    "closes",
    "contact_arrays",
    "contact_frames",
    "contact_geometry",
    "grasp_map",
    "grasp_map_of",
    "has_interior_internal_force",
    "is_force_closure",
    "is_projected",
    "lowest_resisted_wrench",
    "merge",
    "merge_points",
    "number_table",
    "quality_estimate",
    "read_contacts",
]
