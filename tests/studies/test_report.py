"""The report of results folders: a page with their numbers, which opens without a network and answers to the mouse."""

import base64
import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from studies.command.command import main
from studies.output.folder import Recorder
from studies.output.reading import ResultsError, evenly_spaced, open_run, read_frames, read_table
from studies.pictures.view import surface
from studies.refinement.refine import refine
from studies.report import page, space
from studies.report.charts import MOST_ROWS
from studies.report.report import labels, size, write_report
from studies.report.space import Skin, decimated, whole_skin
from studies.scenario import parse
from studies.scenario.toml import changed
from studies.sweeps.sweep import sweep
from tests.studies.browser import CHROMIUM, browser
from tests.studies.samples import CORNERS, LINEAR, Stub, frame, framing, step
from tests.studies.test_sweep import ONE_STEP, RING

STEPS = 3
SIXTEEN_BITS = 1 / 2**15


def record_run(folder: Path, title: str = "a title") -> Path:
    """Write a run of no physics into a folder, a frame at every step."""
    table = {"path": [[0, 0, 0], [0.1, 0, 0]], "suture": "2-0 polypropylene"}
    holes = [{"name": name, "at": [x, 0, 0.05]} for name, x in (("entry", 0.01), ("exit", 0.03))]
    tissue = {"youngs_modulus": 1e5, "poisson_ratio": 0.4, "density": 1e3,
              "mesh": {"kind": "block", "size": [0.1, 0.1, 0.1], "h": 0.05, "accuracy": "given"}}  # fmt: skip
    scenario = parse({"title": title, "thread": table, "tissue": tissue, "piercing": holes,
                      "solve": {"dt": 0.1, "duration": 0.3}, "output": {"every": 1}})  # fmt: skip
    with Recorder(folder, Stub(scenario).tally(), LINEAR) as recorder:
        for number in range(STEPS + 1):
            recorder.record(step(number), framing(step(number).time))
    return folder


def data_of(text: str) -> dict[str, Any]:
    """The numbers that a page draws."""
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', text, re.DOTALL)
    assert found
    data: dict[str, Any] = json.loads(found[1])
    return data


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record_run(tmp_path_factory.mktemp("report") / "one")


@pytest.fixture(scope="module")
def text(run: Path) -> str:
    pytest.importorskip("plotly")
    assert main(["report", str(run), "--out", str(run.parent / "page.html")]) == 0
    return (run.parent / "page.html").read_text(encoding="utf-8")


def test_a_folder_reads_back(run: Path) -> None:
    """Independent check: the numbers and units of the records that were written, NaN where a cell is empty."""
    results = open_run(run)
    holes = results.rows["piercings"]
    assert results.piercings == ["entry", "exit"]
    assert holes.units["slip"] == "m" and "state" not in holes.units
    at_exit = holes.rows(holes.columns["piercing"] == "exit")
    np.testing.assert_array_equal(at_exit.columns["slip"], [step(k).time / 3 for k in range(4)])
    assert np.isnan(holes.columns["tension_before"]).all()
    assert [found.time for found in results.frames] == [step(k).time for k in range(STEPS + 1)]
    assert results.frames[-1].read("thread").n_points == len(frame(0.3).thread.points)
    assert results.summary["status"] == "completed" and results.provenance["suturefem"]


def test_a_torn_run_is_read_as_far_as_it_came(tmp_path: Path) -> None:
    """Independent check: half a row, no summary, an index that is cut off and one that names a lost file."""
    folder = record_run(tmp_path / "run")
    (folder / "summary.json").unlink()
    steps = (folder / "steps.csv").read_bytes()
    (folder / "steps.csv").write_bytes(steps[:-10])
    results = open_run(folder)
    assert len(results.rows["steps"].columns["time"]) == STEPS and not results.summary
    next((folder / "frames").glob("thread_000003*")).unlink()
    with pytest.raises(ResultsError, match="is missing, though"):
        results.frames[-1].read("thread")
    (folder / "results.pvd").write_text("<VTKFile", encoding="utf-8")
    assert read_frames(folder / "results.pvd") == ()
    (folder / "energy.csv").write_text("", encoding="utf-8")
    with pytest.raises(ResultsError, match="is empty"):
        read_table(folder / "energy.csv")


