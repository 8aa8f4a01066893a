"""What an answer promises, decided in exact rational arithmetic: no rounding, and no code shared.

Every float64 is a rational number, so whether forces keep a constraint, what multipliers bound and
whether they prove infeasibility can be decided exactly. Nothing is imported from the project: the
formulas follow from the statement of the problem,

    minimise   1/2 |f|^2,  or  sum_i f_n,i,  or  max_i f_n,i
    subject to G f = -w,   |f_t,i| <= mu_i f_n,i,   low_i <= f_n,i <= high_i,
               torque_min <= J' f + tau_ext <= torque_max.

For any nu and lambda the Lagrangian's least value over the cones, with q = G' nu + J lambda,

    d = min over cones of [objective + q' f] + nu' w + sum_j of lambda_j+ (tau_ext - torque_max)_j
        + lambda_j- (torque_min - tau_ext)_j

is below the optimum, and without the objective it is positive only where there are no forces. In
the tangent plane f_t is best against q_t, so that what is left of each contact is a problem of its
normal force alone. Roots, which are irrational, are replaced by rational numbers on the safe side.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from math import isfinite, isqrt
from typing import Any

import numpy as np

HORIZON = 10**6
"""Times the scale of the data: where an uncapped normal force ends in a proof of infeasibility."""

_BITS = 128


def root(square: Fraction) -> tuple[Fraction, Fraction]:
    """The square root, from below and from above, to a relative 2^-128."""
    if square == 0:
        return Fraction(0), Fraction(0)
    small = max(square.denominator.bit_length() - square.numerator.bit_length(), 0)
    shift = _BITS + small // 2 + 1
    whole = isqrt((square.numerator << 2 * shift) // square.denominator)
    return Fraction(whole, 1 << shift), Fraction(whole + 1, 1 << shift)


def rational(array: Any) -> Any:
    """Nested lists of Fractions; infinities stay floats."""
    if isinstance(array, list):
        return [rational(entry) for entry in array]
    return Fraction(array) if isfinite(array) else array


def dot(one: Sequence[Fraction], other: Sequence[Fraction]) -> Fraction:
    return sum((a * b for a, b in zip(one, other, strict=True) if a and b), Fraction(0))


def sizes(one: Sequence[Fraction], other: Sequence[Fraction]) -> Fraction:
    return sum((abs(a * b) for a, b in zip(one, other, strict=True) if a and b), Fraction(0))


@dataclass(frozen=True)
class Contact:
    """What one contact may do: rational, `high` inf where there is no cap."""

    friction: Fraction
    low: Fraction
    high: Any

    def within(self, normal: Fraction) -> Fraction:
        return max(self.low, min(normal, self.high))


class Exact:
    """A single problem in rational numbers, its padding left out.

    Args:
        problem: anything with the fields of a problem, arrays without batch dimensions.
    """

    def __init__(self, problem: Any) -> None:
        mask = np.asarray(problem.contact_mask)
        self.columns = np.repeat(mask, 3)
        self.objective = str(problem.objective)

        def field_of(name: str, kept: Any = slice(None)) -> Any:
            return rational(np.asarray(getattr(problem, name), dtype=np.float64)[kept].tolist())

        self.grasp_map = field_of("grasp_map", (slice(None), self.columns))
        self.jacobian = rational(  # a row for each joint
            np.asarray(problem.hand_jacobian, dtype=np.float64)[self.columns].T.tolist()
        )
        self.wrench = field_of("external_wrench")
        self.own = field_of("external_torque")
        self.torque_min, self.torque_max = field_of("torque_min"), field_of("torque_max")
        self.contacts = [
            Contact(*numbers)
            for numbers in zip(
                field_of("friction", mask),
                field_of("normal_min", mask),
                field_of("normal_max", mask),
                strict=True,
            )
        ]

    @cached_property
    def _normal_matrix(self) -> list[list[Fraction]]:
        return [[dot(row, other) for other in self.grasp_map] for row in self.grasp_map]

    def least_force_squared(self, wrench: Sequence[Fraction]) -> Fraction:
        """|G^+ wrench|^2 = wrench' (G G')^-1 wrench."""
        return dot(wrench, _solved(self._normal_matrix, wrench))

    @cached_property
    def levers_squared(self) -> list[Fraction]:
        """The squared length of each joint's column of J."""
        return [dot(row, row) for row in self.jacobian]

    @cached_property
    def scale_squared(self) -> Fraction:
        """Of the forces that the data asks for: load, preload, torques to be brought back."""
        square = self.least_force_squared(self.wrench)
        square += sum((contact.low**2 for contact in self.contacts), Fraction(0))
        demand = Fraction(0)
        for own, low, high, lever in zip(
            self.own, self.torque_min, self.torque_max, self.levers_squared, strict=True
        ):
            excess = max(own - high, low - own)
            if excess > 0 and lever > 0:
                demand = max(demand, excess**2 / lever)
        return square + demand or Fraction(1)

    @cached_property
    def horizon(self) -> Fraction:
        """N: where an uncapped normal force ends in a proof of infeasibility."""
        return HORIZON * root(self.scale_squared)[1]

    def forces(self, forces: Any) -> list[Fraction]:
        """The forces of an answer, padding left out."""
        return rational(np.asarray(forces, dtype=np.float64)[self.columns].tolist())

    @staticmethod
    def number(problem: Any, name: str) -> Fraction:
        """A field that is one number."""
        return Fraction(float(getattr(problem, name)))

    def objective_of(self, forces: Sequence[Fraction]) -> Fraction:
        if self.objective == "min_norm":
            return dot(forces, forces) / 2
        if self.objective == "min_max_normal":
            return max(forces[2::3])
        return sum(forces[2::3], Fraction(0))


