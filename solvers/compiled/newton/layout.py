"""Where the numbers of one problem lie in the workspace of a kernel."""

from typing import NamedTuple

from numba import njit

from ..lanes import KERNEL

EQUILIBRIUM = 6
"""Rows of G."""


class Layout(NamedTuple):
    """First slots of the parts of a workspace, for n contacts and m joints.

    Data in the scaled units of `setup.prepare`; `inner_*` are the limits moved inwards.
    """

    n: int
    m: int
    rows: int  # (6 + m, 3n) the rows of G, made orthonormal, then the columns of J_h
    load: int  # (6) w
    friction: int  # (n)
    low: int  # (n) preload
    high: int  # (n) cap
    inner_cone: int  # (4n) friction mu, 1 / (1 + mu^2), preload, cap
    wide_cone: int  # (4n) the same, for proofs
    torque_low: int  # (m)
    inner_torque_low: int
    torque_high: int
    inner_torque_high: int
    equation: int  # (m) one for joints whose limits are one value, else zero
    row_scale: int  # (1) moment arm
    scale: int  # (1) force scale, N
    column: int  # (m) scales of the columns of J_h
    factor: int  # (36) triangular factor of G G'
    y: int  # (6) multipliers of equilibrium
    price: int  # (m) of the torques
    prices: int  # (3n) q
    forces: int  # (3n) projection of -q
    curvature: int  # (6n) its Jacobian: 11, 12, 22, 13, 23, 33 of each contact
    limit: int  # (m) torque that a joint in play should have
    play: int  # (m) one for joints in play, else zero
    gradient: int  # (6 + m)
    weighted: int  # (6 + m, 3n) rows times curvature
    hessian: int  # (6 + m, 6 + m), then its triangular factor
    step: int  # (6 + m)
    push: int  # (3n) rows' step
    trial_prices: int  # (3n)
    trial_price: int  # (m)
    candidate: int  # (3n) forces
    error: int  # (6 + m)
    answer: int  # (3n) forces
    answer_y: int  # (6)
    answer_price: int  # (m)
    goal: int  # (1) dual value above which a proof is looked for
    code: int  # (1) see `ascent`
    steps: int  # (1) Newton steps
    length: int


@njit(**KERNEL)
def layout(n: int, m: int) -> Layout:
    """The layout for n contacts and m joints."""
    k, w = EQUILIBRIUM + m, 3 * n
    rows = 0
    load = rows + k * w
    friction = load + 6
    low = friction + n
    high = low + n
    inner_cone = high + n
    wide_cone = inner_cone + 4 * n
    torque_low = wide_cone + 4 * n
    inner_torque_low = torque_low + m
    torque_high = inner_torque_low + m
    inner_torque_high = torque_high + m
    equation = inner_torque_high + m
    row_scale = equation + m
    scale = row_scale + 1
    column = scale + 1
    factor = column + m
    y = factor + 36
    price = y + 6
    prices = price + m
    forces = prices + w
    curvature = forces + w
    limit = curvature + 6 * n
    play = limit + m
    gradient = play + m
    weighted = gradient + k
    hessian = weighted + k * w
    step = hessian + k * k
    push = step + k
    trial_prices = push + w
    trial_price = trial_prices + w
    candidate = trial_price + m
    error = candidate + w
    answer = error + k
    answer_y = answer + w
    answer_price = answer_y + 6
    goal = answer_price + m
    code = goal + 1
    steps = code + 1
    length = steps + 1
    return Layout(
        n,
        m,
        rows,
        load,
        friction,
        low,
        high,
        inner_cone,
        wide_cone,
        torque_low,
        inner_torque_low,
        torque_high,
        inner_torque_high,
        equation,
        row_scale,
        scale,
        column,
        factor,
        y,
        price,
        prices,
        forces,
        curvature,
        limit,
        play,
        gradient,
        weighted,
        hessian,
        step,
        push,
        trial_prices,
        trial_price,
        candidate,
        error,
        answer,
        answer_y,
        answer_price,
        goal,
        code,
        steps,
        length,
    )
