"""The picture of a frame: something is drawn with and without an organ, with and without OpenGL."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.image import imread

from studies.arrays import Array
from studies.output.fields import OrganTopology
from studies.pictures import picture as chooser
from studies.pictures.picture import draw_scene
from studies.pictures.scene import Organ, frame_of
from studies.pictures.section import cut, draw_section
from studies.pictures.view import (
    KILO,
    SIZE,
    TENSION,
    TICKS,
    colours,
    scale_of,
    surface,
    tension_colours,
    tension_words,
    ticks,
)
from tests.studies.samples import LINEAR, frame, quadratic

SCENE = ([frame_of(frame(0.1))], LINEAR, "")
SHADE = 0.02  # of a colour: two shades of 256


def is_drawn(path: Path) -> bool:
    return bool(imread(path)[..., :3].std() > 0.02)


@pytest.mark.parametrize("topology", [None, LINEAR, quadratic()], ids=["no organ", "linear", "quadratic"])
def test_the_section_is_drawn(tmp_path: Path, topology: OrganTopology | None) -> None:
    draw_section([frame_of(frame(0.1, topology))], topology, tmp_path / "section.png", "title")
    assert is_drawn(tmp_path / "section.png")


def test_a_picture_comes_out_and_says_how(tmp_path: Path) -> None:
    line, failure = draw_scene(([frame_of(frame(0.1))], LINEAR, "title"), tmp_path / "picture.png")
    assert is_drawn(tmp_path / "picture.png")
    assert not failure
    assert "3-D picture (VTK)" in line or "apt-get install" in line


def test_a_child_that_dies_leaves_the_section_and_its_last_words(tmp_path: Path) -> None:
    """Independent check: without the module for three dimensions there is a section, and the cause is Python's own."""
    line, failure = draw_scene(SCENE, tmp_path / "picture.png", ("studies.no_such", "studies.pictures.section"))
    assert is_drawn(tmp_path / "picture.png")
    assert "section (matplotlib)" in line and "libegl1" in line
    assert "No module named studies.no_such" in line
    assert not failure


def test_a_picture_that_cannot_be_drawn_has_its_true_cause(tmp_path: Path) -> None:
    """Independent check: a file that is no scene, and a place where no picture can be."""
    source = tmp_path / "frame.pickle"
    source.write_bytes(b"not a pickle")
    cause = chooser.draw_apart("studies.pictures.section", source, tmp_path / "picture.png", {})
    assert cause.startswith("_pickle.UnpicklingError") and "ended with status 1" in cause
    assert not (tmp_path / "picture.png").exists()
    line, failure = draw_scene(SCENE, tmp_path / "a" / "b.png", ("studies.no", "studies.pictures.section"))
    assert "No such file or directory" in failure and failure in line


def test_a_file_in_the_working_folder_is_not_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: files called like modules that the picture imports, in the working folder, on PYTHONPATH and
    on the parent's path."""
    for name in ("pyvista", "random", "matplotlib", "studies"):
        (tmp_path / f"{name}.py").write_text(f"open({str(tmp_path / 'run')!r}, 'w')\nraise SystemExit('mine')\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.syspath_prepend("")
    line, _ = draw_scene(SCENE, tmp_path / "picture.png", ("studies.no", "studies.pictures.section"))
    assert is_drawn(tmp_path / "picture.png"), line
    assert not (tmp_path / "run").exists()


def test_the_surface_is_closed_and_faces_outward() -> None:
    """∮ x·n dA = 3 V, whatever the orientation of the tetrahedra."""
    flipped = OrganTopology(LINEAR.points, LINEAR.cells[:, [1, 0, 2, 3]])
    corners = LINEAR.points[LINEAR.cells]
    volume = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])).sum() / 6
    for topology in (LINEAR, flipped):
        a, b, c = np.moveaxis(topology.points[surface(topology)], 1, 0)
        assert len(a) == 6
        assert np.sum(a * np.cross(b, c)) / 6 == pytest.approx(volume, rel=1e-12)