def _solved(matrix: list[list[Fraction]], right: Sequence[Fraction]) -> list[Fraction]:
    """x of matrix x = right, by elimination; the matrix is positive definite."""
    rows = [[*row, last] for row, last in zip(matrix, right, strict=True)]
    size = len(rows)
    for k in range(size):
        for below in range(k + 1, size):
            factor = rows[below][k] / rows[k][k]
            rows[below] = [a - factor * b for a, b in zip(rows[below], rows[k], strict=True)]
    x = [Fraction(0)] * size
    for k in reversed(range(size)):
        x[k] = (rows[k][size] - dot(rows[k][k + 1 : size], x[k + 1 :])) / rows[k][k]
    return x


@dataclass(frozen=True)
class Prices:
    """What multipliers make of a problem: exact but for the roots, which are on the safe side.

    Args:
        exact: the problem.
        nu: (6,) float64, of equilibrium.
        torque: (n_tau,) float64, of the torque limits; those of infinite limits count as zero.
    """

    exact: Exact
    nu: Any
    torque: Any
    _nu: list[Fraction] = field(init=False)
    _torque: list[Fraction] = field(init=False)

    def __post_init__(self) -> None:
        exact = self.exact
        prices = rational(np.asarray(self.torque, dtype=np.float64).tolist())
        usable = [
            price if (price > 0 and high < np.inf) or (price < 0 and low > -np.inf) else Fraction(0)
            for price, low, high in zip(prices, exact.torque_min, exact.torque_max, strict=True)
        ]
        nu = rational(np.asarray(self.nu, dtype=np.float64).tolist())
        object.__setattr__(self, "_nu", nu)
        object.__setattr__(self, "_torque", usable)

    @cached_property
    def terms(self) -> list[Fraction]:
        """Of the load and of each torque limit; their sum is what no force changes."""
        exact = self.exact
        load = [a * b for a, b in zip(self._nu, exact.wrench, strict=True)]
        limits = [
            price * (own - high) if price > 0 else -price * (low - own) if price else Fraction(0)
            for price, own, low, high in zip(
                self._torque, exact.own, exact.torque_min, exact.torque_max, strict=True
            )
        ]
        return load + limits

    @cached_property
    def pulls(self) -> list[tuple[Fraction, Fraction]]:
        """Of each contact: q_n, and a number that |q_t| is no larger than."""
        exact = self.exact
        rows = [*exact.grasp_map, *exact.jacobian]
        prices = [*self._nu, *self._torque]
        q = [dot(prices, column) for column in zip(*rows, strict=True)]
        return [(q[k + 2], root(q[k] ** 2 + q[k + 1] ** 2)[1]) for k in range(0, len(q), 3)]

    @cached_property
    def slopes(self) -> list[Fraction]:
        """What a newton of normal force costs at least, friction used against q_t."""
        return [
            normal - contact.friction * across
            for (normal, across), contact in zip(self.pulls, self.exact.contacts, strict=True)
        ]

    def size(self) -> Fraction:
        """The sum of the sizes of a proof's terms, uncapped contacts cut at the horizon."""
        return sum(map(abs, [*self.terms, *self._cut()]), Fraction(0))

    def farkas(self) -> Fraction:
        """The least q' f plus the constant terms: positive only where no forces exist."""
        return sum([*self.terms, *self._cut()], Fraction(0))

    def _cut(self) -> Iterator[Fraction]:
        for slope, contact in zip(self.slopes, self.exact.contacts, strict=True):
            high = contact.high if contact.high < np.inf else self.exact.horizon
            yield slope * (high if slope < 0 else contact.low)

    def bound(self) -> Any:
        """The best lower bound that multiples of the multipliers prove; -inf if they prove none."""
        if self.exact.objective == "min_norm":
            return sum(self.terms, sum(self._least_norms(), Fraction(0)))
        if self.exact.objective == "min_max_normal":
            return self._max_normal_bound()
        return self._sum_bound()

    def _least_norms(self) -> Iterator[Fraction]:
        """Of each contact the least |f|^2 / 2 + q' f.

        A convex function of the normal force, quadratic on either side of where friction binds: it
        is least at an end, at the join or at the vertex of a side.
        """
        for (normal, across), contact in zip(self.pulls, self.exact.contacts, strict=True):
            mu = contact.friction
            places = [contact.low, -normal, (mu * across - normal) / (1 + mu * mu)]
            places += [contact.high] if contact.high < np.inf else []
            places += [across / mu] if mu else []

            def value(f: Fraction, q: Fraction = normal, t: Fraction = across, mu: Fraction = mu):
                along = min(t, mu * f)
                return along * along / 2 - along * t + f * f / 2 + q * f

            yield min(value(contact.within(place)) for place in places)

    def _sum_bound(self) -> Any:
        """Of sum_i f_n,i: concave and piecewise linear in the multiple, so best at a break."""
        pairs = list(zip(self.slopes, self.exact.contacts, strict=True))
        most = min(
            (-1 / slope for slope, contact in pairs if slope < 0 and contact.high == np.inf),
            default=None,
        )
        breaks = {Fraction(0), Fraction(1)} | {-1 / slope for slope, _ in pairs if slope < 0}
        constant = sum(self.terms, Fraction(0))

        def value(multiple: Fraction) -> Fraction:
            total = multiple * constant
            for slope, contact in pairs:
                rate = 1 + multiple * slope
                total += rate * (contact.high if rate < 0 else contact.low)
            return total

        return max(value(b) for b in breaks if most is None or b <= most)

    def _max_normal_bound(self) -> Any:
        """Of max_i f_n,i = t: for each level of t at which the least value may lie, a line."""
        pairs = list(zip(self.slopes, self.exact.contacts, strict=True))
        resting = sum((s * contact.low for s, contact in pairs if s >= 0), Fraction(0))
        constant = resting + sum(self.terms, Fraction(0))
        first = max(contact.low for contact in self.exact.contacts)
        levels = {first} | {c.high for s, c in pairs if s < 0 and first < c.high < np.inf}
        lines = [
            (
                level,
                constant + sum((s * min(c.high, level) for s, c in pairs if s < 0), Fraction(0)),
            )
            for level in levels
        ]
        endless = -sum((s for s, c in pairs if s < 0 and c.high == np.inf), Fraction(0))
        return _highest(lines, 1 / endless if endless else Fraction(1))


def _highest(lines: Sequence[tuple[Fraction, Fraction]], end: Fraction) -> Fraction:
    """The most that the least of lines a + b s can be, for s from 0 to `end`."""
    lower, upper = Fraction(0), end

    def least_at(s: Fraction, steepness: int) -> tuple[Fraction, Fraction]:
        a, b = min(lines, key=lambda line: (line[0] + line[1] * s, steepness * line[1]))
        return a + b * s, b

    while True:
        (left, rise), (right, fall) = least_at(lower, 1), least_at(upper, -1)
        if rise <= 0 or fall >= 0:
            return max(left, right)
        # where the two lines meet, nothing is higher than there
        meeting = (right - fall * upper - left + rise * lower) / (rise - fall)
        value, slope = least_at(meeting, 1)
        if value == left + rise * (meeting - lower):
            return value
        lower, upper = (meeting, upper) if slope > 0 else (lower, meeting)
