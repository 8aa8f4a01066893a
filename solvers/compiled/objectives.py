"""The objectives as the numbers that compiled code knows them by."""

MIN_NORM, SUM_NORMAL, MIN_MAX_NORMAL = 0, 1, 2
"""In the order of `solvers.problem.OBJECTIVES`; written out, because `sources.digest` would not
notice a change of that order."""
