"""What compiled code knows as numbers of its own.

Written out, because `cache.digest` would not notice a change elsewhere; tests compare them with
`solvers.problem.OBJECTIVES` and `solvers.duality.FORCE_HORIZON`.
"""

MIN_NORM, SUM_NORMAL, MIN_MAX_NORMAL = 0, 1, 2
"""The objectives."""

FORCE_HORIZON = 1e6
"""In units of the force scale."""
