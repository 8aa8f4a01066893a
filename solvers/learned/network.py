"""The conditioned KKT network: a few learned steps along the KKT flow of any grasp force problem.

Each step proposes one learned point, an accelerated Euler step (FISTA) of the flow of the
multipliers (`solvers.kkt.multiplier_flow`) plus a learned correction, and a Newton direction whose
Hessian is softened by learned amounts. It then takes the point with the largest dual value among
several lengths of both, so that no step can do harm. All steps share their weights, as do all
contacts and all joints.

The paper's network, the ansatz y(t) = (1 - e^-t) NN(t) fitted anew for every instance, is the case
of this one without the problem p and started at zero (`solvers.kkt.ansatz`): here y(t; p) = y0(p) +
(1 - e^-t) NN(t, p), read out at t = 0, 1, ..., `steps`. NN(t, p) is the recurrence below, which is
given 1 - e^-t as an input; between whole times it is linear. docs/network.md says how it is
trained, and what that is good for.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from solvers.kkt.ansatz import Ansatz, inner_values, interpolated
from solvers.kkt.multiplier_flow import (
    along,
    best_index,
    evaluate,
    flow_step,
    kkt_flow,
    momentum,
    newton_direction,
    proximal,
    select,
    stacked,
)
from solvers.problem import CanonicalProblem, GraspForceProblem, Multipliers

from .config import NetworkConfig
from .contact_network import ContactNetwork
from .features import (
    CONTACT_SCALARS,
    CONTACT_VECTORS,
    JOINT_SCALARS,
    Features,
    features,
    from_raw,
    squashed,
    to_range,
    to_raw,
)
from .files import SavedNetwork

_SOFTNESS = 1e-3
"""Least curvature that a contact is credited with; float32 can still factor such a Hessian."""

_LENGTHS = (0.02, 0.05, 0.12, 0.3, 0.6, 1.0, 1.7, 3.0)
"""Of the steps that are tried. Near the edge of feasibility the dual is flat and full of kinks: on
3,012 problems of objects kept out of training five lengths from 0.1 to 10 left a gap five times as
large at the 99th percentile."""


@dataclass(frozen=True, eq=False)
class _Memory:
    contact: Tensor  # (B, n, memory)
    vector: Tensor  # (B, n, 3, vector_memory)
    joint: Tensor  # (B, n_tau, joint_memory)

    def detached(self) -> "_Memory":
        return _Memory(self.contact.detach(), self.vector.detach(), self.joint.detach())


class ConditionedKktNetwork(Ansatz, SavedNetwork):
    """Multipliers of grasp force problems with any number of contacts and joints.

    A step makes one learned point, and takes the best by dual value among the steps of several
    lengths towards it and along a softened Newton direction, the plain Euler step, and staying. The
    learned corrections end in layers that start at zero: untrained, the learned point is that of
    FISTA, started at y0 = 2 G^+ w, and the network is the KKT flow with a line search. The dual
    value never falls.
    """

    file_format = "graspforce-conditioned-1"
    training_script = "scripts/train.py"
    config_type = NetworkConfig

    def __init__(self, config: NetworkConfig | None = None) -> None:
        super().__init__()
        self.config = config = config or NetworkConfig()
        state, channels, joint = config.memory, config.vector_memory, config.joint_memory
        context = state + joint
        self.encoder = ContactNetwork(config, CONTACT_SCALARS, CONTACT_VECTORS, channels)
        self.encoder_memory = nn.Linear(config.width, state)
        self.joint_encoder = nn.Linear(JOINT_SCALARS + channels, joint)
        self.joint_network = nn.Sequential(
            nn.Linear(JOINT_SCALARS + 5 + channels + joint + context, config.joint_width),
            nn.SiLU(),
            nn.Linear(config.joint_width, config.joint_width),
            nn.SiLU(),
        )
        self.joint_update = nn.Linear(config.joint_width, 2 * joint)
        self.joint_step = nn.Linear(config.joint_width, 1)
        self.contact_network = ContactNetwork(
            config,
            CONTACT_SCALARS + state + context + 3,
            CONTACT_VECTORS + 6 + joint + 2 * channels,
            channels,
        )
        self.contact_memory = nn.Linear(config.width, state)
        self.contact_step = ContactNetwork(config, state + context + 3, 4 + joint + 2 * channels, 1)
        self.softness = nn.Linear(config.width, 1)
        self.pace = nn.Linear(context + 3, 4)
        for layer in (
            self.joint_step,
            self.contact_step.unmix.linear,
            self.contact_step.normals,
            self.pace,
            self.softness,
        ):
            nn.init.zeros_(layer.weight)
            if layer.bias is not None:
                nn.init.zeros_(layer.bias)

    def forward(self, canonical: CanonicalProblem) -> Multipliers:
        """All iterates y(t; p), t = 0, ..., steps, of a batch of B canonical torch problems.

        Gradients stay within a step: each step learns to climb as far as it can from where it
        starts. Through several steps they grow without bound on nearly infeasible problems.

        Returns:
            (steps + 1, B, 6) y and (steps + 1, B, n_tau) lambda of the scaled problems.
        """
        like = canonical.problem.friction
        whole = torch.arange(self.config.steps + 1, dtype=like.dtype, device=like.device)
        return split(self.with_derivative(whole, canonical)[0])

    def start(self, problem: CanonicalProblem) -> Tensor:
        """(B, 6 + n_tau) y0(p): 2 G^+ w in the canonical coordinates, and no torque prices."""
        form = problem.problem
        return torch.cat([2.0 * form.external_wrench, torch.zeros_like(form.torque_min)], dim=-1)

    def inner(self, times: Tensor, problem: CanonicalProblem) -> tuple[Tensor, Tensor]:
        """(T, B, 6 + n_tau) NN(t, p) and its slope in t at times (T,) from 0 to `steps`.

        NN(0, p) is the flow's direction at y0, so that y' = Phi(y) holds exactly at t = 0.
        """
        states = joined(self._iterates(problem))
        first = joined(kkt_flow(problem.problem, split(states[0])))
        return interpolated(inner_values(states, first), times)

    def _iterates(self, canonical: CanonicalProblem) -> Multipliers:
        """(steps + 1, B, .) the states of the recurrence, the first of them the start."""
        here = split(self.start(canonical))
        problem = canonical.problem
        raw = self.config.coordinates == "raw"
        if raw:
            problem, here = to_raw(canonical, here)
        static = features(problem)
        memory = self._encode(problem, static)
        before, iterates = here, [here]
        for step in range(self.config.steps):
            new, after, memory = self._step(problem, static, here, before, memory, step)
            iterates.append(after)
            here, before = (point.map(Tensor.detach) for point in (after, new))
            memory = memory.detached()
        states = stacked(iterates)
        return from_raw(canonical, states) if raw else states

    def _encode(self, problem: GraspForceProblem, static: Features) -> _Memory:
        mask = static.contact_mask
        hidden, vectors = self.encoder(static.contact_scalars, static.contact_vectors)
        vectors = _bounded(vectors) * mask[..., None]
        joints = torch.cat([static.joint_scalars, _along_joints(problem, vectors)], dim=-1)
        return _Memory(
            contact=torch.tanh(self.encoder_memory(hidden)) * mask,
            vector=vectors,
            joint=torch.tanh(self.joint_encoder(joints)),
        )

    def _step(
        self,
        problem: GraspForceProblem,
        static: Features,
        here: Multipliers,
        before: Multipliers,
        memory: _Memory,
        step: int,
    ) -> tuple[Multipliers, Multipliers, _Memory]:
        """The next point without and with its extrapolation, and the memory."""
        mask = static.contact_mask
        now = evaluate(problem, here)
        # sizes of the point and of the residual: the correction vanishes where the flow rests
        count = mask.sum(dim=-2)  # (B, 1)
        size = 1.0 + torch.sqrt(torch.sum(here.equilibrium**2, dim=-1, keepdim=True) / count)
        error = torch.sum(now.equilibrium**2, dim=-1, keepdim=True)
        price_error = proximal(here.torque, now.torque, problem, 1.0) - here.torque
        error = error + torch.sum(price_error**2, dim=-1, keepdim=True)
        residual = torch.sqrt(error / count + 1e-12)
        clock = torch.full_like(size, 1.0 - math.exp(-step))
        summary = torch.cat([torch.log(size), torch.log(residual), clock], dim=-1)
        context = _pooled(memory, mask)

        # joints: (B, n_tau, .)
        local = torch.stack(
            [
                here.torque / size,
                squashed(now.torque),
                now.excess / residual,
                price_error / residual,
                torch.log(residual).expand_as(here.torque),
            ],
            dim=-1,
        )
        joint_inputs = [
            static.joint_scalars,
            local,
            _along_joints(problem, memory.vector),
            memory.joint,
            context[:, None].expand(-1, local.shape[1], -1),
        ]
        joint_hidden = self.joint_network(torch.cat(joint_inputs, dim=-1))
        joint_memory, messages = self.joint_update(joint_hidden).chunk(2, dim=-1)
        price_step = self.joint_step(joint_hidden)[..., 0]

        # contacts: (B, n, .) and (B, n, 3, .)
        def lift(vector: Tensor) -> Tensor:
            """(B, 6) in the basis Q to contact vectors (B, n, 3)."""
            return (problem.grasp_map.mT @ vector[..., None]).reshape(now.forces.shape)

        move = here.equilibrium - before.equilibrium
        flow = torch.stack(
            [
                now.prices / size[..., None],
                lift(here.equilibrium) / size[..., None],
                now.forces / size[..., None],
                lift(now.equilibrium) / residual[..., None],
                lift(move) / size[..., None],
                (now.forces + now.prices) / size[..., None],
            ],
            dim=-1,
        )
        pushed = (problem.hand_jacobian @ messages).reshape(*now.forces.shape, -1)
        seen = to_range(problem.grasp_map, memory.vector)
        vectors = torch.cat([static.contact_vectors, flow, pushed, memory.vector, seen], dim=-1)
        spread = torch.cat([context, summary], dim=-1)[:, None].expand(-1, mask.shape[1], -1)
        scalars = torch.cat([static.contact_scalars, memory.contact, spread], dim=-1)
        hidden, vector_update = self.contact_network(scalars, vectors)
        memory = _Memory(
            contact=torch.tanh(memory.contact + self.contact_memory(hidden)) * mask,
            vector=_bounded(memory.vector + vector_update) * mask[..., None],
            joint=torch.tanh(memory.joint + joint_memory),
        )

        # the correction is decided after every contact has heard of the others
        context = _pooled(memory, mask)
        spread = torch.cat([context, summary], dim=-1)
        seen = to_range(problem.grasp_map, memory.vector)
        vectors = torch.cat([flow[..., :4], pushed, memory.vector, seen], dim=-1)
        scalars = torch.cat([memory.contact, spread[:, None].expand(-1, mask.shape[1], -1)], dim=-1)
        hidden, correction = self.contact_step(scalars, vectors)
        softness = (_SOFTNESS + 0.1 * squashed(residual)) * torch.exp(
            5.0 * torch.tanh(self.softness(hidden)[..., 0])
        )
        newton = newton_direction(problem, here, now, softness)
        push = (correction[..., 0] * mask).reshape(len(mask), -1, 1)
        pace, ahead, price_pace, trust = self.pace(spread).chunk(4, dim=-1)
        # no step moves the point by much more than its size, however large the residual
        reach = size * squashed(residual)
        length = static.step * torch.exp(3.0 * torch.tanh(pace))
        equilibrium = here.equilibrium + length * now.equilibrium + trust * newton.equilibrium
        equilibrium = equilibrium + reach * (problem.grasp_map @ push)[..., 0]
        price = proximal(
            here.torque + reach * price_step + trust * newton.torque,
            now.torque,
            problem,
            static.step * torch.exp(3.0 * torch.tanh(price_pace)),
        )
        factor = momentum(step) + 0.5 * torch.tanh(ahead)
        new = Multipliers(equilibrium, price)
        ahead_of_it = along(before, new, 1.0 + factor)
        newtonian = Multipliers(here.equilibrium + newton.equilibrium, here.torque + newton.torque)
        candidates = [ahead_of_it, flow_step(problem, static.step, here, now), here]
        for target in (ahead_of_it, newtonian):
            candidates += [along(here, target, length) for length in _LENGTHS]
        best = best_index(problem, stacked(candidates))
        after = select(stacked(candidates), best)
        # momentum belongs to the first candidate alone
        kept = select(stacked([new, after]), (best > 0).long())
        return kept, after, memory


def joined(points: Multipliers) -> Tensor:
    """(..., 6 + n_tau) the state y of multipliers."""
    return torch.cat([points.equilibrium, points.torque], dim=-1)


def split(states: Tensor) -> Multipliers:
    """The multipliers of states (..., 6 + n_tau)."""
    return Multipliers(states[..., :6], states[..., 6:])


def _along_joints(problem: GraspForceProblem, vectors: Tensor) -> Tensor:
    """(B, n_tau, C) what contact vectors (B, n, 3, C) do along each column of the Jacobian."""
    return problem.hand_jacobian.mT @ vectors.flatten(1, 2)


def _bounded(vectors: Tensor) -> Tensor:
    """Contact vectors (..., 3, C) shortened to less than one."""
    return vectors / (1.0 + torch.sqrt(torch.sum(vectors**2, dim=-2, keepdim=True) + 1e-12))


def _pooled(memory: _Memory, mask: Tensor) -> Tensor:
    """(B, memory + joint_memory) means over contacts and over joints."""
    contact = memory.contact.sum(dim=-2) / mask.sum(dim=-2)
    joint = memory.joint.sum(dim=-2) / max(memory.joint.shape[-2], 1)
    return torch.cat([contact, joint], dim=-1)
