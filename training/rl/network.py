"""Policies whose network treats contacts alike, in whatever order they come.

A contact is described by numbers in its own frame, so nothing depends on the object's frame. What
contacts have to do with each other goes through wrenches: in each round every contact proposes
forces, the grasp map adds them up, and every contact sees through its own columns what they do
together, beside the load. The last layer is the same for all contacts, too.
"""

from typing import Any

import torch
from gymnasium import spaces
from stable_baselines3.common.policies import BasePolicy, ContinuousCritic
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.sac.policies import Actor, MultiInputPolicy
from torch import Tensor, nn

from .heads import HeadedActorCritic

_FORCE = 10.0
"""N, that forces are divided by."""


class ContactExtractor(BaseFeaturesExtractor):
    """(batch, n * width) features, those of a contact beside each other; zero at padding.

    Args:
        observation_space: of the environment, not normalised; numbers of each contact beside those
            of the problem may come as `contact_features`.
        width: features of a contact.
        channels: forces that a contact proposes in a round.
        rounds: of proposals.
        extra: numbers per contact that come beside the observation.
    """

    def __init__(
        self,
        observation_space: spaces.Dict[Any],
        width: int = 32,
        channels: int = 4,
        rounds: int = 3,
        extra: int = 0,
    ) -> None:
        self.n = _length(observation_space["contact_mask"])
        self.joints = _length(observation_space["torque_max"])
        super().__init__(observation_space, self.n * width)
        self.channels = channels
        described = 3 + 9 + 4 + 3 * self.joints + extra
        if "contact_features" in observation_space.spaces:
            described += _length(observation_space["contact_features"]) // self.n
        self.encode = _mlp(described, width)
        self.propose = nn.ModuleList(nn.Linear(width, 3 * channels) for _ in range(rounds))
        self.update = nn.ModuleList(_mlp(2 * width + 3 * channels, width) for _ in range(rounds))

    def forward(self, observations: dict[str, Tensor], extra: Tensor | None = None) -> Tensor:
        """Features of a batch of observations, and of (B, n * extra) numbers beside them."""
        mask = observations["contact_mask"][..., None]  # (B, n, 1)
        columns, load = self._balanced(observations)  # (B, n, 6, 3), (B, 6)
        described = self._described(observations, columns, load)
        if extra is not None:
            described = torch.cat([described, extra.unflatten(-1, (self.n, -1))], -1)
        hidden = self.encode(described) * mask
        count = mask.sum(1, keepdim=True).clamp(min=1.0)
        for propose, update in zip(self.propose, self.update, strict=True):
            forces = propose(hidden).unflatten(-1, (3, self.channels)) * mask[..., None]
            wrench = torch.einsum("bnwk,bnkc->bwc", columns, forces)
            seen = torch.einsum("bnwk,bwc->bnkc", columns, wrench).flatten(-2)
            pooled = (hidden.sum(1, keepdim=True) / count).expand_as(hidden)
            hidden = (hidden + update(torch.cat([hidden, pooled, seen], -1))) * mask
        return hidden.flatten(1)

    def _balanced(self, observations: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
        """Columns of the grasp map and the load, torques over the root mean square moment arm."""
        columns = observations["grasp_map"].unflatten(-1, (6, self.n, 3)).transpose(1, 2)
        force, torque = columns[:, :, :3], columns[:, :, 3:]
        size = force.square().sum((1, 2, 3), keepdim=True).clamp(min=1e-6)
        arm = (torque.square().sum((1, 2, 3), keepdim=True) / size).sqrt().clamp(min=1e-4)
        wrench = observations["external_wrench"] / _FORCE
        load = torch.cat([wrench[:, :3], wrench[:, 3:] / arm[:, :, 0, 0]], -1)
        return torch.cat([force, torque / arm], 2), load

    def _described(self, observations: dict[str, Tensor], columns: Tensor, load: Tensor) -> Tensor:
        """(B, n, described) what is known of each contact, in its own frame."""
        own = torch.einsum("bnwi,bnwj->bnij", columns, columns).flatten(-2)
        pulled = torch.einsum("bnwk,bw->bnk", columns, load)
        reach = observations["hand_jacobian"].unflatten(-1, (self.n, 3, self.joints))
        over_limit = reach / observations["torque_max"].clamp(min=1e-3)[:, None, None]
        bounds = [observations[name] / _FORCE for name in ("normal_min", "normal_max")]
        plain = [observations["friction"], observations["contact_mask"], *bounds]
        parts = [pulled, own, torch.stack(plain, -1), 10.0 * over_limit.flatten(-2)]
        if "contact_features" in observations:
            parts.append(observations["contact_features"].unflatten(-1, (self.n, -1)))
        return torch.cat(parts, -1)


class ContactHead(nn.Module):
    """The same linear layer for every contact: (batch, n * width) to (batch, n * outputs).

    Args:
        contacts: how many.
        width: features of each.
        gain: of the first weights.
        bias: first value of every output.
        outputs: numbers of each.
    """

    def __init__(
        self, contacts: int, width: int, gain: float = 0.01, bias: float = 0.0, outputs: int = 3
    ) -> None:
        super().__init__()
        self.contacts = contacts
        self.layer = nn.Linear(width, outputs)
        nn.init.orthogonal_(self.layer.weight, gain)
        nn.init.constant_(self.layer.bias, bias)

    def forward(self, features: Tensor) -> Tensor:
        """The numbers of the contacts, one contact after the other."""
        return self.layer(features.unflatten(-1, (self.contacts, -1))).flatten(1)


class ContactActorCritic(HeadedActorCritic):
    """Policy of PPO: actions from each contact's features, the value from all of them."""

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        super().__init__(*arguments, extractor=ContactExtractor, value_width=128, **settings)

    def make_head(self) -> ContactHead:
        """See the base."""
        return _head(self.features_extractor, self.action_space)


class ContactActor(Actor):
    """Actor of SAC: mean and spread of actions from each contact's features."""

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        super().__init__(*arguments, **settings | {"net_arch": []})
        features, actions = self.features_extractor, self.action_space
        self.mu = _head(features, actions)
        self.log_std = _head(features, actions, bias=-1.5)  # type: ignore[assignment]


class ContactValue(nn.Module):
    """The worth of an action: the network of `ContactExtractor` with each contact's action beside.

    Args:
        observation_space: of the environment, not normalised.
        actions: numbers per contact.
    """

    def __init__(self, observation_space: spaces.Dict[Any], actions: int) -> None:
        super().__init__()
        self.extractor = ContactExtractor(observation_space, extra=actions)
        self.contacts = self.extractor.n
        width = self.extractor.features_dim // self.contacts
        self.layer = nn.Sequential(nn.Linear(width, width), nn.SiLU(), nn.Linear(width, 1))

    def forward(self, observations: dict[str, Tensor], actions: Tensor) -> Tensor:
        """(B, 1)."""
        features = self.extractor(observations, actions).unflatten(-1, (self.contacts, -1))
        return self.layer(features.mean(1))


class ContactCritic(ContinuousCritic):
    """Critics of SAC, each a `ContactValue`."""

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        super().__init__(*arguments, **settings | {"net_arch": []})
        space = self.observation_space
        assert isinstance(space, spaces.Dict)
        numbers = _length(self.action_space) // _length(space["contact_mask"])
        for index in range(self.n_critics):
            self.q_networks[index] = ContactValue(space, numbers)
            self.add_module(f"qf{index}", self.q_networks[index])

    def forward(self, obs: Any, actions: Tensor) -> tuple[Tensor, ...]:
        """What each critic thinks of the actions."""
        return tuple(network(obs, actions) for network in self.q_networks)


class ContactSacPolicy(MultiInputPolicy):
    """Policy of SAC with `ContactActor` and `ContactCritic`."""

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        super().__init__(*arguments, **settings | {"features_extractor_class": ContactExtractor})

    def make_actor(self, features_extractor: BaseFeaturesExtractor | None = None) -> Actor:
        """The actor with an extractor of its own."""
        settings = self._update_features_extractor(self.actor_kwargs, features_extractor)
        return ContactActor(**settings).to(self.device)

    def make_critic(self, features_extractor: BaseFeaturesExtractor | None = None) -> ContactCritic:
        """The critics, each with an extractor of its own."""
        settings = self._update_features_extractor(self.critic_kwargs, features_extractor)
        return ContactCritic(**settings).to(self.device)


CONTACT_POLICIES: dict[str, type[BasePolicy]] = {"ppo": ContactActorCritic, "sac": ContactSacPolicy}
"""Policies with this network by algorithm."""


def _mlp(inputs: int, width: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, width), nn.SiLU(), nn.Linear(width, width), nn.SiLU())


def _head(extractor: nn.Module, actions: spaces.Space[Any], bias: float = 0.0) -> ContactHead:
    assert isinstance(extractor, ContactExtractor)
    width, outputs = (size // extractor.n for size in (extractor.features_dim, _length(actions)))
    return ContactHead(extractor.n, width, bias=bias, outputs=outputs)


def _length(space: spaces.Space[Any]) -> int:
    """How many numbers a vector of this space has."""
    assert space.shape is not None
    return space.shape[0]
