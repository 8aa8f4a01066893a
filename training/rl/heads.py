"""Actor-critic policies whose actions come from a head of their own."""

from abc import ABC, abstractmethod
from typing import Any

from stable_baselines3.common.policies import MultiInputActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.type_aliases import Schedule
from torch import nn


class HeadedActorCritic(MultiInputActorCriticPolicy, ABC):
    """Policy of PPO: actions straight from the features, the value through one hidden layer.

    Args:
        extractor: class of the features.
        value_width: of the value's hidden layer.
        arguments: those of `MultiInputActorCriticPolicy`, and so the settings.
    """

    def __init__(
        self,
        *arguments: Any,
        extractor: type[BaseFeaturesExtractor],
        value_width: int,
        **settings: Any,
    ) -> None:
        super().__init__(
            *arguments,
            **settings
            | {
                "features_extractor_class": extractor,
                "net_arch": {"pi": [], "vf": [value_width]},
                "ortho_init": False,
            },
        )

    @abstractmethod
    def make_head(self) -> nn.Module:
        """(batch, features) to (batch, actions)."""

    def _build(self, lr_schedule: Schedule) -> None:
        super()._build(lr_schedule)
        self.action_net = self.make_head()
        settings: dict[str, Any] = {"lr": lr_schedule(1), **self.optimizer_kwargs}
        self.optimizer = self.optimizer_class(self.parameters(), **settings)
