"""Pictures: the camera's geometry, what is in them, and the arrows drawn over them."""

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from gfo_env.env import GraspForceEnv
from gfo_env.objects import GraspObject
from gfo_env.pose import Pose
from gfo_env.simulation import METRES_PER_NEWTON, Camera, Simulation, draw_forces, render
from tests.support.seeds import reseeded, seeded

CAMERA = Camera()
BLANK = np.full((CAMERA.height, CAMERA.width, 3), 255, np.uint8)


def near_the_hand(seed: int, count: int) -> np.ndarray:
    return seeded(seed).uniform([-0.05, -0.05, 0.05], [0.05, 0.05, 0.15], (count, 3))


@given(
    eye=st.tuples(st.floats(0.2, 0.5), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5)),
    width=st.integers(8, 640),
    height=st.integers(8, 480),
)
def test_projection(eye: tuple[float, float, float], width: int, height: int) -> None:
    camera = Camera(width=width, height=height, eye=eye)
    np.testing.assert_allclose(camera.axes @ camera.axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(camera.axes) == pytest.approx(1.0)
    middle = np.array([width / 2, height / 2])
    target = np.array(camera.target)
    np.testing.assert_allclose(camera.project(target), middle, atol=1e-9)
    right, up, back = camera.axes
    assert camera.project(target + 0.01 * right)[0] > middle[0]
    assert camera.project(target + 0.01 * up)[1] < middle[1]
    np.testing.assert_allclose(camera.project(target + 0.01 * back), middle, atol=1e-9)
    # half of the field of view above the target is the upper edge
    distance = np.linalg.norm(np.subtract(camera.eye, target))
    edge = target + np.tan(np.deg2rad(camera.field_of_view / 2)) * distance * up
    np.testing.assert_allclose(camera.project(edge), [width / 2, 0.0], atol=1e-9 * width * height)


def test_object_appears_where_the_camera_projects_it() -> None:
    ball = trimesh.creation.icosphere(radius=0.01)
    body = GraspObject("ball", ball, (ball,), 0.1, 4e-6 * np.eye(3))
    simulation = Simulation(visible=True)
    pictures = []
    # far from the hand, so that nothing hides it
    for position in ([0.0, -0.02, 0.21], [0.03, 0.0, 0.2], [5.0, 5.0, 5.0]):
        pose = Pose(np.array(position), np.eye(3))
        simulation.load(body, pose, simulation.hand.open_angles(0.0), friction=1.0)
        pictures.append((position, render(simulation, CAMERA).astype(int)))
    simulation.close()
    without = pictures[-1][1]
    for position, picture in pictures[:-1]:
        rows, columns = np.nonzero(np.abs(picture - without).max(axis=2) > 30)
        seen = np.array([columns.mean(), rows.mean()]) + 0.5
        assert np.linalg.norm(seen - CAMERA.project(np.array(position))) < 1.5


def test_environment_frames() -> None:
    env = GraspForceEnv(split="test", render_mode="rgb_array")
    env.reset(seed=reseeded(0))
    before = env.render()
    env.step(np.full(24, 0.3))
    after = env.render()
    env.close()
    for picture in (before, after):
        assert picture is not None
        assert picture.shape == (240, 320, 3)
        assert picture.dtype == np.uint8
        background = (picture == 255).all(axis=2)
        assert 0.3 < background.mean() < 0.95
        assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 50
    red = [
        int(((p[..., 0] > 150) & (p[..., 1] < 80) & (p[..., 2] < 90)).sum())
        for p in (before, after)
    ]
    assert red[0] == 0
    assert red[1] > 50


def test_render_without_a_mode_warns() -> None:
    env = GraspForceEnv(split="test")
    env.reset(seed=reseeded(0))
    with pytest.warns(UserWarning, match="render_mode"):
        assert env.render() is None
    env.close()


@pytest.mark.parametrize("size", [(64, 48), (321, 243)])
def test_size_of_the_picture(size: tuple[int, int]) -> None:
    env = GraspForceEnv(split="test", render_mode="rgb_array")
    env.reset(seed=reseeded(0))
    picture = render(env.simulation, Camera(width=size[0], height=size[1]))
    env.close()
    assert picture.shape == (size[1], size[0], 3)


@given(seed=st.integers(0, 99), newtons=st.floats(2.0, 10.0), angle=st.floats(0.0, 2.0 * np.pi))
def test_arrow_covers_the_force_and_little_else(seed: int, newtons: float, angle: float) -> None:
    point = near_the_hand(seed, 1)
    right, up, _ = CAMERA.axes
    force = newtons * (np.cos(angle) * right + np.sin(angle) * up)[None]
    picture = draw_forces(BLANK, CAMERA, point, force, colour=(0, 0, 0))
    rows, columns = np.nonzero((picture < 250).any(axis=2))
    inked = np.stack([columns, rows], axis=1) + 0.5
    head = CAMERA.project(point)[0]
    tail = CAMERA.project(point - METRES_PER_NEWTON * force)[0]
    shaft = np.linspace(tail, head, 50)
    distance = np.linalg.norm(inked[:, None] - shaft[None], axis=2)
    assert distance.min(axis=1).max() < 6.0
    # what lies beyond the edge of the picture cannot be inked
    seen = np.all((shaft > 0) & (shaft < [CAMERA.width, CAMERA.height]), axis=1)
    assert seen.any()
    assert distance[:, seen].min(axis=0).max() < 3.0


@given(seed=st.integers(0, 99))
def test_drawing_leaves_the_picture_and_zero_forces_alone(seed: int) -> None:
    picture = seeded(seed).integers(0, 256, BLANK.shape, dtype=np.uint8)
    kept = picture.copy()
    points = near_the_hand(seed, 3)
    np.testing.assert_array_equal(draw_forces(picture, CAMERA, points, np.zeros((3, 3))), kept)
    none = np.zeros((0, 3))
    np.testing.assert_array_equal(draw_forces(picture, CAMERA, none, none), kept)
    drawn = draw_forces(picture, CAMERA, points, np.full((3, 3), 2.0))
    np.testing.assert_array_equal(picture, kept)
    changed = (drawn != kept).any(axis=2).mean()
    assert 0.0 < changed < 0.05
