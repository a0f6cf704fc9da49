"""Looking at a run: the camera, labels that cover nothing, pictures and animations, columns over time, and the stages
told before the first step."""

import io
import logging
import re
import threading
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
import pyvista as pv
from PIL import Image

from coupling.step.tables import OVER
from studies.command.command import main
from studies.command.progress import TERMINAL, Progress, Stages, stages
from studies.output.columns import CONTACTS, LOADS
from studies.output.reading import ResultsError, open_run, read_table, topology_of
from studies.output.records import LoadRecord, Record
from studies.output.tables import CsvFile
from studies.pictures import looking, section
from studies.pictures.camera import CLEAR, camera_on, label_places, scale_bar
from studies.pictures.scene import frame_of
from studies.pictures.view import aimed_at, force_text, legend, scale_of
from studies.report.charts import series_of
from studies.report.plotting import line_of
from tests.studies.samples import LINEAR, contact, frame, step
from tests.studies.test_report import record_run

SIZE, MARGINS = (1500, 1000), (60.0, 40.0, 170.0, 110.0)
SINGLE = 1e-6  # frames are in single precision


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record_run(tmp_path_factory.mktemp("looking") / "run")


@pytest.mark.parametrize("stretch", [(1, 1, 1), (20, 1, 1), (1, 1, 20)])
def test_the_camera_sees_all_within_its_margins_as_large_as_it_goes(stretch: tuple[float, float, float]) -> None:
    """Independent check: every point inside the margins, two on opposite ones; a metre across has its pixels."""
    points = np.random.default_rng(1).normal(size=(200, 3)) * stretch * 0.01 + [1.0, 2.0, 3.0]
    camera = camera_on(points, SIZE, MARGINS)
    left, right, below, above = MARGINS
    low, high = np.array([left, below]), np.array(SIZE) - [right, above]
    pixels = camera.pixels(points)
    assert np.all(pixels >= low - 1e-6) and np.all(pixels <= high + 1e-6)
    room = np.concatenate([pixels.min(axis=0) - low, high - pixels.max(axis=0)])
    touching = np.abs(room) < 1e-6
    assert (touching[0] and touching[2]) or (touching[1] and touching[3])
    ends = camera.pixels(np.array([camera.focus, camera.focus + 0.01 * camera.right]))
    assert np.linalg.norm(ends[1] - ends[0]) == pytest.approx(0.01 * camera.scale, rel=1e-12)


def test_a_scale_bar_is_a_round_length_that_fits() -> None:
    """Independent check: 1, 2 or 5 times a power of ten, no longer than there is room and more than a third of it."""
    assert scale_bar(20_000.0, 240.0) == (pytest.approx(0.01), "10 mm")
    for scale in np.geomspace(10.0, 1e7, 50):
        length, words = scale_bar(float(scale), 240.0)
        assert 96.0 - 1e-6 <= length * scale <= 240.0 + 1e-6
        assert float(f"{length:.0e}"[0]) in (1, 2, 5) and words.endswith(" mm")


def test_labels_cover_neither_one_another_nor_the_thread() -> None:
    """Independent check: boxes around the labels of six holes on a line are apart, in the picture, and off the line."""
    anchors = np.array([[400.0 + 60 * k, 500.0] for k in range(6)])
    boxes = np.tile([150.0, 24.0], (6, 1))
    line = np.array([[x, 500.0] for x in range(300, 900, 4)])
    corners = label_places(anchors, boxes, line, SIZE)
    for k, (corner, box) in enumerate(zip(corners, boxes, strict=True)):
        assert np.all(corner >= 0.0) and np.all(corner + box <= SIZE)
        inside = np.all((line >= corner - CLEAR) & (line <= corner + box + CLEAR), axis=1)
        assert not inside.any()
        for other in corners[:k]:
            assert np.any(np.abs(corner - other) >= box)


def test_frames_read_back_as_they_were_recorded(run: Path) -> None:
    """Consistency check: what a picture is drawn from is the same from the files as from the run, within their
    precision."""
    results = open_run(run)
    found, written = looking.read_frame(results.frames[-1], results.piercings), frame(step(3).time)
    assert found.time == written.time and [hole.name for hole in found.piercings] == ["entry", "exit"]
    np.testing.assert_allclose(found.thread.points, written.thread.points, atol=SINGLE)
    for hole, given in zip(found.piercings, written.piercings, strict=True):
        assert (hole.state, hole.s) == (given.state, pytest.approx(given.s, rel=SINGLE))
        np.testing.assert_allclose(hole.force, given.force, rtol=SINGLE)
    assert found.organ is not None and written.organ is not None
    np.testing.assert_allclose(found.organ.von_mises, written.organ.von_mises, rtol=SINGLE)
    mesh = topology_of(results.frames[0])
    assert mesh is not None
    np.testing.assert_array_equal(mesh.cells, LINEAR.cells)


