"""The figures with solid bodies: the hull of the wrenches, and contacts on an object."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import rc_context
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection
from mpl_toolkits.mplot3d.axes3d import Axes3D
from numpy.typing import NDArray

from solvers.arrays import Array
from training.reports.figures import BLACK, BLUE, INK, ORANGE, SKY, STYLE, VERMILION, new_figure

if TYPE_CHECKING:
    from .quality import Hull, Projection

_LIGHT = np.array([-0.40, 0.55, 0.73])
_MESH = "#C9CED6"
_SIDES = 20
_BAR = 0.02
_MOST_PAIRS = 500_000
_DOT: dict[str, Any] = {"s": 44, "depthshade": False, "zorder": 8}
_View = tuple[float, float]
_VIEW: _View = (20.0, -58.0)


@rc_context(STYLE)
def hull_figure(hull: "Hull", *, unit: str = "N") -> Figure:
    """The hull of the primitive wrenches and its ball, in forces and in torques (its Fig. 4).

    Args:
        hull: to draw.
        unit: of its wrenches; "" where the normal forces were left at 1.
    """
    figure = new_figure(8.8, 4.6)
    # the layout does not see the rightmost label
    figure.set_layout_engine("constrained", rect=(0.0, 0.0, 0.965, 1.0))
    half = 0.52 * max(float(np.ptp(p.points, axis=0).max()) for p in (hull.force, hull.torque))
    kinds = (
        (hull.force, hull.touch[:3], ("$f_x$", "$f_y$", "$f_z$"), "Forces"),
        (
            hull.torque,
            hull.touch[3:],
            (r"$\tau_x/\rho$", r"$\tau_y/\rho$", r"$\tau_z/\rho$"),
            rf"Torques, $\rho$ = {1e3 * hull.length:.1f} mm",
        ),
    )
    for column, (projection, touch, names, title) in enumerate(kinds):
        axes = _axes_3d(figure, (1, 2, column + 1))
        _draw_polyhedron(axes, projection, _sight(*_VIEW))
        _draw_solid(axes, _ball(hull.radius), VERMILION, _sight(*_VIEW), zorder=4)
        axes.scatter(*touch[:, None], color=BLACK, s=16, zorder=9, depthshade=False)
        # one scale for both panels: the balls are of the same radius and should look it
        _limit(axes, _middle(projection.points), half, zoom=0.92)
        for axis, name in zip((axes.xaxis, axes.yaxis, axes.zaxis), names, strict=True):
            low, high = axis.get_view_interval()
            ticks = MaxNLocator(6).tick_values(low, high)
            # near the corners the labels of two axes would meet
            axis.set_ticks([t for t in ticks if low + 0.2 * half < t < high - 0.2 * half])
            axis.set_label_text(f"{name} [{unit}]" if unit else name)
        axes.tick_params(pad=0)
        axes.set_title(title, y=0.98)
    handles = [
        Line2D([], [], ls="none", marker="s", ms=9, color=SKY, alpha=0.6),
        Line2D([], [], ls="none", marker="o", ms=9, color=VERMILION),
        Line2D([], [], ls="none", marker="o", ms=4, color=BLACK),
    ]
    labels = [
        "hull of the primitive wrenches, projected",
        f"ball of $q_{{lrw}}$ = {hull.radius:.3g} {unit}".rstrip(),
        "where it touches the six-dimensional hull",
    ]
    figure.legend(handles, labels, loc="outside lower center", ncol=3, columnspacing=1.4)
    return figure


@rc_context(STYLE)
def contacts_figure(
    vertices: Array,
    faces: NDArray[np.int64],
    positions: Array,
    normals: Array,
    forces: Array,
    qualities: Array,
    *,
    unit: str = "",
    titles: tuple[str, str] = ("before", "after"),
    view: _View | None = None,
) -> Figure:
    """An object with its contacts before and after they were moved, and what they press with.

    Contacts and arrows behind the object shine through it; hollow circles on the right are where
    the contacts were before.

    Args:
        vertices: (v, 3) m, of the object's mesh.
        faces: (f, 3) its triangles, anticlockwise seen from outside.
        positions: (2, n, 3) m, contacts before and after.
        normals: (2, n, 3) unit, into the object.
        forces: (2, n) N, normal forces; arrows along the normals end at the contacts.
        qualities: (2,) q_lrw.
        unit: of the qualities.
        titles: of the panels.
        view: elevation and azimuth in degrees; if None, one from which most contacts are seen.
    """
    figure = new_figure(7.6, 4.1)
    triangles = vertices[faces]
    size = float(np.linalg.norm(vertices - vertices.mean(axis=0), axis=1).max())
    view = view or _best_view(triangles, positions, normals, size)
    sight = _sight(*view)
    most = float(forces.max())
    tails = positions - 0.6 * size / most * forces[:, :, None] * normals
    camera = _camera_axes(sight)
    seen_from = np.concatenate([vertices, tails.reshape(-1, 3)]) @ camera.T
    half = 0.53 * float(np.ptp(seen_from[:, :2], axis=0).max())
    for panel, colour in enumerate((ORANGE, BLUE)):
        axes = _axes_3d(figure, (1, 2, panel + 1), view)
        axes.set_axis_off()
        _draw_mesh(axes, vertices, faces, sight, size)
        seen = _visible(triangles, positions[panel], sight, size)
        for place, tail, is_seen in zip(positions[panel], tails[panel], seen, strict=True):
            arrow = _arrow(tail, place, 0.018 * size)
            _draw_solid(axes, arrow, colour, sight, zorder=5 if is_seen else 1)
            if not is_seen:
                _draw_solid(axes, arrow, colour, sight, zorder=4, alpha=0.3)
        alphas = np.where(seen, 1.0, 0.5)
        axes.scatter(*positions[0].T, fc="none", ec=ORANGE, lw=1.6, **_DOT)
        axes.scatter(*positions[panel].T, c=colour, ec="white", lw=1.0, alpha=alphas, **_DOT)
        _limit(axes, camera.T @ _middle(seen_from), half, zoom=1.6)
        if panel == 0:
            corner = camera.T @ (_middle(seen_from) - [0.95 * half, 0.95 * half, 0.0])
            bar = np.stack([corner, corner + _BAR * camera[0]])
            axes.plot(*bar.T, color=INK, lw=2.0, solid_capstyle="butt")
            axes.text(
                *bar.mean(axis=0),
                f"{1e3 * _BAR:.0f} mm\n",
                fontsize=9,
                ha="center",
                va="bottom",
                linespacing=0.4,
            )
        axes.set_title(f"{titles[panel]}: $q_{{lrw}}$ = {qualities[panel]:.3g} {unit}".rstrip())
    entries = ((ORANGE, "o", 6.5), (BLUE, "o", 6.5), (INK, r"$\rightarrow$", 13))
    handles = [
        Line2D([], [], ls="none", marker=marker, ms=size, mew=0, color=colour)
        for colour, marker, size in entries
    ]
    labels = [*(f"contact {title}" for title in titles), f"normal force, at most {most:.3g} N"]
    figure.legend(handles, labels, loc="outside lower center", ncol=3)
    return figure


def _axes_3d(figure: Figure, place: tuple[int, int, int], view: _View = _VIEW) -> Axes3D:
    axes = figure.add_subplot(*place, projection="3d", proj_type="ortho", computed_zorder=False)
    assert isinstance(axes, Axes3D)
    axes.view_init(*view)
    return axes


def _limit(axes: Axes3D, middle: Array, half: float, zoom: float) -> None:
    """A cube of half the edge `half` about `middle` (3,); at zoom 1.6 its size fills the axes."""
    axes.set_box_aspect((1, 1, 1), zoom=zoom)
    for which, centre in zip("xyz", middle, strict=True):
        axes.set(**{f"{which}lim": (centre - half, centre + half)})


def _middle(points: Array) -> Array:
    return np.asarray((points.max(axis=0) + points.min(axis=0)) / 2)


def _draw_polyhedron(axes: Axes3D, projection: "Projection", sight: Array) -> None:
    """Translucent: the far faces, then room for what is inside, then the near faces."""
    triangles = projection.points[projection.faces]
    near = _unit_normals(triangles) @ sight > 0
    for part, zorder, alpha in ((~near, 1, 0.30), (near, 6, 0.10)):
        axes.add_collection3d(
            Poly3DCollection(triangles[part], facecolor=SKY, lw=0, alpha=alpha, zorder=zorder)
        )
    segments, sides = _creases(projection.points, projection.faces, 1.0)
    in_front = np.any(near[sides], axis=1)
    for part, zorder, width in ((~in_front, 2, 0.4), (in_front, 7, 0.9)):
        lines = Line3DCollection(segments[part], colors=BLUE, lw=width, alpha=0.8, zorder=zorder)
        axes.add_collection3d(lines)


def _draw_mesh(
    axes: Axes3D, vertices: Array, faces: NDArray[np.int64], sight: Array, size: float
) -> None:
    """An opaque mesh with its visible creases inked."""
    triangles = vertices[faces]
    _draw_solid(axes, _split_large(triangles, 0.15 * size), _MESH, sight, zorder=3)
    segments, _ = _creases(vertices, faces, 20.0)
    steps = np.linspace(0.0, 1.0, 9)[:, None, None]
    corners = segments[:, 0] * (1 - steps) + segments[:, 1] * steps
    pieces = np.stack([corners[:-1], corners[1:]], axis=2).reshape(-1, 2, 3)
    seen = _visible(triangles, pieces.mean(axis=1), sight, size)
    axes.add_collection3d(Line3DCollection(pieces[seen], colors="#6B7280", lw=0.6, zorder=3.5))


def _draw_solid(
    axes: Axes3D,
    triangles: Array,
    colour: str,
    sight: Array,
    *,
    zorder: float,
    alpha: float = 1.0,
) -> None:
    """The triangles (k, 3, 3) that face the viewer, lit from over the viewer's shoulder."""
    normals = _unit_normals(triangles)
    front = normals @ sight > 0
    light = _camera_axes(sight).T @ _LIGHT
    bright = 0.6 + 0.45 * np.clip(normals[front] @ light, 0.0, 1.0)
    shades = np.clip(np.multiply.outer(bright, to_rgb(colour)), 0.0, 1.0)
    axes.add_collection3d(
        Poly3DCollection(
            triangles[front],
            facecolors=shades,
            edgecolors=shades,
            # without edges, the seams between opaque triangles would show
            lw=0.8 if alpha == 1 else 0.0,
            alpha=alpha,
            zorder=zorder,
        )
    )


