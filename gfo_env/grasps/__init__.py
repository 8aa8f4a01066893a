"""Grasps: attempts at them, tables, collections, and the problems that they pose.

All but the table need the simulator, and are imported by file.
"""

from .table import GraspTable, GraspTableError

__all__ = [
    "GraspTable",
    "GraspTableError",
]
