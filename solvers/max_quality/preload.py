"""Feasible forces from shares of the preload: the exact repair of what is to maximise quality.

Contact i is asked for a preload of level * share_i, the level as high as the effort allows; the
least-norm forces are the answer. The level is found by bracketing, and the effort met exactly by
the mean of the forces at either end of the bracket: all constraints are convex.
"""

from dataclasses import dataclass

import numpy as np

from solvers.arrays import Array, Mask
from solvers.compiled.newton.batch import solve_batch
from solvers.duality import cone_slope, contact_duals
from solvers.exact.chain import answered_in_turn
from solvers.judge import Status, judge_flat
from solvers.problem import GraspForceProblem, Multipliers

_ROUNDS = 20
_WIDTH = 4e-3
"""Relative width of the bracket of the level at which torque limits end it."""

_WIDTH_OF_EFFORT = 0.01
"""The same where the effort does: the mean of the forces at both ends keeps the preloads of a level
in between, so that a wide bracket costs next to nothing."""

_ROUNDING = 4 * np.finfo(float).eps
"""For each term of a sum of normal forces, relative: more than adding up and mixing round off."""


@dataclass(frozen=True, eq=False)
class LeastForces:
    """Where every preload begins.

    Args:
        forces: (B, 3n) N within the budget: least-norm forces, or if these exceed the budget, their
            mean with forces of least effort; NaN if there are none.
        effort: (B,) N, sum of normal forces.
        multipliers: that prove that there are none.
    """

    forces: Array
    effort: Array
    multipliers: Multipliers

    @property
    def found(self) -> Mask:
        """(B,) whether there are forces within the budget."""
        return np.isfinite(self.effort)


@dataclass(frozen=True, eq=False)
class PreloadedForces:
    """The forces of shares, and what limits their level.

    Args:
        forces: (B, 3n) N; NaN without forces within the budget.
        level: (B,) N, the preload of contact i is level * share_i.
        effort: (B,) N, sum of normal forces.
        by_torque: (B,) whether torque limits or caps end the level, and not the effort; also where
            nothing may be spent.
        proof: where they do, multipliers that prove that there is not much more; else zero.
    """

    forces: Array
    level: Array
    effort: Array
    by_torque: Mask
    proof: Multipliers


def least_forces(problem: GraspForceProblem) -> LeastForces:
    """Forces of flat `max_quality` problems to begin with."""
    convex = problem.constraints()
    answer = solve_batch(convex)
    forces = np.where(answer.solved[:, None], answer.forces, np.nan)
    multipliers = Multipliers(answer.equilibrium_dual, answer.torque_dual)
    fits = effort(forces) <= rounded_inwards(problem.effort_budget, problem.n_contacts)
    rest = np.flatnonzero(~fits & ~answer.infeasible)
    if len(rest):
        some = problem[rest]
        linear = some.constraints("sum_normal").flat()
        least = answered_in_turn(linear)
        verdict = judge_flat(linear, least.forces, least.multipliers)
        held = np.isin(verdict.status, (Status.FEASIBLE.value, Status.OPTIMAL.value))
        first = np.where(held[:, None], least.forces, np.nan)
        forces[rest] = within(first, forces[rest], some.effort_budget)
        multipliers.equilibrium[rest] = least.multipliers.equilibrium
        multipliers.torque[rest] = least.multipliers.torque
    return LeastForces(forces, effort(forces), multipliers)


