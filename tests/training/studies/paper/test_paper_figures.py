"""The figures of the paper's reproduction: what they show, and that the same data are one file."""

from collections.abc import Callable
from pathlib import Path

import matplotlib
import numpy as np
import pytest
import trimesh
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from numpy.testing import assert_allclose
from PIL import Image
from scipy.spatial import ConvexHull

from tests.support.seeds import seeded
from training.reports.figures import (
    BLUE,
    GREY,
    ORANGE,
    Mark,
    loss_figure,
    path_figure,
    residual_figure,
    save,
    synthesis_figure,
)
from training.studies.paper.quality import Hull, Projection
from training.studies.paper.solid_figures import contacts_figure, hull_figure

MOST_BYTES = 60_000


def polyhedron(points: np.ndarray) -> Projection:
    shape = ConvexHull(points)
    faces = shape.simplices.astype(np.int64)
    corners = points[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.einsum("fi,fi->f", normals, shape.equations[:, :3]) < 0
    faces[inward] = faces[inward, ::-1]
    return Projection(points, faces, float(-shape.equations[:, 3].max()))


def some_hull() -> Hull:
    wrenches = seeded(1).normal(size=(24, 6)) * [3, 3, 3, 1, 1, 1]
    touch = np.array([0.3, -0.8, 0.3, 0.5, -0.5, 0.3])
    return Hull(
        edges=8,
        length=0.06,
        radius=float(np.linalg.norm(touch)),
        wrenches=wrenches,
        touch=touch,
        force=polyhedron(wrenches[:, :3]),
        torque=polyhedron(wrenches[:, 3:]),
    )


def losses() -> dict[str, np.ndarray]:
    rng = seeded(0)
    return {name: np.exp(rng.normal(size=400) - np.arange(400) / 50) for name in ("a", "b")}


def residuals() -> tuple[np.ndarray, np.ndarray]:
    times = np.append(0.0, np.geomspace(1e-2, 1e2, 60))
    rates = seeded(0).uniform(0.1, 0.4, 31)
    return times, np.exp(-times[:, None] * rates)


def wall_path(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[Mark]]:
    times = np.linspace(0, 60, 121)
    slopes = np.linspace(-0.1, 0.1, count)
    path = -np.minimum(times, 38)[:, None] + slopes * np.maximum(times - 38, 0)[:, None]
    point = path[76] + np.linspace(-1, 1, count)
    marks = [Mark("printed", 30.25, point, 130.0), Mark("turned", 38.0, -point, 0.0)]
    return times, path, 600 * (1 - np.minimum(times, 38) / 38), marks


def box_contacts() -> dict[str, np.ndarray]:
    """A box of 8 x 4 x 4 cm pressed on its front and its top, then 2 cm further along."""
    box = trimesh.creation.box((0.08, 0.04, 0.04))
    before = np.array([[0.0, -0.02, 0.0], [0.0, 0.0, 0.02]])
    normals = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0]])
    return {
        "vertices": np.asarray(box.vertices),
        "faces": np.asarray(box.faces),
        "positions": np.stack([before, before + np.array([0.02, 0.0, 0.0])]),
        "normals": np.stack([normals, normals]),
        "forces": np.array([[5.0, 5.0], [2.5, 2.5]]),
        "qualities": np.array([0.125, 0.25]),
    }


def synthesis() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = seeded(2)
    before = np.append(0.0, rng.uniform(0.01, 0.2, 40))
    solved = np.arange(41) % 5 != 3
    after = before * np.where(solved, rng.uniform(1, 3, 41), 1.0)
    after[0] = 0.1
    return before, after, solved


FIGURES: dict[str, Callable[[], Figure]] = {
    "loss": lambda: loss_figure(losses(), "title"),
    "residual": lambda: residual_figure(*residuals(), residuals()[1] ** 2),
    "path": lambda: path_figure(*wall_path(9)),
    "synthesis": lambda: synthesis_figure(*synthesis()),
    "hull": lambda: hull_figure(some_hull()),
    "contacts": lambda: contacts_figure(**box_contacts()),
}


def picture(name: str, folder: Path) -> np.ndarray:
    path = folder / f"{name}.png"
    save(FIGURES[name](), path)
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"))


def near(pixels: np.ndarray, colour: str, tolerance: int = 40) -> np.ndarray:
    wanted = 255 * np.array(to_rgba(colour)[:3])
    return np.abs(pixels - wanted).max(axis=2) < tolerance