def test_the_page_draws_what_the_tables_say(text: str, run: Path) -> None:
    """Independent check: a series is the column of the table in the page's unit, and of a vector its length."""
    series = {one["key"]: one for one in data_of(text)["series"]}
    slip = series["piercings: entry: slip"]
    assert slip["unit"] == "mm"
    np.testing.assert_allclose(slip["y"], [1e3 * step(k).time / 3 for k in range(4)], rtol=1e-5)
    force = series["piercings: exit: force"]
    np.testing.assert_allclose(force["y"], np.sqrt(0.14), rtol=1e-5)
    assert set(series["piercings: entry: tension_before"]["y"]) == {None}
    assert "Thread drawn through each hole" in [chart["title"] for chart in data_of(text)["charts"]]


def test_the_view_has_the_shapes_that_the_frames_have(text: str) -> None:
    """Independent check: places of the surface of the last frame, unpacked, within 16 bits; field names with units."""
    [view] = data_of(text)["views"]
    organ = view["organ"]
    rest = np.frombuffer(base64.b64decode(organ["points"]), "<f4").reshape(-1, 3)
    moved = np.frombuffer(base64.b64decode(organ["displacement"]), "<i2").reshape(STEPS + 1, -1, 3)
    written = frame(step(STEPS).time).organ
    assert written is not None
    expected = CORNERS + written.displacement
    found = rest + organ["displacement_scale"] * moved[-1]
    np.testing.assert_allclose(found, expected, rtol=0, atol=SIXTEEN_BITS * np.abs(expected).max())
    assert [(field["name"], field["unit"]) for field in organ["fields"][:2]] == [
        ("von_mises", "kPa"),
        ("displacement", "mm"),
    ]
    stress = next(field for field in organ["fields"] if field["name"] == "von_mises")
    numbers = np.frombuffer(base64.b64decode(stress["values"]), "<u2").reshape(STEPS + 1, -1)
    shown = stress["low"] + stress["step"] * numbers[-1]
    np.testing.assert_allclose(shown, 1e-3 * written.von_mises, atol=SIXTEEN_BITS * 5e-3)
    np.testing.assert_allclose(view["holes"][-1][0]["force"], [0.1, 0.2, 0.3], rtol=1e-5)


def test_nothing_is_fetched(text: str) -> None:
    """Independent check: no element of the page names another file, and its head forbids what a script might load."""
    own = re.sub(r"<script>.*?</script>", "", text, flags=re.DOTALL)
    assert re.findall(r'(?:src|href)="(?!data:)', own) == []
    script = (page.HERE / "page.js").read_text(encoding="utf-8")
    drawings = re.findall(r"Plotly\.\w+\(.*\)", script)
    assert "showSendToCloud: false" in script and len(drawings) == 3  # else a button that uploads the numbers
    assert all(drawing.endswith(", CONFIG)") for drawing in drawings)
    assert "default-src 'none'" in own and "connect-src" not in own and "http" not in own.replace("http-equiv", "")


def test_the_result_stands_first_and_text_is_no_markup(tmp_path: Path) -> None:
    """Independent check: the picture, an unsupported remark, three charts, the summary, a note; a title with a tag is
    text."""
    pytest.importorskip("plotly")
    folder = record_run(tmp_path / "run", title="<b>&</b></script>")
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    kinds = [("note", "n"), ("unsupported", "u")]
    summary["remarks"] = [{"code": code, "severity": kind, "message": code, "where": ""} for kind, code in kinds]
    (folder / "summary.json").write_text(json.dumps(summary), encoding="utf-8")
    (folder / "picture.png").write_bytes(b"PNG")
    write_report([folder], tmp_path / "page.html")
    body = (tmp_path / "page.html").read_text(encoding="utf-8").partition("<script")[0]
    words = ("Result", 'class="figure"', 'class="unsupported"', 'id="chart0"', 'id="chart2"', "Summary", 'id="chart3"')
    order = [body.index(word) for word in (*words, 'class="note"><b>')]
    assert order == sorted(order)
    assert "<b>&</b>" not in body and "&lt;b&gt;&amp;&lt;/b&gt;" in body


