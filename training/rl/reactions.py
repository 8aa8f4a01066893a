"""A policy for corrections that treats all directions alike: a reaction turns as its cause does.

The corrections of the load's force and of its torque are sums of the forces, and of the torques, of
the observed vectors, each times a gain, the same along all axes. So what was learned about a push
from one side is known about pushes from all sides. The preload's correction and the value depend on
the scalars and on the vectors' lengths.
"""

from typing import Any

import torch
from gymnasium import spaces
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import Tensor, nn

from .heads import HeadedActorCritic

_WIDTH = 32


class LoadExtractor(BaseFeaturesExtractor):
    """(batch, 6 k + m + 2 k): the k vectors of observations, scalars, and lengths of the vectors.

    Args:
        observation_space: of `training.rl.features.LoadFeatures`, perhaps of several steps at once.
    """

    def __init__(self, observation_space: spaces.Dict[Any]) -> None:
        sizes = {name: spaces.utils.flatdim(space) for name, space in observation_space.items()}
        self.vectors = sizes["vectors"] // 6
        self.invariants = sizes["scalars"] + 2 * self.vectors
        super().__init__(observation_space, 6 * self.vectors + self.invariants)

    def forward(self, observations: dict[str, Tensor]) -> Tensor:
        """Features of a batch of observations."""
        vectors = observations["vectors"].flatten(1)
        lengths = torch.linalg.vector_norm(vectors.unflatten(-1, (-1, 3)), dim=-1)
        return torch.cat([vectors, observations["scalars"].flatten(1), lengths], dim=-1)


class ReactionHead(nn.Module):
    """(batch, 7) corrections from the features of `LoadExtractor`; zero before any training.

    Args:
        vectors: how many.
        invariants: how many numbers follow the vectors.
    """

    def __init__(self, vectors: int, invariants: int) -> None:
        super().__init__()
        self.vectors = vectors
        self.gains = nn.Parameter(torch.zeros(vectors, 2))
        self.preload = nn.Sequential(nn.Linear(invariants, _WIDTH), nn.Tanh(), nn.Linear(_WIDTH, 1))
        last = self.preload[-1]
        assert isinstance(last, nn.Linear)
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)

    def forward(self, features: Tensor) -> Tensor:
        """Seven numbers for each observation."""
        vectors = features[:, : 6 * self.vectors].unflatten(-1, (self.vectors, 2, 3))
        wrench = torch.einsum("bvkj,vk->bkj", vectors, self.gains).flatten(1)
        return torch.cat([wrench, self.preload(features[:, 6 * self.vectors :])], dim=-1)


class ReactionActorCritic(HeadedActorCritic):
    """Policy of PPO for `training.rl.residual.ResidualWrench`."""

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        super().__init__(*arguments, extractor=LoadExtractor, value_width=64, **settings)

    def make_head(self) -> ReactionHead:
        """See the base."""
        extractor = self.features_extractor
        assert isinstance(extractor, LoadExtractor)
        return ReactionHead(extractor.vectors, extractor.invariants)


REACTION_POLICIES: dict[str, type[BasePolicy]] = {"ppo": ReactionActorCritic}
"""Policies with this network by algorithm."""
