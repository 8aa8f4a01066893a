"""The error of this study."""

from solvers import GraspForceError


class SurvivalError(GraspForceError, ValueError):
    """Settings that make no sense, a file of something else, or a study that cannot be finished."""
