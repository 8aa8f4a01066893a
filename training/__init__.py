"""Fitting and judging: networks, agents, judged answers, and the studies behind docs/."""
