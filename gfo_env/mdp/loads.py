"""What an object in the hand must be held against, step by step."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gfo_env.conditions import FRICTION_RANGE, MASS_RANGE, STANDARD_GRAVITY
from solvers.arrays import Array

from .arguments import number, number_range

LOAD_STEPS = 6
"""Steps for which one load lasts: 0.3 s, as in `holding.ShakeProtocol`."""

_UNCHANGED = (1.0, 1.0)


@dataclass(frozen=True)
class LoadSettings:
    """What loads are drawn from.

    The first load of an episode is the weight alone. Each later one is the weight and, with equal
    chances among those whose setting is not neutral, a push, a twist, a turn of the hand, another
    mass or another friction. Pushes and twists end with their load; the rest stays.

    Args:
        mass_range: kg, of the object in the beginning; uniform.
        friction_range: of the true coefficient in the beginning; uniform.
        push: N, size of a force at the centre of mass, from any side.
        twist: N·m, size of a pure torque about any axis.
        turn: rad, how far the hand turns during a load, evenly, about a horizontal axis.
        mass_change: lowest and highest factor on the mass of the beginning; uniform.
        friction_change: likewise on the friction.

    Raises:
        EnvironmentSettingsError: an argument is no number, no range, or beyond `arguments.MOST`.
    """

    mass_range: tuple[float, float] = MASS_RANGE
    friction_range: tuple[float, float] = FRICTION_RANGE
    push: float = 2.0
    twist: float = 0.05
    turn: float = np.pi / 6
    mass_change: tuple[float, float] = (0.7, 1.3)
    friction_change: tuple[float, float] = (0.8, 1.0)

    def __post_init__(self) -> None:
        for name in ("mass_range", "friction_range", "mass_change", "friction_change"):
            object.__setattr__(self, name, number_range(name, getattr(self, name)))
        for name in ("push", "twist", "turn"):
            object.__setattr__(self, name, number(name, getattr(self, name), zero=True))

    @cached_property
    def kinds(self) -> tuple[str, ...]:
        """Of loads beyond the weight, those that occur."""
        neutral = {
            "push": self.push == 0.0,
            "twist": self.twist == 0.0,
            "turn": self.turn == 0.0,
            "mass": self.mass_change == _UNCHANGED,
            "friction": self.friction_change == _UNCHANGED,
        }
        return tuple(kind for kind, unused in neutral.items() if not unused)


@dataclass(frozen=True, eq=False)
class LoadSchedule:
    """The loads of an episode of `steps` steps, hand frame.

    Args:
        gravity: (steps, 3) m/s2; the hand's own links feel it, too.
        push: (steps, 6) N and N·m at the centre of mass, weight excluded.
        mass: (steps,) kg.
        friction: (steps,) true coefficient.
    """

    gravity: Array
    push: Array
    mass: Array
    friction: Array

    def __len__(self) -> int:
        return len(self.mass)

    def from_step(self, step: int) -> "LoadSchedule":
        """The schedule without what comes before a step."""
        return LoadSchedule(
            self.gravity[step:], self.push[step:], self.mass[step:], self.friction[step:]
        )

    def wrench(self, step: int) -> Array:
        """(6,) N and N·m on the object in a step, its weight included."""
        return self._wrenches[step]

    def known_wrench(self, step: int) -> Array:
        """(6,) N and N·m: the weight that an unannounced step lets the agent know.

        That is the mass of the beginning in the gravity of the step.
        """
        return np.append(self.mass[0] * self.gravity[step], np.zeros(3))

    def force(self, step: int) -> float:
        """N, size of the force on the object in a step."""
        return self._forces[step]

    @cached_property
    def turns(self) -> list[bool]:
        """(steps,) whether gravity differs from that of the step before; not in the first."""
        return [False, *(self.gravity[1:] != self.gravity[:-1]).any(axis=1).tolist()]

    @cached_property
    def changes(self) -> list[bool]:
        """(steps,) whether mass or friction differ from the step before; not in the first."""
        mass, friction = self.mass, self.friction
        changed = (mass[1:] != mass[:-1]) | (friction[1:] != friction[:-1])
        return [False, *changed.tolist()]

    @cached_property
    def _wrenches(self) -> Array:
        wrenches: Array = self.push.copy()
        wrenches[:, :3] += self.mass[:, None] * self.gravity
        return wrenches

    @cached_property
    def _forces(self) -> list[float]:
        squares = self._wrenches[:, :3] ** 2
        return np.sqrt(squares.sum(axis=1)).tolist()


def draw_loads(
    settings: LoadSettings,
    rng: np.random.Generator,
    steps: int,
    *,
    mass: float | None = None,
    friction: float | None = None,
    gravity: Array | None = None,
) -> LoadSchedule:
    """A random schedule.

    Args:
        settings: what to draw from.
        rng: source of every random choice.
        steps: of the episode.
        mass: kg in the beginning, instead of a random one; choices drawn later stay the same.
        friction: likewise.
        gravity: (3,) m/s2, hand frame, likewise.
    """
    drawn = rng.uniform(*settings.mass_range), rng.uniform(*settings.friction_range)
    down = _direction(rng)
    first_mass = drawn[0] if mass is None else mass
    first_friction = drawn[1] if friction is None else friction
    pull = STANDARD_GRAVITY * down if gravity is None else np.asarray(gravity, dtype=np.float64)
    schedule = LoadSchedule(
        gravity=np.full((steps, 3), pull),
        push=np.zeros((steps, 6)),
        mass=np.full(steps, first_mass),
        friction=np.full(steps, first_friction),
    )
    kinds = settings.kinds
    for begin in range(LOAD_STEPS, steps, LOAD_STEPS):
        during = slice(begin, begin + LOAD_STEPS)
        if not kinds:
            break
        kind = kinds[rng.integers(len(kinds))]
        if kind == "push":
            schedule.push[during, :3] = settings.push * _direction(rng)
        elif kind == "twist":
            schedule.push[during, 3:] = settings.twist * _direction(rng)
        elif kind == "mass":
            schedule.mass[begin:] = first_mass * rng.uniform(*settings.mass_change)
        elif kind == "friction":
            schedule.friction[begin:] = first_friction * rng.uniform(*settings.friction_change)
        else:
            schedule.gravity[begin:] = _turned(schedule.gravity[begin:], settings.turn, rng)
    return schedule


def _direction(rng: np.random.Generator) -> Array:
    vector = rng.normal(size=3)
    return vector / np.sqrt(vector @ vector)


def _turned(gravity: Array, angle: float, rng: np.random.Generator) -> Array:
    """Gravity from the step on from which the hand turns: a step's share more with each step."""
    now = gravity[0]
    axis = _cross(now, _direction(rng))
    size = float(np.sqrt(axis @ axis))
    if size == 0.0:  # no gravity, or one chance in a great many
        return gravity
    share = np.minimum(np.arange(1, len(gravity) + 1) / LOAD_STEPS, 1.0)
    # the axis is at right angles to gravity: the two span the plane that it turns in
    turned: Array = np.outer(np.cos(angle * share), now)
    turned += np.outer(np.sin(angle * share), _cross(axis / size, now))
    return turned


def _cross(first: Array, second: Array) -> Array:
    """(3,) the product of two vectors; `np.cross` takes ten times as long."""
    (a, b, c), (x, y, z) = first.tolist(), second.tolist()
    return np.array([b * z - c * y, c * x - a * z, a * y - b * x])
