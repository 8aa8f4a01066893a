"""The reward: what is measured of a step, and how that becomes bounded terms and their sum."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

from gfo_env.checks import is_number
from solvers.arrays import Array
from solvers.judge import ForceResiduals

from .arguments import MOST, require


@dataclass(frozen=True)
class RewardWeights:
    """Weight w of each term of the reward.

    | Term          | Reward                        | Quantity                                  |
    | ------------- | ----------------------------- | ----------------------------------------- |
    | holding       | w (1 - m / 2), or -w if lost  | m: motion over what counts as lost        |
    |               | static mode: w (1 - 2 u)      | u = x / (x + 1), x: misfit                |
    | force_closure | w if the contacts close       | the contacts after the step               |
    | q_lrw         | w q / (q + load)              | q: q_lrw of the commanded normal forces   |
    | equilibrium   | -w r / (r + s), or -w         | r: wrench residual; -w if the contacts    |
    |               |                               | cannot balance every load (rank below 6)  |
    | friction      | -w v / (v + s)                | v: friction violation, or what a contact  |
    |               |                               | lacks of the preload, if that is more     |
    | torque        | -w v / (v + strongest limit)  | v: torque violation                       |
    | effort        | -w e                          | e: commanded forces over the largest that |
    |               |                               | an action can command, 2-norms            |
    | resistance    | w r / (r + 1)                 | r: least passive resistance of the        |
    |               |                               | commanded forces                          |

    s is the least force that balances load and preload, load the force of the load, both in N.
    Every term lies between -w and w. With the default weights the penalties together stay below the
    least reward for holding, so that it never pays to drop the object: a step with the object held
    is worth 0 to 1.15, a drop at most -0.85. Nor does it pay to squeeze for the sake of q_lrw:
    effort costs more than q_lrw brings.

    Passive resistance (`solvers.passive_resistance`) is the multiple of a disturbance that the hand
    resists, beside the load, without any motion of its joints. It foretells which grasps survive
    pushes that nobody announced, at equal effort too, where q_lrw does not (docs/holding.md). r is
    the least over twelve disturbances: forces of the environment's `push` along ± the axes of the
    object frame, torques of its `twist` about them. It is 0 where the contacts cannot balance every
    load or no joint torques carry the load. The term is off by default, and then nothing is
    computed for it. With a weight w it is paid in a drop, too, which is then worth at most
    w - 0.85; and contacts that press harder against each other have more of it, so that a large w
    asks for a larger weight of effort.

    Args:
        holding: for the object staying where it was grasped; the point of it all.
        force_closure: for contacts that could resist any load.
        q_lrw: for normal forces that can resist loads which were not announced.
        equilibrium: against forces that do not balance the load.
        friction: against forces outside the friction cones, preload included.
        torque: against forces that ask too much of the joints.
        effort: against squeezing.
        resistance: for forces that resist pushes without motion; thirteen cone programs a step.

    Raises:
        EnvironmentSettingsError: a weight is no number >= 0.
    """

    holding: float = 1.0
    force_closure: float = 0.1
    q_lrw: float = 0.05
    equilibrium: float = 0.2
    friction: float = 0.1
    torque: float = 0.1
    effort: float = 0.1
    resistance: float = 0.0

    def __post_init__(self) -> None:
        _require_weights(vars(self), vars(self))

    @classmethod
    def of(cls, given: "RewardWeights | Mapping[str, float] | None") -> "RewardWeights":
        """The weights, or those that are not the default ones by name, as from a file of settings.

        Raises:
            EnvironmentSettingsError: there is no such term, or a weight is no number >= 0.
        """
        if given is None or isinstance(given, RewardWeights):
            return given or cls()
        _require_weights(given if isinstance(given, Mapping) else {None: None}, given)
        return cls(**given)


TERMS = tuple(field.name for field in fields(RewardWeights))
"""Names of the terms."""


def _require_weights(weights: Mapping[Any, Any], given: object) -> None:
    """Raise unless they are weights by name; the error shows what was given."""
    fits = all(is_number(weight) and 0 <= weight <= MOST for weight in weights.values())
    rule = f"reward_weights are numbers >= 0 by name, {MOST:g} at most, of {', '.join(TERMS)}"
    require(fits and all(term in TERMS for term in weights), rule, given)


class ForceMeasures(NamedTuple):
    """How commanded forces do on the problem that they answer.

    Args:
        balanceable: whether the contacts can balance every load at all.
        wrench_residual: N, see `solvers.problem.equilibrium_residual`; the force of the load if
            the contacts are not balanceable.
        friction_violation: N, see `solvers.problem.residuals`; 0 if not balanceable.
        normal_violation: N, see `solvers.problem.residuals`; 0 if not balanceable.
        torque_violation: N·m, see `solvers.problem.residuals`; 0 if not balanceable.
        q_lrw: N, lowest resisted wrench of the normal forces.
        load: N, size of the force of the load.
        least_force: N, size of the least forces that balance load and preload; 1 if that is zero.
        max_torque: N·m, limit of the strongest joint.
        size: N, 2-norm of the forces.
        effort: 2-norm of the forces over that of the largest forces, in [0, 1].
        resistance: least passive resistance, in multiples; 0 where it is not measured.
    """

    balanceable: bool
    wrench_residual: float
    friction_violation: float
    normal_violation: float
    torque_violation: float
    q_lrw: float
    load: float
    least_force: float
    max_torque: float
    size: float
    effort: float
    resistance: float = 0.0

    @property
    def cone_violation(self) -> float:
        """N: friction violation or what a contact lacks of its preload, whichever is more."""
        return max(self.friction_violation, self.normal_violation)

    @property
    def misfit(self) -> float:
        """How far the forces are from statics, relative to what the load asks for; 0 if they hold.

        Wrench residual and cone violation over the least force, plus the torque violation over the
        strongest limit.
        """
        off = (self.wrench_residual + self.cone_violation) / self.least_force
        return off + self.torque_violation / self.max_torque


def evaluate_forces(
    residuals: ForceResiduals | None,
    forces: Array,
    *,
    q_lrw: float,
    load: float,
    max_force: float,
    max_torque: float,
) -> ForceMeasures:
    """What the residuals by which solvers are judged are to the reward.

    Args:
        residuals: on what the forces answer; None if the contacts cannot balance every load.
        forces: (3n,) N, in the contact frames.
        q_lrw: N, of the normal forces among them.
        load: N, size of the force of the load.
        max_force: N, largest component that a force can have.
        max_torque: N·m, limit of the strongest joint.
    """
    size = math.hypot(*forces.tolist())
    effort = relative_effort(size, len(forces), max_force)
    if residuals is None:
        return ForceMeasures(False, load, 0.0, 0.0, 0.0, q_lrw, load, 1.0, max_torque, size, effort)
    return ForceMeasures(
        balanceable=True,
        wrench_residual=residuals.equilibrium,
        friction_violation=residuals.friction,
        normal_violation=residuals.normal,
        torque_violation=residuals.torque,
        q_lrw=q_lrw,
        load=load,
        least_force=residuals.force_scale,
        max_torque=max_torque,
        size=size,
        effort=effort,
    )


def relative_effort(size: Any, count: int, max_force: float) -> Any:
    """The 2-norm of `count` components of forces over that of the largest, of `max_force` each.

    Args:
        size: N, a number or an array.
        count: of components.
        max_force: N.
    """
    return size / (max_force * max(1, count) ** 0.5)


def saturate(value: float, scale: float) -> float:
    """value / (value + scale): from 0 to 1 with a slope everywhere; both are >= 0."""
    return value / (value + scale) if value > 0 else 0.0


def holding_simulated(motion: float, *, lost: bool) -> float:
    """From 1 for an object at rest to 1/2 for one about to be lost; -1 for one that is.

    Args:
        motion: how far the object has moved or turned, over what counts as lost.
        lost: whether it is out of the hand, or has moved or turned too far in it.
    """
    return -1.0 if lost else 1.0 - motion / 2.0


def holding_static(measures: ForceMeasures) -> float:
    """From 1 for forces that hold by the laws of statics down to -1, with a slope everywhere."""
    return 1.0 - 2.0 * saturate(measures.misfit, 1.0)


def reward_terms(
    weights: RewardWeights, measures: ForceMeasures, *, holding: float, force_closure: bool
) -> dict[str, float]:
    """Every term of the reward by name, weight and sign included; the reward is their sum.

    Args:
        weights: of the terms; `RewardWeights` says what each is.
        measures: of the commanded forces.
        holding: from -1 to 1, `holding_simulated` or `holding_static`.
        force_closure: whether the contacts after the step can resist any load.
    """
    imbalance = saturate(measures.wrench_residual, measures.least_force)
    slip = saturate(measures.cone_violation, measures.least_force)
    overload = saturate(measures.torque_violation, measures.max_torque)
    return {
        "holding": weights.holding * holding,
        "force_closure": weights.force_closure * float(force_closure),
        "q_lrw": weights.q_lrw * saturate(measures.q_lrw, measures.load),
        "equilibrium": -weights.equilibrium * (imbalance if measures.balanceable else 1.0),
        "friction": -weights.friction * slip,
        "torque": -weights.torque * overload,
        "effort": -weights.effort * measures.effort,
        "resistance": weights.resistance * saturate(measures.resistance, 1.0),
    }
