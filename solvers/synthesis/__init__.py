"""Where to press: contacts that move within facets, with their forces."""

from .ascent import ascend
from .facets import ContactFacets
from .lifted import GRASP_MATRIX_FLOOR
from .rank_one import ContactSynthesis, SynthesisStatus, force_problems, internal_work, synthesise

__all__ = [
    "GRASP_MATRIX_FLOOR",
    "ContactFacets",
    "ContactSynthesis",
    "SynthesisStatus",
    "ascend",
    "force_problems",
    "internal_work",
    "synthesise",
]
