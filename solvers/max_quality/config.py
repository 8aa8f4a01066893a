"""Sizes of the network for quality; kept apart so that reading them needs no torch."""

from dataclasses import dataclass

from solvers.learned.config import check_sizes


@dataclass(frozen=True)
class QualityNetworkConfig:
    """Sizes of the network for quality."""

    steps: int = 8
    """Steps along the flow."""
    proposals: int = 2
    """Shares that a step proposes; each is answered by exactly feasible forces."""
    width: int = 64
    """Hidden units of a contact."""
    pair_width: int = 32
    """Hidden units of a pair of contacts."""
    reach_width: int = 48
    """Hidden units of a contact's reach along a direction."""

    def __post_init__(self) -> None:
        check_sizes(self)
