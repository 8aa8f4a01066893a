"""The demonstration: its pictures show the grasps whose figures it prints."""

import numpy as np
import pytest
from rich.progress import Progress

from gfo_env.exceptions import AcquisitionError
from gfo_env.grasps.acquisition import attempt
from gfo_env.simulation import Simulation
from solvers import make_solver
from tests.support.seeds import reseeded
from tests.support.world import held_out_objects
from training.demonstration import demonstrate

SOLVERS = {"exact": make_solver("clarabel")}


def test_replay_of_a_shown_grasp_is_that_grasp_to_the_bit() -> None:
    seed = reseeded(0)
    shown = demonstrate(held_out_objects(), SOLVERS, 2, seed, Progress(disable=True))
    assert len(shown) == 2
    simulation = Simulation(visible=True)
    for one in shown:
        rng = np.random.default_rng([seed, one.number])
        again = attempt(one.grasp_object, simulation, rng).grasp
        assert again is not None
        assert again.pose.position.tobytes() == one.grasp.pose.position.tobytes()
        assert again.joint_angles.tobytes() == one.grasp.joint_angles.tobytes()
        assert set(one.solutions["exact"].status) == {"optimal"}
        assert one.quality["exact"] >= 0
    simulation.close()


@pytest.mark.parametrize(("count", "seed"), [(0, 0), (1, -1)])
def test_arguments_that_make_no_sense(count, seed) -> None:
    with pytest.raises(AcquisitionError, match="1 or more"):
        demonstrate(held_out_objects(), SOLVERS, count, seed, Progress(disable=True))
