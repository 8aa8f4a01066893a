"""URDFs that PyBullet would misread: the copy that it gets is what the file means."""

import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pybullet as p
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from gfo_env.exceptions import HandError
from gfo_env.hand import HandDescription
from gfo_env.hand.inertia import FRAME_MASS, mend_inertia
from gfo_env.pose import Pose
from gfo_env.simulation import Simulation
from tests.support.world import held_out_objects

LIMIT = '<limit lower="0" upper="1" effort="1" velocity="1"/>'
BALL = '<collision><origin xyz="0 0 0.01"/><geometry><sphere radius="0.01"/></geometry></collision>'
BODY = (
    '<inertial><mass value="0.1"/><inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" '
    'iyz="0"/></inertial>'
)
SAID: dict[str, Any] = {
    "fingertip_links": ["tip"],
    "closing_joints": ["j"],
    "closing_speed": 1.0,
    "closing_torque": 0.5,
    "palm": 0.0,
}


def urdf(palm: str, tip: str, joint: str = '<axis xyz="0 0 1"/>', kind: str = "revolute") -> str:
    return (
        f'<robot name="hand"><link name="palm">{palm}</link><link name="tip">{tip}</link>\n'
        f'<joint name="j" type="{kind}"><parent link="palm"/><child link="tip"/>{joint}{LIMIT}'
        "</joint></robot>"
    )


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "graspforce" / "hands"


@pytest.fixture
def save(tmp_path):
    def write(content: str, encoding: str = "utf-8") -> Path:
        path = tmp_path / "hand.urdf"
        path.write_text(content, encoding=encoding)
        return path

    return write


def loaded(hand: HandDescription) -> tuple[Any, ...]:
    """What the engine makes of the tip: dynamics, collision shapes, where it is at 0.5."""
    client = p.connect(p.DIRECT)
    flags = p.URDF_USE_INERTIA_FROM_FILE
    body = p.loadURDF(str(hand.urdf), useFixedBase=True, flags=flags, physicsClientId=client)
    box = p.getAABB(body, 0, physicsClientId=client)
    p.resetJointState(body, 0, 0.5, physicsClientId=client)
    answer = (
        p.getDynamicsInfo(body, 0, physicsClientId=client),
        p.getCollisionShapeData(body, 0, physicsClientId=client),
        p.getLinkState(body, 0, computeForwardKinematics=1, physicsClientId=client)[4],
        box,
    )
    p.disconnect(client)
    return answer


def test_a_good_file_is_used_as_it_is(save, cache) -> None:
    path = save(urdf(BODY + BALL, BODY + BALL))
    assert HandDescription.from_urdf(path, **SAID).urdf == path
    assert not cache.exists()


def test_frames_get_next_to_no_mass_without_a_word(save, cache) -> None:
    joint = '<joint name="f" type="fixed"><parent link="tip"/><child link="frame"/></joint>'
    frame = f'<link name="frame"/>{joint}'
    path = save(urdf("", BODY + BALL).replace("</robot>", f"{frame}</robot>"))
    hand = HandDescription.from_urdf(path, **SAID | {"fingertip_links": ["frame"]})
    assert hand.fingertip_links == ("tip",)
    assert hand.urdf.parent == cache
    masses = {
        link.get("name"): float(link.find("inertial/mass").get("value"))  # type: ignore[union-attr, arg-type]
        for link in ET.parse(hand.urdf).findall("link")
    }
    assert masses == {"palm": FRAME_MASS, "tip": 0.1, "frame": FRAME_MASS}
    # what was read from the file stays, and the same file has the same copy
    assert HandDescription.from_urdf(path, **SAID).urdf == hand.urdf


def test_shapes_without_inertia_weigh_as_water_and_it_is_said(save) -> None:
    with pytest.warns(UserWarning, match="'tip': no mass, 0.00415 kg taken from its shapes"):
        hand = HandDescription.from_urdf(save(urdf(BALL, BALL)), **SAID)
    dynamics, shapes, _, _ = loaded(hand)
    mass = 4 / 3 * np.pi * 1e-6 * 1000
    assert dynamics[0] == pytest.approx(mass, rel=0.03)
    np.testing.assert_allclose(dynamics[2], 0.4 * mass * 1e-4, rtol=0.05)
    # next to the shape, not in its frame
    np.testing.assert_allclose(dynamics[3], (1e-6, 0, 0.01), atol=1e-12)
    assert len(shapes) == 1


@settings(max_examples=40, deadline=None)
@given(
    moments=st.lists(st.floats(-1e-3, 1e-3), min_size=3, max_size=3),
    turn=st.lists(st.floats(-1, 1), min_size=3, max_size=3),
)
def test_the_engine_keeps_every_mended_tensor(moments, turn, tmp_path_factory) -> None:
    rotation = trimesh.transformations.euler_matrix(*turn)[:3, :3]
    tensor = rotation * moments @ rotation.T
    keys = ("ixx", "ixy", "ixz", "", "iyy", "iyz", "", "", "izz")
    entries = zip(keys, tensor.ravel(), strict=True)
    words = " ".join(f'{key}="{value!r}"' for key, value in entries if key)
    body = f'<inertial><mass value="0.1"/><inertia {words}/></inertial>'.replace("np.float64(", "")
    body = body.replace(")", "")
    link = ET.fromstring(f'<link name="tip">{body}{BALL}</link>')
    mend_inertia(link, lambda: None)
    folder = tmp_path_factory.mktemp("tensor")
    path = folder / "tensor.urdf"
    path.write_text(f'<robot name="r">{ET.tostring(link, encoding="unicode")}</robot>')
    client = p.connect(p.DIRECT)
    body_id = p.loadURDF(str(path), flags=p.URDF_USE_INERTIA_FROM_FILE, physicsClientId=client)
    kept = sorted(p.getDynamicsInfo(body_id, -1, physicsClientId=client)[2])
    p.disconnect(client)
    assert kept[0] > 0
    assert kept[2] < kept[0] + kept[1]
    largest = max(moments)
    if largest > 1e-9:
        assert kept[2] == pytest.approx(largest, rel=1e-5)


