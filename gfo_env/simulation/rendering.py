"""Pictures of the hand and its object, with forces drawn over them; no display and no GL needed."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from gfo_env.contacts import Contacts
from gfo_env.pose import Pose
from solvers.arrays import Array

from .simulation import Simulation

Picture = NDArray[np.uint8]

METRES_PER_NEWTON = 0.008
"""Length of an arrow in the scene: 5 N are 4 cm, twice the width of a finger."""

FORCE_COLOUR = (200, 30, 45)
LOAD_COLOUR = (25, 95, 200)

_OVERSAMPLING = 2
_DRAWING_SCALE = 4
_NEAR, _FAR = 0.01, 3.0
_LIGHT = (0.5, -0.6, 1.0)
_SHAFT = 0.009
_HEAD = 0.036
_OUTLINE = (255, 255, 255)


@dataclass(frozen=True)
class Camera:
    """A pinhole camera that looks at the hand, upright along the hand frame's z axis.

    Args:
        width: pixels.
        height: pixels.
        eye: (3,) m, where it stands in the hand frame; not straight above `target`.
        target: (3,) m, what is in the middle of the picture.
        field_of_view: degrees, vertical.
    """

    width: int = 320
    height: int = 240
    eye: tuple[float, float, float] = (0.27, -0.33, 0.27)
    target: tuple[float, float, float] = (0.0, 0.0, 0.095)
    field_of_view: float = 31.0

    @property
    def axes(self) -> Array:
        """(3, 3) rows: right, up and back of the camera in the hand frame."""
        back = np.subtract(self.eye, self.target)
        back /= np.linalg.norm(back)
        right = np.cross([0.0, 0.0, 1.0], back)
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(back, right), back])

    @property
    def view_matrix(self) -> Array:
        """(4, 4) hand frame to camera frame, as OpenGL has it."""
        view = np.eye(4)
        view[:3, :3] = self.axes
        view[:3, 3] = -self.axes @ self.eye
        return view

    @property
    def projection_matrix(self) -> Array:
        """(4, 4) camera frame to clip coordinates, as OpenGL has it."""
        focal = 1.0 / np.tan(np.deg2rad(self.field_of_view) / 2.0)
        depth = _NEAR - _FAR
        projection = np.zeros((4, 4))
        projection[0, 0] = focal * self.height / self.width
        projection[1, 1] = focal
        projection[2, 2:] = (_NEAR + _FAR) / depth, 2.0 * _NEAR * _FAR / depth
        projection[3, 2] = -1.0
        return projection

    def project(self, points: Array) -> Array:
        """(..., 2) pixels, right and down from the corner, of (..., 3) points of the hand frame.

        Points must lie in front of the camera.
        """
        homogeneous = np.concatenate([points, np.ones((*points.shape[:-1], 1))], axis=-1)
        clip = homogeneous @ (self.projection_matrix @ self.view_matrix).T
        normalised = clip[..., :2] / clip[..., 3:]
        return (normalised * [0.5, -0.5] + 0.5) * [self.width, self.height]


def render(simulation: Simulation, camera: Camera = Camera()) -> Picture:
    """(height, width, 3) RGB picture of the simulation as it is, anti-aliased.

    Args:
        simulation: loaded, and made with `visible=True`: nothing else has an object to show.
        camera: where to look from.
    """
    p = simulation.bullet
    width, height = _OVERSAMPLING * camera.width, _OVERSAMPLING * camera.height
    _, _, colours, _, _ = p.getCameraImage(
        width,
        height,
        # the engine reads matrices column by column
        camera.view_matrix.T.ravel().tolist(),
        camera.projection_matrix.T.ravel().tolist(),
        lightDirection=_LIGHT,
        shadow=0,
        renderer=p.ER_TINY_RENDERER,
        physicsClientId=simulation.client,
    )
    large = np.asarray(colours, dtype=np.uint8).reshape(height, width, 4)[:, :, :3]
    small = Image.fromarray(large).resize((camera.width, camera.height), Image.Resampling.BOX)
    return np.asarray(small)


def draw_forces(
    picture: Picture,
    camera: Camera,
    points: Array,
    forces: Array,
    *,
    colour: tuple[int, int, int] = FORCE_COLOUR,
) -> Picture:
    """A copy of the picture with an arrow for each force, which ends where the force acts.

    Arrows end at their points because contact forces push: the shaft then lies in the finger that
    pushes, and the head touches the object. For a load that pulls, move the point by
    `METRES_PER_NEWTON` times the force. Arrows are drawn over everything, hidden points included.

    Args:
        picture: (height, width, 3), from `render` with this camera.
        camera: that took the picture.
        points: (k, 3) m, where the forces act, hand frame.
        forces: (k, 3) N, hand frame. Forces of zero are not drawn.
        colour: RGB.
    """
    size = (_DRAWING_SCALE * camera.width, _DRAWING_SCALE * camera.height)
    layer = Image.new("RGBA", size)
    draw = ImageDraw.Draw(layer)
    heads = _DRAWING_SCALE * camera.project(points)
    tails = _DRAWING_SCALE * camera.project(points - METRES_PER_NEWTON * forces)
    # the farthest first, so that nearer arrows lie over it
    for index in np.argsort(points @ camera.axes[2]):
        if forces[index].any():
            corners = _arrow(tails[index], heads[index], _SHAFT * size[1], _HEAD * size[1])
            draw.polygon(corners, fill=colour, outline=_OUTLINE, width=_DRAWING_SCALE)
    small = layer.resize((camera.width, camera.height), Image.Resampling.BOX)
    base = Image.fromarray(picture)
    base.paste(small, mask=small.getchannel("A"))
    return np.asarray(base)


def picture_of_grasp(
    simulation: Simulation, pose: Pose, contacts: Contacts, forces: Array, load: Array
) -> Picture:
    """(240, 320, 3) RGB picture of a simulation, with arrows for forces and load.

    Args:
        simulation: loaded, and made with `visible=True`.
        pose: of the object.
        contacts: where the forces act.
        forces: (3n,) N, in the contact frames.
        load: (3,) N at the centre of mass, hand frame.
    """
    camera = Camera()
    pulled = pose.position + METRES_PER_NEWTON * load
    picture = draw_forces(
        render(simulation, camera), camera, pulled[None], load[None], colour=LOAD_COLOUR
    )
    frames = pose.rotation @ contacts.frames
    in_hand = np.einsum("nij,nj->ni", frames, forces.reshape(-1, 3))
    return draw_forces(picture, camera, pose.to_hand(contacts.positions), in_hand)


def _arrow(tail: Array, head: Array, shaft: float, size: float) -> list[tuple[float, float]]:
    """Corners of an arrow from tail to head: half-width of the shaft, length of the head."""
    length = float(np.linalg.norm(head - tail))
    along = (head - tail) / length if length > 0 else np.array([0.0, -1.0])
    across = np.array([-along[1], along[0]])
    size = min(size, 0.6 * length)
    neck = head - size * along
    corners = (
        tail - shaft * across,
        neck - shaft * across,
        neck - 0.5 * size * across,
        head,
        neck + 0.5 * size * across,
        neck + shaft * across,
        tail + shaft * across,
    )
    return [(float(x), float(y)) for x, y in corners]