@pytest.mark.parametrize("name", FIGURES)
def test_same_data_are_the_same_small_file(name, tmp_path) -> None:
    first, second = tmp_path / "first.png", tmp_path / "second.png"
    save(FIGURES[name](), first)
    save(FIGURES[name](), second)
    assert first.read_bytes() == second.read_bytes()
    assert first.stat().st_size < MOST_BYTES
    with Image.open(first) as image:
        assert image.mode == "P"
        assert not image.info, "no metadata"
        pixels = np.asarray(image.convert("RGB"))
    border = np.concatenate([pixels[0], pixels[-1], pixels[:, 0], pixels[:, -1]])
    assert np.all(border == 255), "white, and nothing is cut off"
    assert np.mean(np.any(pixels < 200, axis=2)) > 0.01, "something is drawn"


@pytest.mark.parametrize("name", FIGURES)
def test_making_and_saving_leave_matplotlib_s_settings_alone(name, tmp_path) -> None:
    before = dict(matplotlib.rcParams)
    save(FIGURES[name](), tmp_path / "figure.png")
    assert dict(matplotlib.rcParams) == before


def test_loss_is_on_a_logarithmic_axis_from_the_first_iteration() -> None:
    (axes,) = loss_figure(losses(), "Benchmark").axes
    assert axes.get_yscale() == "log"
    assert axes.get_title() == "Benchmark"
    for line, (name, loss) in zip(axes.lines, losses().items(), strict=True):
        assert line.get_label() == name
        assert_allclose(line.get_ydata(), loss)
        assert line.get_xdata()[0] == 1
    assert axes.get_legend() is not None
    (alone,) = loss_figure({"a": losses()["a"]}).axes
    assert alone.get_legend() is None


def test_residuals_are_grey_lines_and_their_median() -> None:
    times, values = residuals()
    (axes,) = residual_figure(times, values).axes
    assert axes.get_xscale() == axes.get_yscale() == "log"
    *each, middle = axes.lines
    assert len(each) == values.shape[1]
    assert all(line.get_color() == GREY for line in each)
    assert_allclose(middle.get_xdata(), times[1:], err_msg="time 0 has no logarithm")
    assert_allclose(middle.get_ydata(), np.median(values, axis=1)[1:])
    assert middle.get_linewidth() > each[0].get_linewidth()
    left, right = residual_figure(times, values, values**2).axes
    assert "residual" in left.get_ylabel()
    assert "exact forces" in right.get_ylabel()


def test_values_without_a_logarithm_are_gaps() -> None:
    times, values = residuals()
    values[20] = 0.0
    (axes,) = residual_figure(times, values).axes
    for line in axes.lines:
        assert np.flatnonzero(np.isnan(line.get_ydata())).tolist() == [19]


@pytest.mark.parametrize("count", [4, 9])
def test_path_and_the_points_placed_on_it(count) -> None:
    times, path, values, marks = wall_path(count)
    names = [f"x{i}" for i in range(count)]
    coordinates, constraint, comparison = path_figure(times, path, values, marks, names=names).axes
    for i in range(count):
        assert_allclose(coordinates.lines[i].get_ydata(), path[:, i])
    assert [tick.get_text() for tick in comparison.get_xticklabels()] == names
    assert_allclose(constraint.lines[0].get_ydata(), values)
    low, _ = constraint.get_ylim()
    assert low < 0, "the wall is seen"
    placed = [line for line in constraint.lines if line.get_linestyle() == "None"]
    assert [(*line.get_xdata(), *line.get_ydata()) for line in placed] == [
        (mark.time, mark.value) for mark in marks
    ]
    on_path = [c for c in comparison.collections if isinstance(c, LineCollection)]
    for dashes, mark in zip(on_path, marks, strict=True):
        heights = [segment[0, 1] for segment in dashes.get_segments()]
        expected = [np.interp(mark.time, times, path[:, i]) for i in range(count)]
        assert_allclose(heights, expected)


def test_lines_of_one_colour_differ_in_their_dashes() -> None:
    coordinates = path_figure(*wall_path(9)).axes[0]
    styles = {(line.get_color(), str(line._dash_pattern)) for line in coordinates.lines[:9]}
    assert len(styles) == 9


def test_more_points_than_symbols_are_refused() -> None:
    times, path, values, marks = wall_path(4)
    with pytest.raises(ValueError, match="zip"):
        path_figure(times, path, values, 2 * marks)


def test_synthesis_shows_every_grasp_once_and_sorts_the_gains() -> None:
    before, after, solved = synthesis()
    left, right = synthesis_figure(before, after, solved).axes
    good, bad = left.collections
    assert_allclose(good.get_offsets(), np.stack([before, after], axis=1)[solved])
    assert_allclose(bad.get_offsets(), np.stack([before, after], axis=1)[~solved])
    assert left.get_xlim() == left.get_ylim()
    assert_allclose(left.lines[0].get_xdata(), left.lines[0].get_ydata())
    gains = right.lines[0].get_ydata()
    assert len(gains) == np.sum(before > 0)
    assert np.all(np.diff(gains) <= 0)
    assert_allclose(np.sort(gains), np.sort(100 * (after / np.maximum(before, 1e-9) - 1)[1:]))
    assert right.get_title().startswith("1 without closure")


