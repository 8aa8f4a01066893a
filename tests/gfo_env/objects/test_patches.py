"""A mesh as flat convex patches: nothing lost, nothing folded, and closest points that are."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from gfo_env.objects import Patches
from gfo_env.objects.patches import Patch
from solvers.arrays import Array
from solvers.synthesis import ContactFacets
from tests.support.facets import off_surface
from tests.support.problems import random_rotation
from tests.support.seeds import SEEDS, seeded
from tests.support.shapes import box, inside_out, joined, l_shape
from tests.support.world import held_out_objects

UPRIGHT = {
    "box": box((0.06, 0.05, 0.04)),
    "subdivided box": box((0.06, 0.05, 0.04)).subdivide().subdivide().subdivide(),
    "l": l_shape(),
    "subdivided l": l_shape().subdivide(),
    "cylinder": trimesh.creation.cylinder(radius=0.02, height=0.06, sections=24),
    "ring": trimesh.creation.annulus(r_min=0.01, r_max=0.03, height=0.02, sections=16),
    "ball": trimesh.creation.icosphere(subdivisions=1, radius=0.03),
}


def tilted(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The same shape with vertices that are not round numbers."""
    rng = seeded(3)
    turned = mesh.copy()
    turned.apply_transform(
        trimesh.transformations.translation_matrix(rng.uniform(-0.01, 0.01, 3))
        @ np.block([[random_rotation(rng), np.zeros((3, 1))], [np.zeros((1, 3)), 1.0]])
    )
    return turned


MESHES = UPRIGHT | {f"tilted {name}": tilted(mesh) for name, mesh in UPRIGHT.items()}
every_mesh = pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES.keys())


def area(corners: Array) -> Array:
    """(3,) m2 along the normal of a ring that runs counterclockwise about it."""
    arms = corners - corners[0]
    return 0.5 * np.cross(arms, np.roll(arms, -1, axis=0)).sum(axis=0)


@every_mesh
def test_patches_are_the_surface_and_no_more(mesh: trimesh.Trimesh) -> None:
    patches = Patches(mesh).patches
    areas = np.array([np.linalg.norm(area(patch.corners)) for patch in patches])
    assert areas.sum() == pytest.approx(mesh.area, rel=1e-6)
    # where patches did not lie side by side, their moments would not be those of the mesh either
    normals = np.array([patch.normal for patch in patches])
    assert_allclose(areas @ normals, 0.0, atol=1e-9)
    second = np.einsum("f,fi,fj->ij", mesh.area_faces, mesh.face_normals, mesh.face_normals)
    assert_allclose(np.einsum("p,pi,pj->ij", areas, normals, normals), second, atol=1e-9)
    centroids = np.array([patch.corners.mean(axis=0) for patch in patches])
    assert off_surface(mesh, centroids).max() < 1e-9


@every_mesh
def test_patches_are_flat_convex_and_face_inward(mesh: trimesh.Trimesh) -> None:
    patches = Patches(mesh)
    for patch in (patches[index] for index in range(len(patches))):
        assert np.linalg.norm(patch.normal) == pytest.approx(1.0)
        # counterclockwise seen from outside
        outward = area(patch.corners)
        assert_allclose(outward / np.linalg.norm(outward), -patch.normal, atol=1e-6)
        # flat and convex, as the synthesis asks for
        ContactFacets((patch.corners,), patch.normal[None], np.ones(1), 0.1)
        inside = patch.corners.mean(axis=0)
        _, _, face = trimesh.proximity.closest_point(mesh, inside[None])
        assert_allclose(mesh.face_normals[face[0]], -patch.normal, atol=1e-6)


@pytest.mark.parametrize("name", ["box", "subdivided box", "tilted box", "tilted subdivided box"])
def test_a_box_has_six_patches_of_four_corners(name: str) -> None:
    patches = Patches(MESHES[name])
    assert [len(patch.corners) for patch in patches.patches] == [4] * 6


@pytest.mark.parametrize("name", ["cylinder", "tilted cylinder"])
def test_a_cylinder_has_a_patch_a_side_and_two_ends(name: str) -> None:
    corners = sorted(len(patch.corners) for patch in Patches(MESHES[name]).patches)
    assert corners == [4] * 24 + [24] * 2


@pytest.mark.parametrize("name", ["l", "tilted l"])
def test_hollow_faces_are_cut_into_convex_patches(name: str) -> None:
    """Two ends of six corners, which take two patches or more each, and six sides."""
    patches = Patches(MESHES[name]).patches
    sizes = np.array([np.linalg.norm(area(patch.corners)) for patch in patches])
    assert 10 <= len(patches) <= 14
    # the ends are 0.1^2 - 0.07^2 in area, no patch of which exceeds an arm of 0.1 by 0.03
    assert sizes.max() <= 0.003 + 1e-9
    assert np.isclose(sizes, 0.1 * 0.02).sum() >= 2