def test_a_tensor_of_no_body_is_raised_and_it_is_said(save) -> None:
    body = BODY.replace('izz="1e-4"', 'izz="3e-4"')
    with pytest.warns(UserWarning, match="'tip': inertia of no rigid body"):
        hand = HandDescription.from_urdf(save(urdf(BODY, body + BALL)), **SAID)
    np.testing.assert_allclose(loaded(hand)[0][2], (1.5e-4, 1.5e-4, 3e-4), rtol=1e-5)


def test_an_inertia_in_the_frame_of_the_only_shape_is_moved(save) -> None:
    body = BODY.replace("<mass", '<origin xyz="0 0 0.01"/><mass')
    hand = HandDescription.from_urdf(save(urdf(BODY, body + BALL)), **SAID)
    np.testing.assert_allclose(loaded(hand)[0][3], (1e-6, 0, 0.01), atol=1e-12)


def test_axes_have_the_length_1(save) -> None:
    text = urdf(BODY, BODY + BALL, '<axis xyz="0 0 2"/>', "prismatic")
    hand = HandDescription.from_urdf(save(text), **SAID)
    np.testing.assert_allclose(loaded(hand)[2], (0, 0, 0.5), atol=1e-6)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_long_lines_and_encodings_are_read(encoding, save) -> None:
    text = f'<?xml version="1.0" encoding="{encoding}"?>' + urdf(BODY, BODY + BALL + " " * 9000)
    hand = HandDescription.from_urdf(save(text, encoding), **SAID)
    assert hand.urdf.name != "hand.urdf"
    assert len(loaded(hand)[1]) == 1


@pytest.mark.parametrize("ending", ["ply", "off", "glb", "stl", "obj", "text.stl"])
@pytest.mark.parametrize(
    "place", ["meshes/{}", "package://my_hand/meshes/{}", "file://{here}/meshes/{}"]
)
def test_meshes_of_any_format_and_address(ending, place, save, tmp_path) -> None:
    mesh = trimesh.creation.box((0.02, 0.03, 0.04))
    path = tmp_path / "meshes" / f"box.{ending.removeprefix('text.')}"
    path.parent.mkdir()
    mesh.export(path, file_type="stl_ascii" if ending == "text.stl" else None)
    name = place.format(path.name, here=tmp_path)
    shape = f'<geometry><mesh filename="{name}"/></geometry>'
    text = urdf(
        BODY, f"{BODY}<visual>{shape}</visual><collision><origin xyz='0 0 1'/>{shape}</collision>"
    )
    hand = HandDescription.from_urdf(save(text), **SAID)
    _, shapes, _, (low, high) = loaded(hand)
    assert len(shapes) == 1
    np.testing.assert_allclose(np.subtract(high, low), (0.03, 0.035, 0.04), atol=0.012)
    known = ending in ("stl", "obj") and not place.startswith("package")
    assert (hand.urdf.parent == tmp_path) == known


def test_pictures_that_are_gone_are_left_out_and_it_is_said(save) -> None:
    visual = '<visual><geometry><mesh filename="gone.glb"/></geometry></visual>'
    path = save(urdf(BODY, BODY + visual + BALL))
    with pytest.warns(UserWarning, match="The visual mesh 'gone.glb' of link 'tip'"):
        hand = HandDescription.from_urdf(path, **SAID)
    loaded(hand)


def test_meshes_without_faces_are_refused(save, tmp_path) -> None:
    for name, content in (
        ("a.ply", "ply"),
        ("b.off", "OFF\n0 0 0\n"),
        ("c.glb", ""),
        ("d.obj", "v 0 0 0\n"),
    ):
        (tmp_path / name).write_text(content)
        shape = f'<collision><geometry><mesh filename="{name}"/></geometry></collision>'
        with pytest.raises(HandError, match=rf"(?s){name}.*(cannot be read|no faces)"):
            HandDescription.from_urdf(save(urdf(BODY, BODY + shape)), **SAID)


def test_a_cache_that_cannot_be_written_is_named(save, tmp_path, monkeypatch) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    with pytest.raises(HandError, match="set XDG_CACHE_HOME"):
        HandDescription.from_urdf(save(urdf("", BODY + BALL)), **SAID)


def test_what_the_engine_cannot_load_is_an_error_of_the_hand(save, tmp_path) -> None:
    body = held_out_objects()[held_out_objects().object_ids[0]]
    shape = '<collision><geometry><mesh filename="a.dae"/></geometry></collision>'
    text = urdf(BODY, BODY + shape)
    for number, reason in enumerate(
        ("reads no shape from the collision meshes of links 'tip'", "cannot load")
    ):
        path = tmp_path / f"hand{number}.urdf"
        path.write_text(text.replace("a.dae", f"{number}.dae"))
        (tmp_path / f"{number}.dae").write_text("")
        simulation = Simulation(HandDescription.from_urdf(path, **SAID))
        if number:
            simulation.hand.urdf.unlink()
        with pytest.raises(HandError, match=re.escape(reason)):
            simulation.load(body, Pose(np.ones(3), np.eye(3)), np.zeros(1), friction=1.0)
        simulation.close()
