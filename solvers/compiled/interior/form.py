"""The interior-point kernel's own form of a grasp force problem, and its workspace.

In the forces over the force scale s, with the rows of G made orthonormal (G = L Q after the torque
rows were divided by the moment arm) and those of J_h' of length one:

    minimise   1/2 P |x|^2 + c' x + c_t t
    subject to A_k x = b_k for equilibrium and pinned joints,
               sign_j v_j - t_j t + slack_j = b_j, slack_j >= 0, v the torques and normal forces,
               (mu x_n + offset, x_t) in the second-order cone of every contact with friction.

Components that cannot move (tangential forces without friction, pinned normal forces) are no
variables: their columns are left out of every product. Where there are any, or pinned joints, the
equations are made orthonormal once more in the components that move, and those that depend on
others are dropped: the rank decides, not the number of rows. Pinned joints come first.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from solvers.arrays import Array, Indices

from ..arrays import ProblemArrays
from ..constants import MIN_MAX_NORMAL

OPTIONS: dict[str, Any] = {
    "nogil": True,
    "error_model": "numpy",
    "fastmath": {"contract"},
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
    "_nrt": False,
}
"""Of functions that only compiled code calls: without wrappers for Python, and without counting
references to the arrays that they take, which would cost more than the arithmetic."""

INLINE: dict[str, Any] = {**OPTIONS, "forceinline": True}
"""Of those that cost less than the passing of their arguments."""

ALLOCATING: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
"""Of those that make arrays."""

ENTRY: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy"}
"""Of functions that Python calls."""

PINNED = 1e-9
"""Limits closer together than this, relative to the force scale, are one value."""

_SMALLEST_COLUMN = 1e-3
"""Joints that no contact moves keep a finite scale: this share of the largest column of J_h."""

_DEPENDENT = 1e-12

_DROPPED = 4e-13
"""Length, of one, of what is left of an equation that depends on others: forces of the problem's
scale miss it by less than the judge allows."""

_ROUNDING = float(np.finfo(np.float64).eps)


class Form(NamedTuple):
    """Buffers of one problem, large enough for n contacts and n_tau joints; reused for the next.

    Orthant row j concerns entry `source[j]` of v = (torques, normal forces, 0).
    """

    counts: Indices  # contacts, joints with limits, orthant rows, pinned joints
    scale: Array  # s, moment arm, length of the longest column of J_h
    triangle: Array  # (6, 6) L
    mixing: Array  # (6 + n_tau, 6 + n_tau) T: the equations before were T times those that are kept
    kept: NDArray[np.bool_]  # (6 + n_tau,) equations that do not depend on others
    contact: Indices  # (n,) index in the problem
    rows: Array  # (n, 6 + n_tau, 3) those rows of A that touch the contact
    row: Indices  # (n, 6 + n_tau) which they are
    touched: Indices  # (n,) how many
    friction: Array  # (n,)
    slides: NDArray[np.bool_]  # (n,) has a cone
    presses: NDArray[np.bool_]  # (n,) has a free normal force
    fixed: Array  # (n,) normal force of a contact that does not press
    frozen: NDArray[np.bool_]  # (n,) contacts that cannot push, by what the constraints leave
    lower: Array  # (n,) untightened preload
    upper: Array  # (n,) untightened cap
    joint: Indices  # (n_tau,) index in the problem
    pinned: NDArray[np.bool_]  # (n_tau,)
    joint_scale: Array  # (n_tau,)
    torque_lower: Array  # (n_tau,) untightened
    torque_upper: Array  # (n_tau,)
    load: Array  # (6 + n_tau,) b of the equations before pinned forces are taken away
    noise: Array  # (n_tau,) rounding errors of the torques
    equal: Array  # (6 + n_tau,) b of the equalities
    source: Indices  # (rows,)
    sign: Array  # (rows,)
    level: Array  # (rows,) -1 where t bounds a normal force, else 0
    bound: Array  # (rows,) b
    offset: Array  # (n,) b of the cone, first component


@njit(**ALLOCATING)
def new_form(n: int, n_tau: int) -> Form:
    """An empty form for up to n contacts and n_tau joints."""
    rows = 2 * n_tau + 3 * n
    return Form(
        np.zeros(4, np.int64),
        np.zeros(3),
        np.zeros((6, 6)),
        np.zeros((6 + n_tau, 6 + n_tau)),
        np.zeros(6 + n_tau, np.bool_),
        np.zeros(n, np.int64),
        np.zeros((n, 6 + n_tau, 3)),
        np.zeros((n, 6 + n_tau), np.int64),
        np.zeros(n, np.int64),
        np.zeros(n),
        np.zeros(n, np.bool_),
        np.zeros(n, np.bool_),
        np.zeros(n),
        np.zeros(n, np.bool_),
        np.zeros(n),
        np.zeros(n),
        np.zeros(n_tau, np.int64),
        np.zeros(n_tau, np.bool_),
        np.zeros(n_tau),
        np.zeros(n_tau),
        np.zeros(n_tau),
        np.zeros(6 + n_tau),
        np.zeros(n_tau),
        np.zeros(6 + n_tau),
        np.zeros(rows, np.int64),
        np.zeros(rows),
        np.zeros(rows),
        np.zeros(rows),
        np.zeros(n),
    )


@njit(**OPTIONS)
def scale_problem(form: Form, problem: ProblemArrays) -> bool:
    """Fill everything that no tightening changes; False for a grasp map of rank below six.

    Contacts that are `frozen` stay at zero.
    """
    (
        grasp_map, hand_jacobian, friction, torque_min, torque_max, wrench, external_torque,
        normal_min, normal_max, mask,
    ) = problem  # fmt: skip
    n = 0
    for i in range(len(friction)):
        if mask[i]:
            form.contact[n] = i
            n += 1
    form.counts[0] = n
    force = torque = 0.0
    for i in range(n):
        column = 3 * form.contact[i]
        for c in range(3):
            for k in range(3):
                upper, lower = grasp_map[k, column + c], grasp_map[3 + k, column + c]
                force += upper * upper
                torque += lower * lower
    arm = np.sqrt(torque / force) if force > 0.0 and torque > 0.0 else 1.0
    form.scale[1] = arm
    load = form.load
    for k in range(6):
        unit = 1.0 if k < 3 else 1.0 / arm
        load[k] = -unit * wrench[k]
        for i in range(n):
            for c in range(3):
                form.rows[i, k, c] = unit * grasp_map[k, 3 * form.contact[i] + c]
            form.row[i, k] = k
    if not _orthonormal_rows(form):
        return False
    # the force scale of solvers.problem.scaling, in this order
    square = 0.0
    for k in range(6):
        for other in range(k):
            load[k] -= form.triangle[k, other] * load[other]
        load[k] /= form.triangle[k, k]
        square += load[k] * load[k]
    for i in range(n):
        preload = normal_min[form.contact[i]]
        square += preload * preload
    longest = need = 0.0
    for j in range(len(torque_min)):
        column = 0.0
        for i in range(n):
            for c in range(3):
                entry = hand_jacobian[3 * form.contact[i] + c, j]
                column += entry * entry
        column = np.sqrt(column)
        longest = max(longest, column)
        excess = max(external_torque[j] - torque_max[j], torque_min[j] - external_torque[j])
        if excess > 0.0 and column > 0.0:
            need = max(need, excess / column)
    square += need * need
    scale = np.sqrt(square) if square > 0.0 else 1.0
    form.scale[0] = scale
    for k in range(6):
        load[k] /= scale
    for i in range(n):
        form.touched[i] = 6
        one = form.contact[i]
        form.friction[i] = friction[one]
        low, high = normal_min[one] / scale, normal_max[one] / scale
        form.lower[i], form.upper[i] = low, high
        form.slides[i] = friction[one] > 0.0 and not form.frozen[i]
        form.presses[i] = high - low > PINNED * (1.0 + low) and not form.frozen[i]
        form.fixed[i] = 0.0 if form.presses[i] or form.frozen[i] else 0.5 * (low + high)
    form.scale[2] = longest
    joints = 0
    for pinned in (True, False):
        for j in range(len(torque_min)):
            if not (np.isfinite(torque_min[j]) or np.isfinite(torque_max[j])):
                continue
            column = 0.0
            for i in range(n):
                for c in range(3):
                    entry = hand_jacobian[3 * form.contact[i] + c, j]
                    column += entry * entry
            unit = max(np.sqrt(column), _SMALLEST_COLUMN * longest)
            unit = unit if unit > 0.0 else 1.0
            low = (torque_min[j] - external_torque[j]) / (unit * scale)
            high = (torque_max[j] - external_torque[j]) / (unit * scale)
            if (high - low <= PINNED * (1.0 + min(abs(low), abs(high)))) != pinned:
                continue
            form.pinned[joints] = pinned
            form.load[6 + joints] = 0.5 * (low + high) if pinned else 0.0
            form.joint[joints] = j
            form.joint_scale[joints] = unit
            form.torque_lower[joints] = low
            form.torque_upper[joints] = high
            form.noise[joints] = 16 * _ROUNDING * abs(external_torque[j]) / (unit * scale)
            for i in range(n):
                start = 3 * form.contact[i]
                touched = form.touched[i]
                size = 0.0
                for c in range(3):
                    form.rows[i, touched, c] = hand_jacobian[start + c, j] / unit
                    size += abs(hand_jacobian[start + c, j])
                if size > 0.0 or pinned:
                    form.row[i, touched] = 6 + joints
                    form.touched[i] = touched + 1
            joints += 1
        if pinned:
            form.counts[3] = joints
    form.counts[1] = joints
    return True


@njit(**OPTIONS)
def moves_freely(form: Form) -> bool:
    """Every component of the forces is a variable, and no joint is pinned."""
    free = form.counts[3] == 0
    for i in range(form.counts[0]):
        free &= form.slides[i] and form.presses[i]
    return bool(free)


@njit(**OPTIONS)
def reduce_equations(form: Form) -> int:
    """Make the equations orthonormal in the components that move, and drop those that depend.

    Returns:
        The first equation that contradicts those before it: nothing that moves is left in it, but a
        right side. -1 where there is none.
    """
    n, equations = form.counts[0], 6 + form.counts[3]
    mixing, kept, load = form.mixing, form.kept, form.load
    mixing[:] = 0.0
    contradiction = -1
    for k in range(equations):
        # joints in the order of what is left of them: rounding grows with what was divided by
        last = equations if k >= 6 else k + 1
        best, largest = k, -1.0
        for row in range(k, last):
            for _ in range(2):
                _subtract(form, row, k)
            length = np.sqrt(_product(form, row, row))
            if length > largest:
                best, largest = row, length
        if best != k:
            _swap(form, best, k)
        kept[k] = largest > _DROPPED
        mixing[k, k] = largest if kept[k] else 1.0
        if kept[k]:
            load[k] /= largest
            for i in range(n):
                for c in range(3):
                    form.rows[i, k, c] /= largest
            continue
        rest = load[k]
        for i in range(n):
            rest -= form.rows[i, k, 2] * form.fixed[i]
        if contradiction < 0 and abs(rest) > _DROPPED:
            contradiction = k
    return contradiction


@njit(**OPTIONS)
def _subtract(form: Form, row: int, k: int) -> None:
    """Take from a row what those before k that are kept have in common with it."""
    for other in range(k):
        if not form.kept[other]:
            continue
        share = _product(form, row, other)
        form.mixing[row, other] += share
        form.load[row] -= share * form.load[other]
        for i in range(form.counts[0]):
            for c in range(3):
                form.rows[i, row, c] -= share * form.rows[i, other, c]


@njit(**OPTIONS)
def _swap(form: Form, one: int, other: int) -> None:
    """Exchange two pinned joints."""
    for array in (form.torque_lower, form.torque_upper, form.joint_scale):
        array[one - 6], array[other - 6] = array[other - 6], array[one - 6]
    joint = form.joint
    joint[one - 6], joint[other - 6] = joint[other - 6], joint[one - 6]
    form.load[one], form.load[other] = form.load[other], form.load[one]
    for k in range(min(one, other)):
        value = form.mixing[one, k]
        form.mixing[one, k] = form.mixing[other, k]
        form.mixing[other, k] = value
    for i in range(form.counts[0]):
        for c in range(3):
            value = form.rows[i, one, c]
            form.rows[i, one, c] = form.rows[i, other, c]
            form.rows[i, other, c] = value


@njit(**OPTIONS)
def drop_equations(form: Form) -> None:
    """Empty the equations that `reduce_equations` does not keep."""
    for k in range(6 + form.counts[3]):
        if not form.kept[k]:
            form.load[k] = 0.0
            for i in range(form.counts[0]):
                for c in range(3):
                    form.rows[i, k, c] = 0.0


@njit(**INLINE)
def _product(form: Form, one: int, other: int) -> float:
    """Product of two equations, in the components that move."""
    total = 0.0
    for i in range(form.counts[0]):
        if form.slides[i]:
            total += form.rows[i, one, 0] * form.rows[i, other, 0]
            total += form.rows[i, one, 1] * form.rows[i, other, 1]
        if form.presses[i]:
            total += form.rows[i, one, 2] * form.rows[i, other, 2]
    return total


@njit(**OPTIONS)
def _orthonormal_rows(form: Form) -> bool:
    """Rows 0 to 5 of A orthonormal, by Gram and Schmidt twice over; what they were is L A."""
    n = form.counts[0]
    triangle = form.triangle
    triangle[:] = 0.0
    for k in range(6):
        before = 0.0
        for i in range(n):
            for c in range(3):
                before += form.rows[i, k, c] * form.rows[i, k, c]
        for _ in range(2):
            for other in range(k):
                share = 0.0
                for i in range(n):
                    for c in range(3):
                        share += form.rows[i, k, c] * form.rows[i, other, c]
                triangle[k, other] += share
                for i in range(n):
                    for c in range(3):
                        form.rows[i, k, c] -= share * form.rows[i, other, c]
        square = 0.0
        for i in range(n):
            for c in range(3):
                square += form.rows[i, k, c] * form.rows[i, k, c]
        if not square > _DEPENDENT * _DEPENDENT * before:
            return False
        length = np.sqrt(square)
        triangle[k, k] = length
        for i in range(n):
            for c in range(3):
                form.rows[i, k, c] /= length
    return True


@njit(**OPTIONS)
def tighten(form: Form, objective: int, delta: float) -> None:
    """Set the constraints, moved inwards by delta (outwards, if negative) of the force scale.

    Cones are shifted along their axis, so that even a contact that does not push keeps a margin.

    Args:
        form: after `scale_problem`.
        objective: code.
        delta: relative to the force scale, and to the limit where that is larger.
    """
    n, joints, equations = form.counts[0], form.counts[1], 6 + form.counts[3]
    for k in range(6 + joints):
        form.equal[k] = form.load[k] if k < equations else 0.0
    for i in range(n):
        form.offset[i] = form.friction[i] * (form.fixed[i] - delta)
        if not form.presses[i]:
            for k in range(equations):
                form.equal[k] -= form.rows[i, k, 2] * form.fixed[i]
    count = 0
    for j in range(form.counts[3], joints):
        torque = 0.0
        for i in range(n):
            if not form.presses[i]:
                for k in range(6, form.touched[i]):
                    if form.row[i, k] == 6 + j:
                        torque += form.rows[i, k, 2] * form.fixed[i]
        low, high = form.torque_lower[j], form.torque_upper[j]
        if np.isfinite(high):
            margin = delta * (1.0 + abs(high)) + (form.noise[j] if delta > 0.0 else 0.0)
            count = _add(form, count, j, 1.0, 0.0, high - margin - torque)
        if np.isfinite(low):
            margin = delta * (1.0 + abs(low)) + (form.noise[j] if delta > 0.0 else 0.0)
            count = _add(form, count, j, -1.0, 0.0, torque - low - margin)
    for i in range(n):
        low, high = form.lower[i], form.upper[i]
        if form.presses[i]:
            # the cone alone keeps a normal force from pulling
            if low > 0.0 or not form.slides[i]:
                count = _add(form, count, joints + i, -1.0, 0.0, -low - delta * (1.0 + low))
            if np.isfinite(high):
                count = _add(form, count, joints + i, 1.0, 0.0, high - delta * (1.0 + high))
        if objective == MIN_MAX_NORMAL:
            source = joints + i if form.presses[i] else joints + n
            count = _add(form, count, source, 1.0, -1.0, -form.fixed[i])
    form.counts[2] = count


@njit(**OPTIONS)
def _add(form: Form, count: int, source: int, sign: float, level: float, bound: float) -> int:
    form.source[count] = source
    form.sign[count] = sign
    form.level[count] = level
    form.bound[count] = bound
    return count + 1