def _camera_axes(sight: Array) -> Array:
    """(3, 3) rows: right, up and towards the viewer, who looks along -sight."""
    right = np.cross([0.0, 0.0, 1.0], sight)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(sight, right), sight])


def _sight(elevation: float, azimuth: float) -> Array:
    """(3,) unit vector towards the viewer, from degrees."""
    e, a = np.deg2rad([elevation, azimuth])
    return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def _best_view(triangles: Array, positions: Array, normals: Array, size: float) -> _View:
    """Elevation and azimuth from which most contacts are seen, arrows sideways, well apart."""
    points, axes = positions.reshape(-1, 3), normals.reshape(-1, 3)
    first, second = np.triu_indices(positions.shape[1], 1)
    gaps = (positions[:, first] - positions[:, second]).reshape(-1, 3)

    def score(view: _View) -> float:
        sight = _sight(*view)
        seen = _visible(triangles, points, sight, size)
        sideways = np.linalg.norm(np.cross(axes, sight), axis=1)
        apart = np.linalg.norm(np.cross(gaps, sight), axis=1) / size
        return float(seen.sum() + sideways.min() + np.clip(apart, 0.0, 0.5).sum() / len(points))

    return max(((e, a) for e in (20.0, 35.0, 50.0) for a in np.arange(0.0, 360.0, 15.0)), key=score)


