"""The parts of an episode: loads, observation, action, reward, and what they are made of.

Imported by file: an observation needs no simulator.
"""
