"""The errors that GraspForce raises on purpose: one tree, so one `except` catches them all."""


class GraspForceError(Exception):
    """Base of every error that this project raises on purpose."""


class ProblemError(GraspForceError, ValueError):
    """A grasp force problem is malformed: a shape, a value or a rank that no solver can use."""


class UnknownSolverError(GraspForceError, ValueError):
    """No solver is registered under the requested name."""


class SolverError(GraspForceError, RuntimeError):
    """A solver was asked for something that it cannot do, such as an objective it lacks."""


class MissingDependencyError(GraspForceError, ImportError):
    """An optional package is needed; the message says how to install it."""


class UnreadableFileError(GraspForceError, ValueError):
    """A file is damaged, or is something else than it should be."""


class UnwritableFileError(GraspForceError, OSError):
    """The system refuses to write a file: a full disk, a folder without permission, a limit."""
