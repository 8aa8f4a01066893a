"""Settings that every test shares; read before any test imports a numerical library."""

import os
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import settings

if TYPE_CHECKING:
    from gfo_env.env import GraspForceEnv

# The workers of pytest-xdist fill the cores by themselves.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MPLBACKEND", "Agg")

# No deadline: how long an example takes says more about the machine than about the code.
settings.register_profile("local", deadline=None)
_OTHER_INPUTS = os.environ.get("GRASPFORCE_TEST_SEED", "")  # see `tests.support.seeds`
# The same examples in every run, so that a failure belongs to the change that shows it.
settings.register_profile("ci", parent=settings.get_profile("local"), derandomize=True)
settings.load_profile("ci" if os.environ.get("CI") and not _OTHER_INPUTS else "local")


def pytest_report_header() -> list[str]:
    """What a report from another machine must say to be read."""
    from tests.support.kernels import kernels

    inputs = f"{_OTHER_INPUTS or 'those of every day'} (GRASPFORCE_TEST_SEED)"
    return [f"{what}: {which}" for what, which in {**kernels(), "random inputs": inputs}.items()]


@pytest.fixture(scope="module")
def shared() -> Iterator["GraspForceEnv"]:
    """The environment, for tests that begin with a seeded reset: none sees what others left."""
    from gfo_env.env import GraspForceEnv

    env = GraspForceEnv(split="test")
    yield env
    env.close()


@pytest.fixture
def make() -> Iterator[Callable[..., "GraspForceEnv"]]:
    """Makes environments of held-out objects, which are closed afterwards."""
    from gfo_env.env import GraspForceEnv

    made: list[GraspForceEnv] = []

    def factory(**arguments: Any) -> GraspForceEnv:
        made.append(GraspForceEnv(**{"split": "test"} | arguments))
        return made[-1]

    yield factory
    for env in made:
        env.close()
