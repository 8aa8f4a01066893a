"""Solvers of `max_quality`: search, flow, network, and the best uniform preload.

Imported by file: the configuration needs no torch.
"""
