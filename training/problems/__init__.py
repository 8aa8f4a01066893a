"""Seeded random problems and tasks on grasps.

Imported by file: tasks need the simulated world.
"""
