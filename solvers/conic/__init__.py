"""Cone programs for Clarabel: one wrapper, and a problem in its form."""

from .grasp import ConicProgram
from .program import JOINT_SCALE, Rows, force_limits, friction_cones, maximise

__all__ = ["JOINT_SCALE", "ConicProgram", "Rows", "force_limits", "friction_cones", "maximise"]
