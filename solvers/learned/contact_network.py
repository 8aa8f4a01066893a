"""A small network on contacts that cannot tell one choice of tangents from another."""

import torch
from torch import Tensor, nn

from .config import NetworkConfig
from .features import turned


class VectorLinear(nn.Module):
    """A complex-linear map between channels of tangential vectors; commutes with rotation."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.linear = nn.Linear(2 * inputs, outputs, bias=False)

    def forward(self, tangents: Tensor) -> Tensor:
        """(..., 2, inputs) to (..., 2, outputs)."""
        return self.linear(torch.cat([tangents, turned(tangents)], dim=-1))


class ContactNetwork(nn.Module):
    """Scalars and contact vectors of each contact to new ones; the same weights for every contact.

    Vectors enter the scalars by their normal components and the sizes of mixed tangential parts;
    they leave as mixed tangential parts, times complex gates made of the scalars.
    """

    def __init__(self, config: NetworkConfig, scalars: int, vectors: int, outputs: int) -> None:
        super().__init__()
        self.mix = VectorLinear(vectors, config.vectors)
        self.hidden = nn.Sequential(
            nn.Linear(scalars + vectors + config.vectors, config.width),
            nn.SiLU(),
            nn.Linear(config.width, config.width),
            nn.SiLU(),
        )
        self.gates = nn.Linear(config.width, 2 * config.vectors)
        self.unmix = VectorLinear(config.vectors, outputs)
        self.normals = nn.Linear(config.width, outputs)

    def forward(self, scalars: Tensor, vectors: Tensor) -> tuple[Tensor, Tensor]:
        """(B, n, s), (B, n, 3, v) to hidden (B, n, width) and vectors (B, n, 3, outputs)."""
        mixed = self.mix(vectors[..., :2, :])
        sizes = torch.log1p(torch.sum(mixed**2, dim=-2))
        hidden = self.hidden(torch.cat([scalars, vectors[..., 2, :], sizes], dim=-1))
        real, imaginary = self.gates(hidden)[..., None, :].chunk(2, dim=-1)
        tangents = self.unmix(real * mixed + imaginary * turned(mixed))
        normals = self.normals(hidden)[..., None, :]
        return hidden, torch.cat([tangents, normals], dim=-2)