def test_a_name_that_opens_a_script_leaves_the_numbers_whole(run: Path, tmp_path: Path) -> None:
    """Independent check: after `<!--<script>` a browser would not see the end of the numbers; none has a `<`, and they
    are read as they were."""
    pytest.importorskip("plotly")
    folder, name = tmp_path / "run", "<!--<script>"
    shutil.copytree(run, folder)
    rows = (folder / "piercings.csv").read_text(encoding="utf-8")
    (folder / "piercings.csv").write_text(rows.replace("entry", name), encoding="utf-8")
    write_report([folder], tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "<" not in text.partition('id="data">')[2].partition("</script>")[0]
    assert data_of(text)["views"][0]["piercings"] == [name, "exit"]


def test_the_length_of_a_vector_is_of_numbers_of_any_size() -> None:
    """Independent check: of numbers whose squares are none, and of nothing else that a damaged summary has."""
    assert size([3e200, 4e200, 0.0]) == pytest.approx(5e200)
    assert size([1.0, "x"]) == [1.0, "x"] and size([None, 1.0]) == [None, 1.0] and size(2.0) == 2.0


@pytest.mark.parametrize(
    "text", ['{"status": "completed"}', '{"remarks": 5}', '{"remarks": [], "piercings": [1]}', "{"]
)
def test_a_torn_scenario_or_summary_is_read_as_none(run: Path, tmp_path: Path, text: str) -> None:
    """Independent check: the page has what is whole, under the folder's name, and does not call the run sound."""
    pytest.importorskip("plotly")
    folder = tmp_path / "torn"
    shutil.copytree(run, folder)
    (folder / "summary.json").write_text(text, encoding="utf-8")
    (folder / "scenario.toml").write_bytes(b"title = \xff\n[tissue")
    write_report([folder], tmp_path / "page.html")
    body = (tmp_path / "page.html").read_text(encoding="utf-8").partition("<script")[0]
    assert "its summary is damaged" in body and "all numbers are supported" not in body
    assert open_run(folder).title == "torn"


def test_several_runs_a_study_and_a_sweep_are_compared(tmp_path: Path) -> None:
    """Independent check: a column for each run, of one name by its parent too; a study's question and figure; the
    title, origin and columns of a sweep; the verdict and figure of a refinement."""
    pytest.importorskip("plotly")
    runs = [record_run(tmp_path / parent / "run") for parent in ("a", "b")]
    study = Path(__file__).parents[2] / "studies" / "friction" / "results"
    sweep(RING, {"thread.damping": [20.0, -1.0]}, tmp_path / "swept")
    pulled = changed(RING, {"solve": ONE_STEP})
    [slip] = refine(pulled, "piercings.ring.slip", tmp_path / "refined", "control_points", levels=3)
    write_report([*runs, study, tmp_path / "swept", tmp_path / "refined"], tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "<th class=n>a/run</th><th class=n>b/run</th>" in text
    assert {one["run"] for one in data_of(text)["series"]} == {"a/run", "b/run"} == set(labels(runs)) | {"a/run"}
    friction, grid, levels = data_of(text)["grids"]
    assert text.count('<img class="figure"') == 2 and "friction" in text and len(friction["columns"]) > 3
    assert grid["columns"]["thread.damping"] == [20.0, -1.0] and grid["columns"]["energy.kinetic"][1] is None
    assert grid["units"]["piercings.ring.slip"] == "mm"
    assert "A sweep of a ring: 2 cases" in text and "A refinement of a ring: 3 cases" in text
    assert f"piercings.ring.slip [m]: {slip.text}" in text and len(levels["columns"]["cells"]) == 3
    assert text.count("arguments, versions and machine") == 3


def test_what_is_no_result_is_refused(tmp_path: Path, run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Independent check: an empty folder, a table of another, a sweep that is not finished, and a page by the
    name of a table."""
    pytest.importorskip("plotly")
    (tmp_path / "empty").mkdir()
    assert main(["report", str(tmp_path / "empty"), "--out", str(tmp_path / "page.html")]) == 2
    assert "no run, study or sweep" in capsys.readouterr().err
    (tmp_path / "empty" / "table.csv").write_text("a,b\n1,2\n", encoding="utf-8")
    assert main(["report", str(tmp_path / "empty"), "--out", str(tmp_path / "page.html")]) == 2
    assert "no run, study or sweep" in capsys.readouterr().err
    (tmp_path / "begun").mkdir()
    (tmp_path / "begun" / "sweep.json").write_text('{"kind": "sweep"}', encoding="utf-8")
    assert main(["report", str(tmp_path / "begun"), "--out", str(tmp_path / "page.html")]) == 2
    assert "no table.csv yet" in capsys.readouterr().err
    assert main(["report", str(run), "--out", str(tmp_path / "page.csv")]) == 2
    assert "name it page.html" in capsys.readouterr().err


def test_without_plotly_the_report_says_how_to_get_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Independent check: an import that fails ends in a sentence with the command."""
    monkeypatch.setitem(__import__("sys").modules, "plotly", None)
    assert main(["report", "nowhere", "--out", "page.html"]) == 2
    assert capsys.readouterr().err == "suture: plotly is not installed; add it with pip install 'suturefem[report]'\n"


def grid_skin(n: int) -> tuple[np.ndarray, Skin]:
    """The surface of a cube of n × n × n cells of six tetrahedra."""
    import skfem

    mesh = skfem.MeshTet.init_tensor(*[np.linspace(0, 1, n + 1)] * 3)
    return mesh.p.T, whole_skin(mesh.p.T, mesh.t.T)


def test_a_surface_that_is_too_fine_is_made_coarser() -> None:
    """Independent check: corners are nodes of the mesh, and area and volume of a cube are kept to a hundredth."""
    points, whole = grid_skin(16)
    count = len(whole[0])
    nodes, triangles = decimated(points, whole, count // 4)
    assert len(nodes) < count / 3
    assert set(nodes) <= set(whole[0])
    a, b, c = np.moveaxis(points[nodes[triangles]], 1, 0)
    normals = np.cross(b - a, c - a) / 2
    assert abs(np.linalg.norm(normals, axis=1).sum() / 6 - 1) < 0.01
    assert abs(np.einsum("ij,ij", a, normals) / 3 - 1) < 0.01
    assert decimated(points, whole, count) is whole
    assert len(surface(LINEAR)) == len(whole_skin(LINEAR.points, LINEAR.cells)[1])


def test_long_runs_are_thinned_out_evenly_with_their_ends() -> None:
    """Independent check: no more than there is room for, the first and the last kept."""
    assert evenly_spaced(5, MOST_ROWS).tolist() == [0, 1, 2, 3, 4]
    many = evenly_spaced(100_000, MOST_ROWS)
    assert len(many) <= MOST_ROWS and (many[0], many[-1]) == (0, 99_999) and np.ptp(np.diff(many)) <= 1
    frames = evenly_spaced(1000, space.MOST_FRAMES)
    assert len(frames) == space.MOST_FRAMES and frames[-1] == 999


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed")
def test_the_page_in_a_browser(text: str, run: Path, tmp_path: Path) -> None:
    """Independent check: in Chromium the page asks for itself alone and complains of nothing; the slider moves the
    thread and the organ, the choice of a field its colours, and a drag the camera."""
    place = "document.querySelector('#view').data.find((t) => t.name === 'thread').z.join()"
    colours = "document.querySelector('#view').data.find((t) => t.name === 'organ').intensity.join()"
    eye = "JSON.stringify(document.querySelector('#view')._fullLayout.scene._scene.getCamera().eye)"
    with browser(tmp_path) as opened:
        opened.open(run.parent / "page.html")
        opened.wait("document.querySelector('#view').data")
        assert opened.ask("document.querySelectorAll('.chart .main-svg').length") > 0
        assert opened.ask("document.querySelectorAll('.modebar-btn[data-title^=Share]').length") == 0
        last, stress = opened.ask(place), opened.ask(colours)
        opened.press("#time", "Home", 36)
        opened.wait("document.querySelector('#moment').textContent === 't = 0 s'")
        assert opened.ask(colours) == stress  # that of the sample does not change with time
        opened.press("#time", "End", 35)
        opened.press("#field", "ArrowDown", 40)
        opened.wait(f"{colours} !== {stress!r}")
        assert opened.ask(place) == last
        before = opened.ask(eye)
        opened.drag("#view", 120, -30)
        assert opened.ask(eye) != before
        opened.press("#time", "Home", 36)
        opened.wait("document.querySelector('#moment').textContent === 't = 0 s'")
        opened.click("#play")
        opened.wait("document.querySelector('#moment').textContent === 't = 0.3 s'")
        assert opened.requests == [(run.parent / "page.html").as_uri()]
        assert opened.errors == []


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed")
def test_many_lines_leave_a_chart_its_room(tmp_path: Path) -> None:
    """Independent check: with eight names in its legend the curves of a chart have a third of its height or more."""
    long = "a run whose name is as long as one may give it"
    write_report([record_run(tmp_path / f"{long}, {name}") for name in "ab"], tmp_path / "page.html")
    height = "document.querySelector('#chart0{}').getBoundingClientRect().height"
    with browser(tmp_path) as opened:
        opened.open(tmp_path / "page.html")
        opened.wait("document.querySelector('#chart0 .nsewdrag')")
        assert opened.ask("document.querySelectorAll('#chart0 .legendtext').length") == 8
        assert opened.ask(height.format(" .nsewdrag")) > opened.ask(height.format("")) / 3


def test_a_run_that_has_not_ended_is_not_said_to_be_sound(run: Path, tmp_path: Path) -> None:
    """Behaviour: without its summary, as a killed run leaves it, the page says so and has no word for its numbers."""
    killed = tmp_path / "killed"
    shutil.copytree(run, killed)
    (killed / "summary.json").unlink()
    write_report([killed], tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text()
    assert "The run has not ended" in text and "all numbers are supported" not in text
