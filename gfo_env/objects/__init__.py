"""From a mesh to a rigid body: object sets and patches."""

from .meshes import Body, load_body
from .patches import Patches
from .sets import DENSITY, RANDOM_URDFS, RESCALE, GraspObject, ObjectSet

__all__ = [
    "DENSITY",
    "RANDOM_URDFS",
    "RESCALE",
    "Body",
    "GraspObject",
    "ObjectSet",
    "Patches",
    "load_body",
]
