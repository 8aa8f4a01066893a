"""The one PyBullet client, its meshes, and pictures of what it holds."""

from .rendering import (
    LOAD_COLOUR,
    METRES_PER_NEWTON,
    Camera,
    Picture,
    draw_forces,
    picture_of_grasp,
    render,
)
from .simulation import LINK_NUMBERS, SOLVER_ITERATIONS, TIME_STEP, Simulation

__all__ = [
    "LINK_NUMBERS",
    "LOAD_COLOUR",
    "METRES_PER_NEWTON",
    "SOLVER_ITERATIONS",
    "TIME_STEP",
    "Camera",
    "Picture",
    "Simulation",
    "draw_forces",
    "picture_of_grasp",
    "render",
]