def _visible(triangles: Array, points: Array, sight: Array, size: float) -> NDArray[np.bool_]:
    """(k,) whether no triangle lies between points (k, 3) and a viewer far away along `sight`."""
    camera = _camera_axes(sight)
    first, second, third = (triangles @ camera.T).transpose(1, 0, 2)
    along, across = second - first, third - first
    area = along[:, 0] * across[:, 1] - along[:, 1] * across[:, 0]
    edgewise = np.abs(area) < 1e-9 * size**2
    area = np.where(edgewise, 1.0, area)

    def is_seen(places: Array) -> NDArray[np.bool_]:
        offsets = places[:, None] - first
        u = (offsets[..., 0] * across[:, 1] - offsets[..., 1] * across[:, 0]) / area
        v = (offsets[..., 1] * along[:, 0] - offsets[..., 0] * along[:, 1]) / area
        inside = (u >= 0) & (v >= 0) & (u + v <= 1) & ~edgewise
        depth = first[:, 2] + u * along[:, 2] + v * across[:, 2]
        return np.asarray(~np.any(inside & (depth > places[:, 2:] + 0.02 * size), axis=1))

    # in parts, because each needs memory for all pairs of a point and a triangle
    parts = np.array_split(points @ camera.T, 1 + len(points) * len(triangles) // _MOST_PAIRS)
    return np.concatenate([is_seen(part) for part in parts])


def _creases(
    vertices: Array, faces: NDArray[np.int64], angle: float
) -> tuple[Array, NDArray[np.int64]]:
    """Edges (k, 2, 3) between faces more than `angle` degrees apart, and these faces (k, 2)."""
    edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    owners = np.repeat(np.arange(len(faces)), 3)
    order = np.lexsort(edges.T)
    edges, owners = edges[order], owners[order]
    pairs = np.flatnonzero((edges[1:] == edges[:-1]).all(axis=1))
    sides = np.stack([owners[pairs], owners[pairs + 1]], axis=1)
    normals = _unit_normals(vertices[faces])
    cosines = np.einsum("ki,ki->k", normals[sides[:, 0]], normals[sides[:, 1]])
    corners = vertices[faces]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    doubled = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    # the normal of a sliver says nothing
    sliver = doubled < 1e-3 * longest * float(np.ptp(vertices, axis=0).max())
    sharp = (cosines < np.cos(np.deg2rad(angle))) & ~sliver[sides].any(axis=1)
    return vertices[edges[pairs[sharp]]], sides[sharp]


def _unit_normals(triangles: Array) -> Array:
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    sizes = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(normals / np.where(sizes > 0, sizes, 1.0))


def _split_large(triangles: Array, longest: float) -> Array:
    """Triangles with no edge over `longest`: they are sorted by depth, which large ones defeat."""
    done = []
    while len(triangles):
        edges = np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=2)
        large = edges.max(axis=1) > longest
        done.append(triangles[~large])
        a, b, c = triangles[large].transpose(1, 0, 2)
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        quarters = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
        triangles = np.concatenate([np.stack(quarter, axis=1) for quarter in quarters])
    return np.concatenate(done)