def test_arrays_of_frames_say_their_units(run: Path) -> None:
    """Independent check: VTK's own reader finds the unit of an array, and none of one without."""
    thread = pv.read(next((run / "frames").glob("thread_*")))
    array = thread.GetPointData().GetArray("tension")
    assert array.GetInformation().Get(array.UNITS_LABEL()) == "N"


def test_a_run_without_a_screen_is_a_picture_and_an_animation(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Independent check: with no display the files are asked for; with one the window's own failure leads to them."""
    assert looking.has_screen({"DISPLAY": ":0"}, "linux") and looking.has_screen({}, "darwin")
    assert not looking.has_screen({"DISPLAY": ""}, "linux")
    asked: list[Path] = []

    def note(results: object, out: Path, time: float | None) -> str:
        asked.append(out)
        return str(out)

    for screen, lacking, files in ((False, "", 2), (True, "", 0), (True, "no display", 2)):
        asked.clear()
        with (
            patch.object(looking, "has_screen", return_value=screen),
            patch.object(looking, "window", return_value=lacking),
            patch.object(looking, "drawn_into", note),
        ):
            assert main(["view", str(run)]) == 0
        assert [path.name for path in asked] == ["view.png", "view.gif"][:files]
    assert main(["view", str(run), "--out", str(run / "x.csv")]) == 2
    assert ".gif for all frames" in capsys.readouterr().err


def test_a_display_that_cannot_be_opened_is_named(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Independent check: the window's process says so, and the command says so too, shows the run in files that are
    there and names them: that is why it ends with 0. Modules of the folder that one stands in are not run."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("DISPLAY", ":99")
    for name in ("studies", "pyvista"):
        (tmp_path / f"{name}.py").write_text(f"open({str(tmp_path / 'run')!r}, 'w')")
    with patch.object(looking, "MOST_PICTURES", 2):
        assert main(["view", str(run)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "window none: VTK cannot open a window on the display ':99'" in said
    for name in ("view.png", "view.gif"):
        assert f"{name}:" in said and (run / name).stat().st_size > 1000
        (run / name).unlink()
    with patch.object(looking, "drawn_into", side_effect=ResultsError("no picture could be drawn")):
        assert main(["view", str(run)]) == 2
    assert "no picture could be drawn" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_a_dollar_in_a_title_or_a_name_begins_no_formula(tmp_path: Path) -> None:
    """Independent check: half a formula is drawn letter by letter, in a plot and in a section."""
    folder = record_run(tmp_path / "run", title="$x_{$")
    assert main(["plot", str(folder), "energy.kinetic", "--out", str(tmp_path / "plot.svg")]) == 0
    assert "$x_{$" in (tmp_path / "plot.svg").read_text(encoding="utf-8")
    last = frame_of(frame(1.0))
    holes = tuple(replace(hole, name="$x_{$") for hole in last.piercings)
    section.draw_section([replace(last, piercings=holes)], LINEAR, tmp_path / "section.png", "$x_{$")


def test_an_animation_has_a_picture_for_each_frame_to_one_scale(run: Path, tmp_path: Path) -> None:
    """Independent check: as many pictures as frames, which differ; one scale has the extremes of all frames."""
    results = open_run(run)
    frames = [looking.read_frame(found, results.piercings) for found in results.frames[1:3]]
    section.draw_section(frames, LINEAR, tmp_path / "film.gif", "title")
    with Image.open(tmp_path / "film.gif") as film:
        assert film.n_frames == 2
        pictures = [np.asarray(film.convert("RGB")) for number in range(2) if film.seek(number) is None]
    assert np.any(pictures[0] != pictures[1])
    scale = scale_of(frames)
    for one in frames:
        assert np.all(one.thread.points >= scale.low) and np.all(one.thread.points <= scale.high)


def test_a_piece_that_is_cut_and_flies_away_does_not_shrink_the_rest() -> None:
    """Independent check: a piece in no hole is aimed at while it lies near, no more once it has flown metres away, and
    a thread in one piece always."""
    whole = frame(1.0)
    holes = tuple(replace(hole, s=0.01) for hole in whole.piercings)
    cut = replace(whole, thread=replace(whole.thread, pieces=(6, 5)), piercings=holes)
    flown = whole.thread.points + np.where(np.arange(11) >= 6, 5.0, 0.0)[:, None]
    width = scale_of([cut]).width
    assert width == scale_of([whole]).width
    away = replace(cut, thread=replace(cut.thread, points=flown))
    assert scale_of([away]).width < width and len(aimed_at(away)) == 6
    assert len(aimed_at(replace(away, thread=replace(away.thread, pieces=())))) == 11
    none = replace(away, piercings=tuple(replace(hole, state="left") for hole in holes))
    assert len(aimed_at(none)) == 11


def test_what_round_off_leaves_of_a_slack_thread_is_not_drawn() -> None:
    """Independent check: forces of a piconewton have neither arrow nor colour nor name, those of a millinewton have."""
    felt = frame_of(frame(1.0))
    holes = tuple(replace(hole, force=np.array([0.0, 1e-3, 0.0])) for hole in felt.piercings)
    felt = replace(felt, thread=replace(felt.thread, tension=0 * felt.thread.tension + 1e-3), piercings=holes)
    slack = replace(
        felt,
        thread=replace(felt.thread, tension=1e-9 * felt.thread.tension),
        piercings=tuple(replace(hole, force=1e-9 * hole.force) for hole in holes),
    )
    scale, none = scale_of([felt]), scale_of([slack])
    assert scale.shows(1e-3) and scale.tension == (0.0, 1e-3) and force_text(1e-3) == "1 mN"
    assert (
        not none.shows(1e-12) and none.tension == (0.0, 1.0) and not legend(none, slack) and force_text(1e-12) == "0 mN"
    )


def test_a_picture_of_a_time_is_that_of_the_nearest_frame(run: Path) -> None:
    """Independent check: the frame whose time is nearest, and the last without a time."""
    frames = open_run(run).frames
    assert looking.nearest(frames, 0.14).step == 1
    end = frames[-1].time
    assert looking.nearest(frames, end).step == looking.nearest(frames, None).step == 3
    for outside in (-0.1, 1.01 * end, float("nan")):
        with pytest.raises(ResultsError, match=rf"--time .* is refused: the run ends at {end:g} s"):
            looking.nearest(frames, outside)


def test_columns_are_drawn_over_time(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Independent check: a column by its name, a vector by its length, in the unit of the charts; a wrong name ends in
    the nearest, and in the columns of its table."""
    results = open_run(run)
    slip = line_of(results, "piercings.exit.slip")
    assert (slip.name, slip.unit) == ("piercings.exit.slip", "mm")
    np.testing.assert_allclose(slip.values, 1e3 * slip.time / 3)
    np.testing.assert_allclose(line_of(results, "piercings.entry.force").values, np.sqrt(0.14))
    assert line_of(results, "energy.kinetic").unit == "mJ"
    target = tmp_path / "plot.png"
    assert main(["plot", str(run), "piercings.exit.slip", "energy.kinetic", "--out", str(target)]) == 0
    assert target.stat().st_size > 10_000
    assert main(["plot", str(run), "tension"]) == 2
    told = capsys.readouterr().err
    assert "piercings.entry.tension_before" in told and "piercings.exit.tension_after" in told and "steps" not in told
    assert main(["plot", str(run), "piercings.exit.slipp"]) == 2
    told = capsys.readouterr().err
    assert "the nearest is piercings.exit.slip;" in told and "piercings.entry.force" in told and "energy." not in told


def test_pairs_and_loads_are_curves_of_their_own(run: Path, tmp_path: Path) -> None:
    """Independent check: two pairs of surfaces and three loads, two on one boundary, are five items with a row a step,
    each with its own numbers, in the figure and in the report."""

    def load(boundary: str, share: float) -> Record:
        return LoadRecord(boundary=boundary, share=share, area=1e-4, force=np.ones(3))

    for layout in (CONTACTS, LOADS):
        table = CsvFile(tmp_path / f"{layout.name}.csv", layout.columns)
        for n in range(3):
            pairs = contact("a - b", n), contact("c - d", 10.0 + n)
            loads = ("top", n), ("top", 10.0 + n), ("left", 20.0)
            table.append(layout.rows(replace(step(n), contact=pairs, loads=tuple(load(*one) for one in loads))))
        table.close()
    tables = {name: read_table(tmp_path / f"{name}.csv") for name in ("contact", "loads")}
    results = replace(open_run(run), rows=tables)
    names = ["contact.c - d.smallest_gap", "loads.top.share", "loads.top (2).share", "loads.left.share"]
    drawn = [line_of(results, name).values.tolist() for name in names]
    assert drawn == [[1e4, 1.1e4, 1.2e4], [0, 1, 2], [10, 11, 12], [20] * 3]
    found = {one.key: one.values.tolist() for one in series_of(results, "run")}
    assert found["contact: a - b: smallest_gap"] == [0, 1e3, 2e3]
    assert found["loads: top (2): share"] == [10, 11, 12]


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_what_begins_is_told_once_and_taken_away_on_a_terminal() -> None:
    """Independent check: a line for each stage elsewhere; on a terminal one line of at most 79 characters, gone at the
    end; loggers as they were."""
    plain, terminal = io.StringIO(), Terminal()
    for stream in (plain, terminal):
        handler = Stages(stream)
        for text in ("making the mesh", "making the mesh", "factoring " + "x" * 100):
            handler.emit(logging.LogRecord("tissue", logging.INFO, "", 0, text, (), None))
        handler.close()
    assert plain.getvalue().splitlines() == ["making the mesh", "factoring " + "x" * 100]
    lines = terminal.getvalue().split("\r\x1b[K")
    assert lines[1] == "making the mesh" and len(lines[2]) == TERMINAL and lines[-1] == ""
    log = logging.getLogger("tissue")
    before = log.level, list(log.handlers)
    with stages():
        assert log.isEnabledFor(logging.INFO)
    assert (log.level, log.handlers) == before


def test_on_a_terminal_one_sees_for_how_long_something_is_waited_for() -> None:
    """Independent check: the line of what is being done goes on with its time, until a record says that it is over,
    whose line stays."""
    told = threading.Event()

    class Watched(Terminal):
        def write(self, text: str) -> int:
            if re.search(r"compiling, \d+ s$", text):
                told.set()
            return super().write(text)

    watched = Watched()
    handler = Stages(watched, every=1e-3)
    begins, ends = (
        logging.LogRecord("coupling", logging.INFO, "", 0, text, (), None) for text in ("compiling", "done")
    )
    ends.over = True
    handler.emit(begins)
    assert told.wait(timeout=60.0)
    before = threading.active_count()
    handler.emit(ends)
    assert watched.getvalue().endswith("\r\x1b[Kdone\n")
    assert threading.active_count() == before - 1
    handler.close()


def test_the_first_step_tells_what_is_left_by_its_own_time() -> None:
    """Independent check: nine more steps of 2 s, whatever was compiled before."""
    plain = io.StringIO()
    Progress(10, stream=plain).update(1, 1e-3, 4, 2.0)
    assert "18 s left" in plain.getvalue()


def test_where_a_run_goes_on_is_not_told_as_a_step() -> None:
    """Independent check: the step that was left is nothing done, and says nothing of what is left."""
    plain = io.StringIO()
    bar = Progress(10, stream=plain)
    bar.update(4, 4e-3, 0, 0.0)
    assert plain.getvalue() == ""
    bar.update(5, 5e-3, 3, 2.0)
    assert "step 5/10" in plain.getvalue()


def test_what_is_waited_for_between_two_steps_is_no_measure_of_what_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: steps of 1 s, and 40 s of compiling before the third: six more take 6 s."""
    now, plain = 0.0, io.StringIO()
    monkeypatch.setattr("studies.command.progress.monotonic", lambda: now)
    bar = Progress(10, stream=plain)
    with stages(names=("coupling.run.course",), waited=bar.begin_anew):
        for number, at in ((1, 1.0), (2, 2.0), (3, 43.0), (4, 44.0)):
            now = at
            if number == 3:
                logging.getLogger("coupling.run.course").info("compiled", extra=OVER)
            bar.update(number, 1e-3 * number, 4, 1.0)
    assert plain.getvalue().splitlines()[-1].endswith(", 6 s left")


def test_a_line_of_progress_fits_a_narrow_terminal() -> None:
    """Independent check: with large numbers too, no line that is written over is longer than 79 characters."""
    terminal = Terminal()
    progress = Progress(1_000_000, stream=terminal)
    for number in (1, 1_000_000):
        progress.update(number, 1234.56789, 20, 1e-3)
    progress.close()
    assert all(len(line.rstrip("\n")) <= TERMINAL for line in terminal.getvalue().split("\r\x1b[K"))
    assert "step 1000000/1000000" in terminal.getvalue()
