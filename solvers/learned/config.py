"""Sizes of the conditioned network; kept apart so that reading them needs no torch."""

from dataclasses import dataclass, fields
from typing import Any, Literal

from solvers.exceptions import SolverError

_MOST_STEPS, _MOST_UNITS = 1000, 8192


def check_sizes(config: Any) -> None:
    """See that a network of these sizes can be made, and asked within a lifetime.

    Args:
        config: a dataclass whose whole numbers are sizes, `steps` perhaps 0.

    Raises:
        SolverError: if not.
    """
    for field in fields(config):
        if field.type is not int:
            continue
        value = getattr(config, field.name)
        least, most = (0, _MOST_STEPS) if field.name == "steps" else (1, _MOST_UNITS)
        if type(value) is not int or not least <= value <= most:
            raise SolverError(
                f"{field.name} of the network is {value!r}; it must be a whole number from "
                f"{least} to {most}"
            )


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

    def __post_init__(self) -> None:
        check_sizes(self)
        if self.coordinates not in ("force", "raw"):
            raise SolverError(f"coordinates is {self.coordinates!r}; it must be force or raw")