def preloaded(
    problem: GraspForceProblem, least: LeastForces, shares: Array, limit: Array
) -> PreloadedForces:
    """Least-norm forces with the largest preload of given shares.

    Args:
        problem: flat, `max_quality`.
        least: of `least_forces`.
        shares: (B, n) >= 0, sum 1 over the contacts, 0 at padding.
        limit: (B,) N, effort that is allowed; forces of more effort than `least` need it.
    """
    convex = problem.constraints()
    count = len(problem)
    inside = rounded_inwards(limit, problem.n_contacts)
    low, high = np.zeros(count), limit / np.maximum(shares.sum(axis=1), 1e-12)
    forces, more = least.forces.copy(), np.full_like(least.forces, np.nan)
    efforts, over = least.effort.copy(), np.full(count, np.nan)
    nu, price = np.zeros((count, 6)), np.zeros((count, problem.n_joints))
    rows = np.flatnonzero(least.found & (least.effort < inside))
    for step in range(_ROUNDS):
        width = np.where(np.isnan(over[rows]), _WIDTH, _WIDTH_OF_EFFORT)
        rows = rows[high[rows] - low[rows] > width * high[rows]]
        if not len(rows):
            break
        width = high[rows] - low[rows]
        room, excess = inside[rows] - efforts[rows], over[rows] - inside[rows]
        # the effort is nearly linear in the level; without one at the far end, halve
        guess = 0.5 if step else 0.7
        share = np.where(np.isnan(excess), guess, room / (room + excess))
        # aim at either side of the root in turn, so that the bracket closes from both
        share = np.clip(share + (1e-4 if step % 2 else -1e-4), 0.02, 0.98)
        level = low[rows] + share * width
        asked = np.minimum(level[:, None] * shares[rows], problem.normal_max[rows])
        some = convex[rows].derived(normal_min=np.maximum(problem.normal_min[rows], asked))
        answer = solve_batch(some)
        solved = answer.solved
        here = effort(answer.forces)
        fits = solved & (here <= inside[rows])
        below, above = rows[fits], rows[~fits]
        low[below], forces[below], efforts[below] = level[fits], answer.forces[fits], here[fits]
        high[above] = level[~fits]
        more[above] = np.where(solved[~fits, None], answer.forces[~fits], np.nan)
        over[above] = np.where(solved[~fits], here[~fits], np.nan)
        proven = answer.infeasible
        nu[rows[proven]], price[rows[proven]] = (
            answer.equilibrium_dual[proven],
            answer.torque_dual[proven],
        )
    by_torque = np.isnan(over)
    nu[~by_torque], price[~by_torque] = 0.0, 0.0
    mixed = np.where(by_torque[:, None], forces, within(forces, more, limit))
    share = (effort(mixed) - efforts) / np.where(over > efforts, over - efforts, 1.0)
    level = np.where(by_torque, low, low + share * (high - low))
    return PreloadedForces(mixed, level, effort(mixed), by_torque, Multipliers(nu, price))


def ceiling_duals(problem: GraspForceProblem, multipliers: Multipliers) -> Array:
    """(B, n) how much sooner torque limits end a preload for a newton more at a contact.

    Of multipliers that prove infeasibility; N of proof per N.
    """
    prices = contact_duals(problem, multipliers)
    slope = np.maximum(cone_slope(problem, prices), 0.0)
    return np.asarray(np.where(problem.contact_mask, slope, 0.0))


def effort(forces: Array) -> Array:
    """(B,) N, sum of normal forces (B, 3n)."""
    return forces[:, 2::3].sum(axis=-1)


def without_padding(problem: GraspForceProblem, forces: Array) -> Array:
    """(B, 3n) N, forces with zeros at padding contacts, where there are none, too."""
    return np.where(np.repeat(problem.contact_mask, 3, axis=-1), forces, 0.0)


def rounded_inwards(limit: Array, contacts: int) -> Array:
    """(B,) N, hardly less than the limit: an effort that keeps it in whatever order it is summed.

    Processors add up the same normal forces in different orders, as many at once as they can.
    """
    return limit * (1.0 - _ROUNDING * (contacts + 1))


def within(few: Array, many: Array, limit: Array) -> Array:
    """(B, 3n) N on the way from `few` to `many`, as far as an effort within the limit allows.

    All constraints are convex, so that feasible forces lie between feasible forces. NaN where even
    `few` exceed the limit; `few` where `many` are none. The way ends inside of the limit by what
    sums round off, so that the effort keeps it however it is added up.

    Args:
        few: (B, 3n) N.
        many: (B, 3n) N.
        limit: (B,) N, effort.
    """
    low, high = effort(few), effort(many)
    inside = rounded_inwards(limit, few.shape[-1] // 3)
    share = np.where(high > inside, (inside - low) / np.where(high > low, high - low, 1.0), 1.0)
    share = np.where(np.isfinite(high), np.clip(share, 0.0, 1.0), 0.0)[:, None]
    mean = np.where(share > 0.0, few + share * (np.nan_to_num(many) - few), few)
    mean = np.where(share >= 1.0, many, mean)  # to the bit
    mean[~(low <= limit)] = np.nan
    return mean
