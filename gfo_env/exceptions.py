"""The errors of the simulated world; all derive from `solvers.exceptions.GraspForceError`."""

from solvers.exceptions import GraspForceError


class MeshError(GraspForceError, ValueError):
    """A mesh cannot become a rigid body: unreadable, without faces, or without volume."""


class MeshWarning(UserWarning):
    """A mesh is left out of a set, or collides as something coarser than it is."""


class ObjectSetError(GraspForceError, ValueError):
    """An object set does not exist, is empty, or has no such split or object."""


class GeometryError(GraspForceError, ValueError):
    """Contacts, poses or loads whose numbers have a wrong shape, are none, or make no sense."""


class QualityError(GraspForceError, ValueError):
    """Contacts or settings for which grasp quality is not defined."""


class AcquisitionError(GraspForceError, RuntimeError):
    """No grasp could be acquired with the settings given."""


class EnvironmentSettingsError(GraspForceError, ValueError):
    """An argument or an action that the environment, or a policy for it, cannot work with."""


class ObservationError(GraspForceError, ValueError):
    """An observation with other keys, shapes or numbers than those of the environment."""


class HandError(GraspForceError, ValueError):
    """A hand whose URDF or description the simulation cannot work with."""
