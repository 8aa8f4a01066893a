"""The robot hand: its published numbers, its description, its URDF and its kinematics.

Posture, kinematics, shapes and the writer of the URDF are imported by file.
"""

from .description import BARRETT_BH8_280, Gear, HandDescription, PalmRegion

__all__ = ["BARRETT_BH8_280", "Gear", "HandDescription", "PalmRegion"]
