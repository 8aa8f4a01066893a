"""From a mesh to a rigid body: object sets, surfaces and patches."""

from .meshes import Body, load_body
from .patches import Patches
from .sets import DENSITY, RANDOM_URDFS, GraspObject, ObjectSet
from .surface import Surface, nearest_points

__all__ = [
    "DENSITY",
    "RANDOM_URDFS",
    "Body",
    "GraspObject",
    "ObjectSet",
    "Patches",
    "Surface",
    "load_body",
    "nearest_points",
]
