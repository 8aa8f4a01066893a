"""Reinforcement learning on the environment: agents, their rivals, judging; imported by file."""