def test_the_cut_has_the_area_of_the_section() -> None:
    """The tetrahedron x, y, z ≥ 0, x + y + z ≤ 1 cut at y has a section of area (1 − y)²/2."""
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    for turned in ([0, 1, 2, 3], [2, 0, 3, 1]):
        places, triangles, values = cut(points[turned], np.array([[0, 1, 2, 3]]), points[turned][:, 1], 0.3)
        a, b, c = np.moveaxis(places[triangles], 1, 0)
        u, v = b - a, c - a
        area = np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).sum() / 2
        assert area == pytest.approx(0.7**2 / 2, rel=1e-12)
        assert values == pytest.approx(0.3, rel=1e-12)


def test_a_cut_through_two_and_two_nodes_is_a_quadrangle() -> None:
    """The mid-plane of a regular tetrahedron in a unit cube, between two opposite edges: a square."""
    points = np.array([[0, 0, 0], [1, 0, 1], [0, 1, 1], [1, 1, 0.0]])
    places, triangles, _ = cut(points, np.array([[0, 1, 2, 3]]), points[:, 0], 0.5)
    assert len(triangles) == 2
    a, b, c = np.moveaxis(places[triangles], 1, 0)
    u, v = b - a, c - a
    doubled = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]  # signed: the triangles must not overlap
    assert abs(doubled.sum()) / 2 == pytest.approx(0.5, rel=1e-12)


def at(bar: Array, share: float) -> Array:
    """The colour at a share of a bar's length."""
    return np.asarray(bar[round(share * (len(bar) - 1))])


def test_a_thread_that_is_pressed_has_other_colours_than_one_that_is_pulled() -> None:
    """Independent check: from none, which is where it is on the bar, the colours go two ways, each as strong as its
    tension over the largest; without compression they begin at none."""
    reaching = partial(replace, scale_of([frame(0.0)]))
    taut, both = tension_colours(reaching(tension=(0.0, 0.8))), tension_colours(reaching(tension=(-0.2, 0.8)))
    rest, most = np.array(to_rgb(TENSION[0])), np.array(to_rgb(TENSION[-1]))
    for bar, none in ((taut, 0.0), (both, 0.2)):
        assert np.abs(at(bar, none) - rest).max() < SHADE
        assert np.abs(at(bar, 1.0) - most).max() < SHADE
    pressed, pulled = at(both, 0.0), at(both, 0.4)  # by a quarter of the largest, each its way
    assert pressed[1] > pressed[2] and pulled[1] < pulled[2]  # green and blue
    assert np.abs(at(taut, 0.25) - pulled).max() < SHADE
    assert tension_words(frame(0.0)).endswith(f"maximum {frame(0.0).thread.tension.max():.3g}")
    pushed = replace(frame(0.0), thread=replace(frame(0.0).thread, tension=-frame(0.0).thread.tension - 0.1))
    least, none = scale_of([pushed]).tension
    assert none == 0.0 and least == pytest.approx(pushed.thread.tension.min(), rel=0.1)
    assert np.abs(at(tension_colours(scale_of([pushed])), 1.0) - rest).max() < SHADE
    assert tension_words(pushed).endswith(f"{pushed.thread.tension.min():.3g} to {pushed.thread.tension.max():.3g}")


@pytest.mark.parametrize(("low", "high"), [(0.0, 34.1e3), (-0.0433, 0.181), (0.0, 1.0), (-2e-7, 3.1e-9), (-7.0, 0.0)])
def test_bars_have_round_numbers_with_zero_among_them(low: float, high: float) -> None:
    """Independent check: two to four numbers of one digit times a power of ten, evenly, all within the range, with no
    room for one more at either end, and a zero that is written so."""
    found = ticks(low, high)
    part = found[1] - found[0]
    assert 2 <= len(found) <= TICKS
    assert np.diff(found) == pytest.approx(part, rel=1e-12)
    assert low <= found[0] < low + part and high - part < found[-1] <= high
    assert float(f"{part:.1g}") == pytest.approx(part, rel=1e-12)
    assert "0" in [f"{tick:.3g}" for tick in found]


