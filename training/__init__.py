"""Fitting and judging: grasp data, training of the conditioned network, evaluation."""