# Closest points


@settings(max_examples=40)
@given(seed=SEEDS, mesh=st.sampled_from(list(MESHES.values())))
def test_near_finds_the_closest_points_in_order(seed: int, mesh: trimesh.Trimesh) -> None:
    rng, patches = seeded(seed), Patches(mesh)
    low, high = mesh.bounds
    point = rng.uniform(low - 0.01, high + 0.01)
    found = patches.near(point, np.inf)
    assert sorted(found) == list(range(len(patches)))
    distances = [np.linalg.norm(closest - point) for closest in found.values()]
    assert np.diff(distances).min() >= -1e-15
    for index, closest in found.items():
        corners = patches[index].corners
        # no corner of a convex set lies beyond the plane through its closest point
        assert ((corners - closest) @ (point - closest)).max() <= 1e-12
        own = ContactFacets((corners,), patches[index].normal[None], np.ones(1), 0.1)
        sides, bounds = own.sides[0]
        local = own.local(closest[None])
        assert (local @ sides.T <= bounds + 1e-9).all()
        assert_allclose(own.positions(local)[0], closest, atol=1e-12)
    assert distances[0] == pytest.approx(off_surface(mesh, point[None])[0], abs=1e-12)
    _, expected, _ = trimesh.proximity.closest_point(mesh, point[None])
    assert distances[0] <= expected[0] + 1e-12


@settings(max_examples=20)
@given(seed=SEEDS, radius=st.sampled_from([0.0, 1e-3, 0.01, 0.1]))
def test_near_leaves_out_what_is_farther_than_the_radius(seed: int, radius: float) -> None:
    patches, rng = Patches(MESHES["ball"]), seeded(seed)
    point = rng.normal(size=3) * 0.02
    near, all_of_them = patches.near(point, radius), patches.near(point, np.inf)
    within = [index for index, at in all_of_them.items() if np.linalg.norm(at - point) <= radius]
    assert list(near) == within


def test_around_an_edge_both_patches_are_near() -> None:
    patches = Patches(MESHES["box"])
    found = patches.near(np.array([0.03, 0.025, 0.0]), 1e-6)
    assert len(found) == 2
    normals = {tuple(np.round(patches[index].normal)) for index in found}
    assert normals == {(-1.0, 0.0, 0.0), (0.0, -1.0, 0.0)}


# Meshes that are no model of good order


def test_triangles_without_area_leave_no_patch_and_no_warning() -> None:
    cube = box((0.06, 0.05, 0.04))
    vertices = np.vstack([cube.vertices, cube.vertices[:2].mean(axis=0), cube.vertices[0]])
    faces = np.vstack([cube.faces, [0, 1, 8], [0, 9, 9], [2, 2, 2]])
    patches = Patches(trimesh.Trimesh(vertices, faces, process=False))
    assert [len(patch.corners) for patch in patches.patches] == [4] * 6


def test_folded_triangles_are_not_joined() -> None:
    """Two triangles of one plane on the same side of their common edge: the larger hides one."""
    corners = np.array([[0.0, 0, 0], [0.04, 0, 0], [0.01, 0.03, 0], [0.03, 0.02, 0]])
    folded = trimesh.Trimesh(corners, [[0, 1, 2], [0, 1, 3]], process=False)
    assert len(folded.facets) == 1
    assert [len(patch.corners) for patch in Patches(folded).patches] == [3, 3]


def test_a_bend_too_slight_for_the_mesh_is_still_a_bend() -> None:
    """A roof of 20 micrometres, whose sides trimesh takes for one facet."""
    ring = np.array([[0, 0], [0.04, 0], [0.04, 0.03], [0.02, 0.03002], [0, 0.03]])
    prism = trimesh.creation.extrude_triangulation(
        ring, np.array([[0, 1, 3], [1, 2, 3], [3, 4, 0]]), 0.02
    )
    assert len(prism.facets) == 6
    patches = Patches(prism).patches
    assert len(patches) == 7
    corners = np.vstack([patch.corners for patch in patches])
    assert off_surface(prism, corners).max() < 1e-9


def test_slivers_are_left_out() -> None:
    """Of a card 0.05 mm thick only the faces are places for a finger."""
    patches = Patches(box((0.06, 0.05, 5e-5))).patches
    assert sorted(abs(patch.normal[2]) for patch in patches) == [1.0, 1.0]
    assert len(Patches(box((0.06, 0.05, 2e-4))).patches) == 6


