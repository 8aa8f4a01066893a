"""Sizes of the conditioned network; kept apart so that reading them needs no torch."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class NetworkConfig:
    """Sizes of the network."""

    steps: int = 8
    """Steps along the flow."""
    width: int = 64
    """Hidden units of the contact networks."""
    vectors: int = 12
    """Complex channels in which the tangential vectors of a contact are mixed."""
    memory: int = 16
    """Scalars that a contact remembers from step to step."""
    vector_memory: int = 4
    """Contact vectors that a contact remembers, and shows to the others through P."""
    joint_width: int = 32
    """Hidden units of the joint network."""
    joint_memory: int = 8
    """Scalars that a joint remembers; as many contact vectors go out along its Jacobian column."""
    coordinates: Literal["force", "raw"] = "force"
    """`force`: the canonical form, free of units and frame. `raw`: newtons and metres in the
    object's frame, which exists to be compared with."""
