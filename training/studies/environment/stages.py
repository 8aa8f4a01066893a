"""Where the time of a control step goes: clocks on the functions that it is made of."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from gfo_env import env as environment
from gfo_env.env import GraspForceEnv
from gfo_env.mdp.episode import Episode, SimulatedEpisode
from gfo_env.mdp.reading import Reader
from gfo_env.simulation import Simulation

from .recording import RecordedEpisode

REST = "the rest of `step`"

_STAGES: dict[str, tuple[tuple[Any, str], ...]] = {
    "physics, with its commands": (
        (Simulation, "advance"),
        (SimulatedEpisode, "_change_conditions"),
    ),
    "state and contact points out of PyBullet": (
        (Simulation, "object_pose"),
        (Simulation, "link_numbers"),
        (Simulation, "contact_numbers"),
    ),
    "contacts, problem of the next step, force closure": (
        (Reader, "read"),
        (Episode, "_face"),
        (SimulatedEpisode, "closes"),
    ),
    "residuals of the forces, q_lrw": ((Episode, "measure"),),
    "observation": ((SimulatedEpisode, "observe"),),
    "reward and info": ((environment, "reward_terms"), (GraspForceEnv, "_info")),
    REST: ((GraspForceEnv, "step"),),
}


class _Clock:
    """Adds up the time of functions, without that of other clocked functions in them."""

    def __init__(self) -> None:
        self.seconds = dict.fromkeys(_STAGES, 0.0)
        self._within = [0.0]

    def on(self, stage: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function with a clock."""

        def clocked(*arguments: Any, **named: Any) -> Any:
            self._within.append(0.0)
            begin = time.perf_counter()
            try:
                return function(*arguments, **named)
            finally:
                spent = time.perf_counter() - begin
                self.seconds[stage] += spent - self._within.pop()
                self._within[-1] += spent

        return clocked


@contextmanager
def _clocked(clock: _Clock) -> Iterator[None]:
    places = [(stage, *place) for stage, group in _STAGES.items() for place in group]
    originals = [vars(owner)[name] for _, owner, name in places]
    try:
        for (stage, owner, name), original in zip(places, originals, strict=True):
            setattr(owner, name, clock.on(stage, original))
        yield
    finally:
        for (_, owner, name), original in zip(places, originals, strict=True):
            setattr(owner, name, original)


def stage_times(env: GraspForceEnv, episodes: Sequence[RecordedEpisode]) -> dict[str, float]:
    """s of each stage of the steps of recorded episodes, resets left out.

    A clock costs up to 1 us for each of the calls, which is part of the figures.
    """
    clock = _Clock()
    for each in episodes:
        env.reset(seed=each.seed)
        with _clocked(clock):
            for action in each.actions:
                env.step(action)
    return clock.seconds
