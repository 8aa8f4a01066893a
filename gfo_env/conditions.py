"""The conditions under which grasps are held, wherever nobody asks for others."""

from scipy import constants

STANDARD_GRAVITY: float = constants.g
"""m/s2."""

MASS_RANGE = (0.1, 0.5)
"""kg; objects are given a mass from it, because a mesh says nothing of density."""

FRICTION_RANGE = (0.4, 1.0)
"""Of the true coefficient between object and hand."""

FRICTION_FACTOR = 0.8
"""Share of the friction that forces are planned with. Contacts move while they are loaded; forces
on the edge of the true cones slip."""

PRELOAD = 3.0
"""N, least normal force of every contact: with it more grasps hold than without, and than with 2 N;
above 4 N friction has less to spare. docs/physics.md has the figures."""

JOINT_FRICTION = 0.01
"""N·m of dry friction in every joint, 0.5 to 1 % of its strength. Without any, grasps roll out of
fingers that push with constant torques; ten times more holds objects that the forces do not."""
