"""Settings of environments and trainings at their worst."""

from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from gfo_env.env import GraspForceEnv
from gfo_env.hand import BARRETT_BH8_280
from tests.fuzz import hostile
from tests.fuzz.outcome import WrongAnswer, tell
from tests.support.grasp_tables import random_table
from training.networks import conditioned, quality
from training.networks.quality_settings import QualityTrainingSettings
from training.networks.settings import TrainingSettings
from training.rl.settings import RlSettings

_ENVIRONMENT: dict[str, Any] = {
    "object_set": "objects",
    "split": "all",
    "object_ids": ("box.stl",),
    "target_size": 0.08,
    "grasps": None,
    "mode": "static",
    "announced": True,
    "contacts": "hand",
    "hand": BARRETT_BH8_280,
    "max_contacts": 8,
    "max_force": 20.0,
    "preload": 2.0,
    "mass_range": (0.1, 0.5),
    "friction_range": (0.4, 1.0),
    "push": 2.0,
    "twist": 0.1,
    "turn": 0.5,
    "mass_change": (0.5, 2.0),
    "friction_change": (0.5, 1.0),
    "torque_scale_range": (0.5, 1.0),
    "horizon": None,
    "exact_quality": False,
    "reward_weights": None,
    "render_mode": None,
}
_OPTIONS: dict[str, Any] = {
    "grasp": 0,
    "mass": 0.3,
    "friction": 0.6,
    "gravity": [0.0, 0.0, -9.81],
}
_PAIRS: tuple[Any, ...] = (
    *((0.5, 0.1), (0.0, 0.0), (-1.0, 1.0), (np.nan, 1.0), (1.0, np.inf), (1e-300, 1e300)),
    *((0.3,), (1, 2, 3), "ab", {1.0, 2.0}, [0.1, 0.2], np.array([0.1, 0.2]), (0.3, 0.3)),
)
_NUMBERS: tuple[Any, ...] = (10.5, 5.0, 3, 1e9, 1e-9, 10**9, "20", -0.0)


def prepare() -> None:
    """Make a set of one object and its first grasps."""
    folder = Path("objects")
    folder.mkdir(exist_ok=True)
    trimesh.creation.box((0.05, 0.06, 0.08)).export(folder / "box.stl")
    env = GraspForceEnv(**_ENVIRONMENT)
    env.reset(seed=0)
    env.close()
    random_table(np.random.default_rng(0), 40).save("grasps.npz")


def try_environment(rng: np.random.Generator) -> str:
    """One argument, option or action spoilt; what is accepted makes an episode."""
    arguments, options, what = dict(_ENVIRONMENT), {}, "an action"
    draw = rng.random()
    if draw < 0.75:
        what = str(rng.choice(list(arguments)))
        arguments[what] = _spoilt(rng)
        if rng.random() < 0.15:
            arguments["mode"] = "dynamic"
        what = f"{what}={arguments[what]!r:.40}"
    elif draw < 0.9:
        name = str(rng.choice([*_OPTIONS, "other"]))
        options = {name: _spoilt(rng)}
        what = f"options {options!r:.60}"
    tell(what)
    env = GraspForceEnv(**arguments)
    try:
        observation, _ = env.reset(seed=int(rng.integers(100)), options=options or None)
        if not env.observation_space.contains(observation):
            raise WrongAnswer("an observation that is none of its space")
        action = env.action_space.sample()
        if draw >= 0.9:
            name, action, _ = hostile.of_array(rng, np.asarray(action, dtype=np.float64))
            tell(f"action {name}")
        _, reward, *_, info = env.step(action)
        numbers = [reward, *(v for v in info.values() if isinstance(v, float))]
        if not np.isfinite(numbers).all():
            raise WrongAnswer(f"a reward or measure that is no number: {info}")
    finally:
        env.close()
    return what


def _spoilt(rng: np.random.Generator) -> Any:
    draw = rng.random()
    if draw < 0.3:
        return _PAIRS[rng.integers(len(_PAIRS))]
    if draw < 0.6:
        return _NUMBERS[rng.integers(len(_NUMBERS))]
    return hostile.of_scalar(rng)[1]


_TRAININGS: tuple[tuple[type[Any], Callable[..., Any] | None], ...] = (
    (TrainingSettings, conditioned.train),
    (QualityTrainingSettings, quality.train_quality),
    (RlSettings, None),
)
_ODD: dict[type[Any], tuple[Any, ...]] = {
    int: (-1, 0, 2, -(2**40)),
    float: (np.nan, np.inf, -np.inf, -1.0, 0.0, 0.5, 1e300, 1e-300),
    tuple: ((np.nan, 1.0), (1.0, 0.5), (-1.0, 1.0), (0.0, 0.0), (1.0, np.inf), (0.3, 0.3)),
    str: ("", "x", "../x"),
}
"""Of the type that the command line sees to."""


def try_training(rng: np.random.Generator) -> str:
    """One setting of a training spoilt; what is accepted trains for a step."""
    kind, train = _TRAININGS[rng.integers(len(_TRAININGS))]
    folder = Path(f"training_{rng.integers(2**60)}")
    small = {"steps": 1, "batch": 4, "validate_every": 1}
    base = {"grasps": Path("grasps.npz"), **small} if train else {}
    settings = kind(output=folder, **base)
    name, part = _any_field(rng, settings)
    given = getattr(part, name[-1])
    odd = _ODD.get(type(given), (None,))
    value = odd[rng.integers(len(odd))]
    if isinstance(given, tuple) and not (given and isinstance(given[0], float)):
        value = ("x",)  # pairs of a key and a value, which this is not
    tell(f"{kind.__name__}.{'.'.join(name)} = {value!r}")
    changed = replace(part, **{name[-1]: value})
    settings = replace(settings, **{name[0]: changed}) if len(name) > 1 else changed
    if train is None:
        settings.check()
    else:
        train(settings, command="")
    if isinstance(value, float | tuple) and value != ("x",) and np.isnan(value).any():
        raise WrongAnswer("a setting that is no number is accepted")
    return f"{name} = {value!r}"


def _any_field(rng: np.random.Generator, settings: Any) -> tuple[tuple[str, ...], Any]:
    """The name of a field, or of one of a field's own, and whose it is."""
    names = [field.name for field in fields(settings) if field.name not in ("grasps", "output")]
    name = str(rng.choice(names))
    part = getattr(settings, name)
    if not is_dataclass(part):
        return (name,), settings
    return (name, str(rng.choice([field.name for field in fields(part)]))), part