def test_synthesis_where_everything_was_solved_and_one_gain_is_huge() -> None:
    before, after, _ = synthesis()
    after[5] = 1000 * before[5]
    left, right = synthesis_figure(before, after, np.ones(len(before), dtype=bool)).axes
    assert len(left.collections) == 1
    assert right.get_yscale() == "symlog"


def test_hull_has_one_scale_and_says_its_units() -> None:
    hull = some_hull()
    figure = hull_figure(hull)
    force, torque = figure.axes
    assert (force.get_xlabel(), torque.get_zlabel()) == ("$f_x$ [N]", r"$\tau_z/\rho$ [N]")
    assert "60.0 mm" in torque.get_title()
    widths = [
        np.ptp(limits)
        for axes in figure.axes
        for limits in (axes.get_xlim(), axes.get_ylim(), axes.get_zlim())
    ]
    assert_allclose(widths, widths[0])
    (legend,) = figure.legends
    assert f"{hull.radius:.3g} N" in legend.get_texts()[1].get_text()
    without = hull_figure(hull, unit="")
    assert without.axes[0].get_xlabel() == "$f_x$"
    assert "N" not in without.legends[0].get_texts()[1].get_text()


def test_balls_of_both_projections_look_alike(tmp_path) -> None:
    pixels = picture("hull", tmp_path)[:440].astype(int)  # without the legend
    reddish = pixels[..., 0] > pixels[..., 2] + 50
    widths = [np.ptp(np.flatnonzero(h.any(axis=0))) for h in np.array_split(reddish, 2, axis=1)]
    assert min(widths) > 30
    assert max(widths) - min(widths) <= 2


def test_contacts_before_are_on_the_left_and_both_on_the_right(tmp_path) -> None:
    pixels = picture("contacts", tmp_path)
    left, right = np.array_split(pixels[: int(0.88 * len(pixels))], 2, axis=1)
    assert near(left, ORANGE).sum() > 100
    assert near(left, BLUE).sum() == 0
    assert near(right, BLUE).sum() > 100
    assert 10 < near(right, ORANGE).sum() < near(left, ORANGE).sum()


def test_contacts_figure_is_to_scale_and_says_the_quality() -> None:
    figure = contacts_figure(**box_contacts(), unit="N")
    assert [axes.get_title() for axes in figure.axes] == [
        "before: $q_{lrw}$ = 0.125 N",
        "after: $q_{lrw}$ = 0.25 N",
    ]
    for axes in figure.axes:
        limits = axes.get_xlim(), axes.get_ylim(), axes.get_zlim()
        assert_allclose(np.ptp(limits, axis=1), np.ptp(limits[0]))
        assert not axes.axison
    assert "at most 5 N" in figure.legends[0].get_texts()[2].get_text()


def test_unseen_contacts_are_pale() -> None:
    for azimuth, expected in ((-90.0, [1.0, 1.0]), (90.0, [0.5, 1.0])):
        figure = contacts_figure(**box_contacts(), view=(20.0, azimuth))
        for axes in figure.axes:
            assert_allclose(axes.collections[-1].get_alpha(), expected)


def test_view_is_chosen_so_that_all_contacts_are_seen() -> None:
    figure = contacts_figure(**box_contacts())
    for axes in figure.axes:
        assert_allclose(axes.collections[-1].get_alpha(), 1.0)


def test_arrows_are_as_long_as_their_forces(tmp_path) -> None:
    contacts = box_contacts()
    for name in ("positions", "normals", "forces"):
        contacts[name] = contacts[name][:, 1:]
    save(contacts_figure(**contacts, view=(0.0, -90.0)), tmp_path / "one.png")
    with Image.open(tmp_path / "one.png") as image:
        pixels = np.asarray(image.convert("RGB"))[:400].astype(int)
    left, right = np.array_split(pixels, 2, axis=1)
    orange = np.flatnonzero((left[..., 0] > left[..., 2] + 80).any(axis=1))
    blue = np.flatnonzero((right[..., 2] > right[..., 0] + 80).any(axis=1))
    # the dot at the tip adds as much to both
    dot = 4
    assert np.ptp(orange) - dot == pytest.approx(2 * (np.ptp(blue) - dot), rel=0.08)


def test_without_closure_before_there_is_no_gain_to_draw() -> None:
    figure = synthesis_figure(np.zeros(3), np.array([0.1, 0.2, 0.3]), np.ones(3, dtype=bool))
    assert "no grasp was in force closure" in figure.axes[1].texts[0].get_text()