def _arrow(tail: Array, tip: Array, radius: float) -> Array:
    """(k, 3, 3) outward triangles of a shaft and a head; none where the arrow has no length."""
    length = float(np.linalg.norm(tip - tail))
    if length == 0:
        return np.zeros((0, 3, 3))
    head = min(6.5 * radius, 0.6 * length)
    profile = [(0.0, 0.0), (0.0, radius), (length - head, radius)]
    return _turned([*profile, (length - head, 2.6 * radius), (length, 0.0)], tail, tip - tail)


def _ball(radius: float) -> Array:
    """(k, 3, 3) outward triangles of a ball about the origin."""
    angles = np.linspace(0.0, np.pi, _SIDES + 1)
    profile = [(-radius * np.cos(angle), radius * np.sin(angle)) for angle in angles]
    return _turned(profile, np.zeros(3), np.array([0.0, 0.0, 1.0]))


def _turned(profile: Sequence[tuple[float, float]], start: Array, axis: Array) -> Array:
    """Surface of revolution: pairs (along, out) of `profile`, turned about `axis` from `start`."""
    axis = axis / np.linalg.norm(axis)
    side = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    side /= np.linalg.norm(side)
    turns = np.linspace(0.0, 2 * np.pi, 2 * _SIDES + 1)[:, None]
    ring = np.cos(turns) * side + np.sin(turns) * np.cross(axis, side)
    grid = np.array([start + along * axis + out * ring for along, out in profile])
    here, there = grid[:-1], grid[1:]
    a, b, c, d = here[:, :-1], here[:, 1:], there[:, 1:], there[:, :-1]
    both = np.stack([np.stack([a, b, c], axis=-2), np.stack([a, c, d], axis=-2)])
    triangles = both.reshape(-1, 3, 3)
    sizes = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return np.asarray(triangles[np.linalg.norm(sizes, axis=1) > 0])