def test_numbers_stand_over_their_places_on_a_bar(tmp_path: Path) -> None:
    """Independent check: the dark pixels of each number are centred over its share of the bar of stresses, which is
    found by the colours of its ends."""
    line, _ = draw_scene(SCENE, tmp_path / "picture.png")
    if "3-D picture" not in line:
        pytest.skip(line)
    image = imread(tmp_path / "picture.png")[..., :3]
    lowest = len(image) - 50  # a row of pixels in the bars of colours
    first, last = (np.nonzero(np.abs(image[lowest] - shade).max(axis=1) < SHADE)[0] for shade in colours()[[0, -1]])
    left, right = first.min(), last.max()
    dark = image[lowest - 60 : lowest - 30, left - 20 : right + 20].max(axis=2) < 0.3
    places = np.nonzero(dark.any(axis=0))[0] + left - 20
    numbers = [0.5 * (part[0] + part[-1]) for part in np.split(places, np.nonzero(np.diff(places) > 20)[0] + 1)]
    low, high = scale_of([frame(0.1, LINEAR)]).stress
    wanted = left + (right - left) * (np.array(ticks(low / KILO, high / KILO)) - low / KILO) / (high - low) * KILO
    assert numbers == pytest.approx(wanted, abs=3.0)


def test_the_whole_organ_is_in_the_picture_unless_it_is_very_large() -> None:
    """Independent check: the pixels of its nodes; of one a hundred times as large the thread keeps its size."""
    from studies.pictures.space import stage_of

    stage = stage_of([frame(0.1)], LINEAR, "")
    places = stage.camera.pixels(LINEAR.points + frame(0.1).organ.displacement)  # type: ignore[union-attr]
    assert (places >= 0.0).all() and (places <= SIZE).all()
    huge = OrganTopology(100.0 * LINEAR.points, LINEAR.cells)
    assert stage_of([frame(0.1, huge)], huge, "").camera.scale >= stage.camera.scale


@pytest.mark.parametrize("space", [True, False], ids=["space", "section"])
def test_the_start_is_drawn_with_held_nodes_and_footprints(tmp_path: Path, space: bool) -> None:
    """Independent check: blue dots and red balls, which another picture of the same frame does not have."""
    start, plain = tmp_path / "start.png", tmp_path / "plain.png"
    at = frame(0.1)
    marked = replace(frame_of(at), held=LINEAR.points)
    marked = replace(marked, piercings=tuple(replace(hole, footprint=5e-3) for hole in marked.piercings))
    modules = "studies.pictures.space" if space else "studies.no", "studies.pictures.section"
    for scene, path in ((marked, start), (frame_of(at), plain)):
        if "section" in draw_scene(([scene], LINEAR, ""), path, modules)[0] and space:
            pytest.skip("OpenGL does not work here")
    counts = []
    for path in (start, plain):
        red, green, blue = np.moveaxis(imread(path)[..., :3], 2, 0)
        counts.append((int((red > green + 0.2).sum()), int((blue > red + 0.2).sum())))
    assert all(with_marks > without for with_marks, without in zip(*counts, strict=True))


def test_an_organ_without_sharp_edges_is_drawn(tmp_path: Path) -> None:
    """Independent check: a ball, whose facets meet at a few degrees, is drawn in space like a block."""
    pyvista = pytest.importorskip("pyvista")
    skin = pyvista.Icosphere(radius=0.02, nsub=4)
    points = np.vstack([skin.points, np.zeros(3)])
    cells = np.column_stack([skin.regular_faces, np.full(skin.n_cells, skin.n_points)]).astype(np.int64)
    ball = replace(frame_of(frame(0.1)), organ=Organ(np.zeros_like(points), np.ones(len(points))), piercings=())
    known, _ = draw_scene(SCENE, tmp_path / "known.png")
    if "(VTK)" not in known:
        pytest.skip(known)
    line, failure = draw_scene(([ball], OrganTopology(points, cells), ""), tmp_path / "picture.png")
    assert not failure and "(VTK)" in line and is_drawn(tmp_path / "picture.png")
