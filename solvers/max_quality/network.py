"""The network for quality: learned steps along the KKT flow of the preload's shares.

Each step sees where the exact forces of the last shares are weakest, who reaches how far there, and
what limits them; it moves the logarithms of the shares along the flow of `solvers.max_quality.flow`
plus a learned correction. Contacts, pairs of contacts, and contacts along directions share their
weights, and tangents count by their sizes alone, so that neither the contacts' order nor the choice
of tangents matters. Everything is in units of the budget and of the characteristic length.
Untrained, the first proposal of a step is the flow itself.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from solvers.differentiable import contact_supports
from solvers.learned.files import SavedNetwork
from solvers.problem import GraspForceProblem
from solvers.quality.directions import unit_wrenches, weakest_directions

from .config import QualityNetworkConfig
from .flow import QualityPoint
from .preload import LeastForces

_PACE, _PACE_DECAY = 0.3, 0.9
_STEEPEST = 1.0
_LEAST_SHARE = 0.02
_SHARP = 0.03
_MOST_SPEND = 4.0
_SEEN = 12
_CONTACTS, _PROBLEM, _PAIR, _REACH, _STATE = 15, 8, 7, 6, 8


@dataclass(frozen=True, eq=False)
class QualityFeatures:
    """What the network knows of B problems with n contacts; float32.

    Args:
        contacts: (B, n, 15).
        problem: (B, 8).
        pairs: (B, n, n, 7).
        mask: (B, n) one at contacts.
        wrenches: (B, n, 6, 3) of unit forces, torques over the length.
        friction: (B, n).
        budget: (B,) N.
        priced: (B,) one where effort has a price.
        cost: (B,) logarithm of what spending the budget evenly costs, over the quality it brings.
    """

    contacts: Tensor
    problem: Tensor
    pairs: Tensor
    mask: Tensor
    wrenches: Tensor
    friction: Tensor
    budget: Tensor
    priced: Tensor
    cost: Tensor

    @classmethod
    def of(
        cls, problem: GraspForceProblem, least: LeastForces, start: QualityPoint
    ) -> "QualityFeatures":
        """Of flat float64 numpy problems, `max_quality`.

        Args:
            problem: the problems.
            least: where every preload begins.
            start: the even preload of the whole budget.
        """
        batch, n = problem.friction.shape
        mask = problem.contact_mask.astype(np.float64)
        count = mask.sum(axis=1)
        budget, length = problem.effort_budget, problem.characteristic_length
        wrenches = unit_wrenches(problem)
        scaled = wrenches.copy()
        scaled[..., :2] *= problem.friction[:, :, None, None]
        gram = np.einsum("bidx,bjdy->bijxy", scaled, scaled)
        uniform = start.normal / budget[:, None] * count[:, None]
        held = np.nan_to_num(least.forces).reshape(batch, n, 3) / budget[:, None, None]
        load = -problem.external_wrench / budget[:, None]
        load[:, 3:] /= length[:, None]
        pull = np.einsum("bndx,bd->bnx", wrenches, load)
        push = np.abs(problem.hand_jacobian.reshape(batch, n, 3, problem.n_joints)[:, :, 2])
        room = np.maximum(np.minimum(problem.torque_max, -problem.torque_min), 1e-6)
        use = np.max(push * budget[:, None, None] / room[:, None], axis=-1, initial=0.0)
        cap = np.minimum(problem.normal_max / budget[:, None], 3.0)
        centres = wrenches[..., 2]
        contacts = [
            problem.friction,
            np.linalg.norm(centres[..., 3:], axis=-1),
            pull[..., 2],
            np.linalg.norm(pull[..., :2], axis=-1),
            problem.normal_min / budget[:, None],
            cap,
            np.minimum(use, 5.0),
            np.log(np.clip(use, 1e-3, 1e3)),
            uniform,
            held[..., 2] * count[:, None],
            np.linalg.norm(held[..., :2], axis=-1) * count[:, None],
            np.sum(centres**2, axis=-1),
            np.sum(wrenches[..., :2] ** 2, axis=(-2, -1)),
            np.einsum("bnd,bmd->bnm", centres, centres).sum(axis=-1) / count[:, None],
            start.prices * count[:, None],
        ]
        before, _ = weakest_directions(problem, np.nan_to_num(least.forces[:, 2::3]))
        gained = np.maximum(start.quality - before, 1e-3 * budget)
        spent = np.maximum(start.forces.effort - least.effort, 1e-3 * budget)
        # what spending the budget evenly costs, over what it brings
        cost = problem.effort_weight * np.nan_to_num(spent) / gained
        of_problem = [
            count / 4.0,
            np.linalg.norm(load[:, :3], axis=1),
            np.linalg.norm(load[:, 3:], axis=1),
            (problem.friction * mask).sum(axis=1) / count,
            np.nan_to_num(least.effort) / budget,
            start.forces.by_torque,
            before / np.maximum(start.quality, 1e-3 * budget),
            np.log(np.clip(cost, 1e-2, 1e2)),
        ]
        pairs = [
            gram[..., 2, 2],
            np.linalg.norm(gram[..., 2, :2], axis=-1),
            np.linalg.norm(gram[..., :2, 2], axis=-1),
            np.sum(gram[..., :2, :2] ** 2, axis=(-2, -1)),
            np.linalg.det(gram[..., :2, :2]),
            np.broadcast_to(uniform[:, None, :], gram.shape[:3]),
            np.broadcast_to(uniform[:, :, None], gram.shape[:3]),
        ]
        both = (mask[:, :, None] * mask[:, None, :])[..., None]
        arrays = (
            np.stack(contacts, axis=-1) * mask[..., None],
            np.stack(of_problem, axis=-1),
            np.stack(pairs, axis=-1) * both,
            mask,
            wrenches,
            problem.friction,
            budget,
            problem.effort_weight > 0.0,
            np.log(np.clip(cost, 1e-2, 1e2)),
        )
        return cls(*(torch.as_tensor(array, dtype=torch.float32) for array in arrays))


class QualityNetwork(SavedNetwork):
    """Steps along the flow towards quality, for problems with any number of contacts."""

    file_format = "graspforce-quality-1"
    training_script = "scripts/train_quality.py"
    config_type = QualityNetworkConfig

    def __init__(self, config: QualityNetworkConfig | None = None) -> None:
        super().__init__()
        self.config = config = config or QualityNetworkConfig()
        width, pair, reach = config.width, config.pair_width, config.reach_width
        self.encoder = _two_layers(_CONTACTS + _PROBLEM, width)
        self.pairs = _two_layers(_PAIR, pair)
        self.joined = nn.Sequential(nn.Linear(width + pair, width), nn.SiLU())
        self.reach = nn.Linear(_REACH, reach)
        self.reach_of_contact = nn.Linear(width, reach)
        self.reach_out = nn.Sequential(nn.Linear(reach, reach), nn.SiLU())
        self.update = _two_layers(2 * width + 2 * reach + _STATE, width)
        self.memory = nn.Linear(width, width)
        self.move = nn.Linear(width, 2 * config.proposals)
        self.pool = nn.Sequential(nn.Linear(width + _PROBLEM, width), nn.SiLU())
        self.spend = nn.Linear(width, 1)
        nn.init.zeros_(self.move.bias)
        with torch.no_grad():
            # the first proposal is the flow itself, the others lie around it at first
            self.move.weight[:2] = 0.0
        nn.init.zeros_(self.spend.weight)
        nn.init.zeros_(self.spend.bias)

    def encode(self, features: QualityFeatures) -> Tensor:
        """(B, n, width) the memory to begin with."""
        mask = features.mask[..., None]
        wide = features.problem[:, None].expand(-1, mask.shape[1], -1)
        hidden = self.encoder(torch.cat([features.contacts, wide], dim=-1)) * mask
        pairs = self.pairs(features.pairs) * mask[:, None] * mask[..., None]
        mean = pairs.sum(dim=2) / _count(features)[..., None]
        return self.joined(torch.cat([hidden, mean], dim=-1)) * mask

    def forward(
        self, features: QualityFeatures, memory: Tensor, point: QualityPoint, step: int
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Proposed shares (m, B, n), the share of the spare effort to spend (B,), and the memory.

        Args:
            features: of the problems.
            memory: of the step before, or of `encode`.
            point: where the flow is.
            step: its number, from 0.
        """
        mask = features.mask
        shares, prices, directions, normal = (
            torch.as_tensor(array, dtype=torch.float32)
            for array in (point.shares, point.prices, point.directions[:, :_SEEN], point.normal)
        )
        reach, along = contact_supports(
            features.wrenches, features.friction, directions, normal * mask
        )
        best = reach.amax(dim=-1)
        least = best.amin(dim=-1).clamp_min(1e-9)[:, None]
        relative = (reach / least[..., None]).clamp(-5.0, 5.0)
        best = (best / least).clamp(0.0, 5.0)
        top = torch.topk(relative, 2, dim=-1).values[..., 1:]
        covering = torch.softmax(relative / _SHARP, dim=-1)
        weak = torch.softmax((1.0 - best) / _SHARP, dim=-1)
        responsible = torch.einsum("bk,bkn->bn", weak, covering)
        local = torch.stack(
            [
                relative,
                covering,
                relative - best[..., None],
                best[..., None].expand_as(relative),
                along,
                top.expand_as(relative),
            ],
            dim=-1,
        )
        hidden = self.reach(local) + self.reach_of_contact(memory)[:, None]
        hidden = self.reach_out(torch.nn.functional.silu(hidden)) * mask[:, None, :, None]
        own = torch.einsum("bk,bknc->bnc", weak, hidden)
        others = (own.sum(dim=1) / _count(features))[:, None].expand(-1, mask.shape[1], -1)
        count = _count(features)
        pressed = normal / features.budget[:, None]
        level = torch.as_tensor(point.forces.level, dtype=torch.float32) / features.budget
        asked = level[:, None] * torch.as_tensor(point.asked, dtype=torch.float32)
        state = torch.stack(
            [
                responsible,
                prices,
                torch.log(shares.clamp_min(1e-4)),
                torch.log(pressed.clamp_min(1e-4)),
                (pressed - asked) * count,
                level[:, None].expand_as(shares),
                torch.as_tensor(point.forces.by_torque)[:, None].expand_as(shares).float(),
                torch.full_like(shares, step / self.config.steps),
            ],
            dim=-1,
        )
        mean = (memory.sum(dim=1) / count)[:, None].expand_as(memory)
        new = self.update(torch.cat([memory, mean, own, others, state], dim=-1))
        memory = (memory + torch.tanh(self.memory(new))) * mask[..., None]
        pace, correction = self.move(new).movedim(-1, 0).chunk(2)
        flow = (responsible - prices) / shares.clamp_min(_LEAST_SHARE)
        pace = _PACE * _PACE_DECAY**step * torch.exp(torch.tanh(pace))
        moved = (pace * flow).clamp(-_STEEPEST, _STEEPEST) + correction
        moved = torch.log(shares.clamp_min(1e-5)) + moved
        moved = torch.where(mask > 0, moved, -torch.inf)
        pooled = memory.sum(dim=1) / count
        pooled = self.pool(torch.cat([pooled, features.problem], dim=-1))
        spend = self.spend(pooled)[:, 0]
        spend = torch.sigmoid(_MOST_SPEND * torch.tanh(spend / _MOST_SPEND - features.cost))
        spend = torch.where(features.priced > 0, spend, 1.0)
        return torch.softmax(moved, dim=-1), spend, memory


def _two_layers(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Linear(inputs, outputs), nn.SiLU(), nn.Linear(outputs, outputs), nn.SiLU()
    )


def _count(features: QualityFeatures) -> Tensor:
    return features.mask.sum(dim=1, keepdim=True)