def test_corners_in_all_but_one_place_are_one_corner() -> None:
    """An edge of a tenth of a micrometre, as boolean operations leave them."""
    ring = np.array([[0, 0], [0.04, 0], [0.04 + 1e-7, 1e-7], [0.04, 0.03], [0, 0.03]])
    prism = trimesh.creation.extrude_triangulation(
        ring, np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4]]), 0.02
    )
    patches = Patches(prism)
    for patch in patches.patches:
        ContactFacets((patch.corners,), patch.normal[None], np.ones(1), 0.05)
    assert [len(patch.corners) for patch in patches.patches] == [4] * 6


@pytest.mark.parametrize(
    ("name", "disorder"),
    [
        *((name, disorder) for name in UPRIGHT for disorder in ("inward", "mixed")),
        *(("two", disorder) for disorder in ("inward", "mixed", "one body")),
        # whether a shell is a cavity, none can tell from triangles that contradict each other
        *(("hollow", disorder) for disorder in ("inward", "as it is")),
    ],
)
def test_winding_is_mended(name: str, disorder: str) -> None:
    shapes = UPRIGHT | {
        "two": joined(box((0.02, 0.02, 0.02)), box((0.03, 0.02, 0.02), (0.05, 0.0, 0.0))),
        "hollow": joined(box((0.06, 0.05, 0.04)), inside_out(box((0.02, 0.02, 0.02)))),
    }
    mesh = shapes[name]
    faces = np.array(mesh.faces)
    if disorder == "inward":
        rows = np.full(len(faces), True)
    elif disorder == "mixed":
        rows = seeded(1).random(len(faces)) < 0.4
    else:
        rows = np.arange(len(faces)) < 12 if name == "two" else np.full(len(faces), False)
    faces[rows] = faces[rows, ::-1]
    found = Patches(trimesh.Trimesh(mesh.vertices, faces, process=False)).patches
    expected = Patches(mesh).patches

    def moments(patches: tuple[Patch, ...]) -> Array:
        """Areas times normals, and those times places, which tell outside from inside."""
        areas = np.array([area(patch.corners) for patch in patches])
        centres = np.array([patch.corners.mean(axis=0) for patch in patches])
        for patch, along in zip(patches, areas, strict=True):
            assert patch.normal @ along < 0  # counterclockwise about the outward normal
        return np.vstack([areas.sum(axis=0), areas.T @ centres])

    assert_allclose(moments(found), moments(expected), atol=1e-9)


@pytest.mark.parametrize("name", ["l", "tilted l", "box", "ring"])
def test_many_triangles_of_a_plane_are_joined_as_few(name: str) -> None:
    mesh = fine = MESHES[name]
    while len(fine.faces) < 12_000:
        fine = fine.subdivide()
    found = Patches(fine).patches
    assert len(found) <= len(Patches(mesh)) + 4
    areas = np.array([np.linalg.norm(area(patch.corners)) for patch in found])
    normals = np.array([patch.normal for patch in found])
    assert areas.sum() == pytest.approx(mesh.area, rel=1e-6)
    second = np.einsum("f,fi,fj->ij", mesh.area_faces, mesh.face_normals, mesh.face_normals)
    assert_allclose(np.einsum("p,pi,pj->ij", areas, normals, normals), second, atol=1e-9)
    corners = np.vstack([patch.corners for patch in found])
    assert off_surface(mesh, corners).max() < 1e-9


def test_a_finely_meshed_curve_is_its_triangles() -> None:
    mesh = trimesh.creation.cylinder(radius=0.5, height=0.1, sections=6_000)
    sides = [facet for facet in mesh.facets if np.ptp(mesh.face_normals[facet][:, 0]) > 1.0]
    assert sides  # so small are the triangles that they do not look bent
    patches = Patches(mesh).patches
    assert len(patches) == 2 + sum(map(len, sides))
    assert max(len(patch.corners) for patch in patches) > 1000  # the ends are whole


def test_bodies_apart_are_patched_alike() -> None:
    pair = joined(box((0.02, 0.02, 0.02)), box((0.02, 0.02, 0.02), (0.05, 0.0, 0.0)))
    assert len(Patches(pair)) == 12


def test_patches_of_real_objects_are_facets_for_contacts() -> None:
    objects = held_out_objects()
    for object_id in objects.object_ids[10:24:2]:
        solid = objects[object_id].solid
        patches = Patches(solid)
        for patch in patches.patches:
            ContactFacets((patch.corners,), patch.normal[None], np.ones(1), 0.1)
        total = sum(np.linalg.norm(area(patch.corners)) for patch in patches.patches)
        assert total == pytest.approx(solid.area, rel=5e-3)
