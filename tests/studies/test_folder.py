"""The results folder: what is written, that it reads back to the same numbers and survives a kill."""

import csv
import json
import math
import os
import re
import signal
import subprocess
import sys
import tomllib
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import pyvista as pv

from studies.output.columns import Column
from studies.output.files import write_json, write_text
from studies.output.folder import Recorder, check_folder
from studies.output.lock import locked
from studies.output.manifest import MARK
from studies.output.provenance import provenance
from studies.output.tables import CsvFile
from studies.output.tally import Tally
from studies.scenario import ScenarioError, load, parse
from studies.scenario.toml import tables
from tests.studies.samples import CONTRACT, LINEAR, framing, step

ROOT = Path(__file__).parents[2]
SCENARIO = parse(tomllib.loads(CONTRACT.replace("every = 10", "every = 3")))


def recorded(folder: Path, steps: int = 7) -> Path:
    with Recorder(folder, Tally(SCENARIO, 12), LINEAR) as recorder:
        for number in range(steps + 1):
            recorder.record(step(number), framing(step(number).time))
    return folder


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def index(folder: Path) -> list[tuple[float, str]]:
    entries = ElementTree.parse(folder / "results.pvd").getroot().iter("DataSet")
    return [(float(entry.attrib["timestep"]), entry.attrib["file"]) for entry in entries]


def test_a_run_leaves_what_the_contract_says(tmp_path: Path) -> None:
    folder = recorded(tmp_path / "deep" / "out")
    summary = json.loads((folder / "summary.json").read_text())
    assert (summary["status"], summary["error"], summary["steps"]) == ("completed", "", 7)
    assert summary["newton_iterations"] == 21
    assert summary["seconds_per_step"] == 0.5
    assert summary["constraint_max"] == 1e-6
    assert summary["tissue_dofs"] == 12
    assert summary["thread"]["end"]["reaction"] == [0.0, 0.0, 0.1]
    assert summary["thread"]["max_strain"] == 0.01
    assert summary["thread"]["span_ratio"] == 0.3
    assert summary["energy"]["kinetic"] == 1 / 3
    assert set(summary["piercings"]["entry"]) == {
        *("s", "slip", "x", "displacement", "force", "normal_force", "tangential_force", "couple"),
        *("tension_before", "tension_after", "state", "cone_residual", "tangent", "channel"),
        *("mean_strain", "turn", "bearing_pressure"),
    }
    assert summary["piercings"]["exit"]["tension_before"] is None  # NaN has no place in JSON
    assert len(summary["provenance"]["scenario_sha256"]) == 64


def test_tables_have_a_row_for_every_step_with_all_digits(tmp_path: Path) -> None:
    folder = recorded(tmp_path)
    energy, piercings, steps = (rows(folder / f"{name}.csv") for name in ("energy", "piercings", "steps"))
    assert [int(row["step [-]"]) for row in energy] == list(range(8))
    assert [float(row["time [s]"]) for row in steps] == [step(number).time for number in range(8)]
    assert float(energy[0]["kinetic [J]"]) == 1 / 3
    assert [row["piercing"] for row in piercings] == ["entry", "exit"] * 8
    last = piercings[-1]
    assert [float(last[f"{axis} [m]"]) for axis in "xyz"] == list(step(7).piercings[1].x)
    assert (last["state"], last["tension_before [N]"]) == ("slip", "nan")


def test_frames_are_the_first_those_due_and_the_last(tmp_path: Path) -> None:
    entries = index(recorded(tmp_path))
    assert sorted({time for time, _ in entries}) == [step(number).time for number in (0, 3, 6, 7)]
    assert all((tmp_path / name).is_file() for _, name in entries)


def test_the_scenario_is_written_as_run(tmp_path: Path) -> None:
    assert load(recorded(tmp_path) / "scenario.toml") == SCENARIO


def test_the_mesh_file_is_kept_with_the_results(tmp_path: Path) -> None:
    data = tables(SCENARIO)
    mesh = tmp_path / "organ.msh"
    mesh.write_text("a mesh", encoding="utf-8")
    data["tissue"] |= {"mesh": {"kind": "file", "path": str(mesh), "accuracy": "given"}, "clamp": ["bottom"]}
    with Recorder(tmp_path / "out", Tally(parse(data))):
        pass
    mesh.unlink()
    scenario = load(tmp_path / "out" / "scenario.toml")
    assert Path(scenario.tissue.mesh.path).read_text() == "a mesh"  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("error", "status", "text"),
    [
        (RuntimeError("no convergence"), "failed", "no convergence"),
        (KeyboardInterrupt(), "interrupted", "user"),
    ],
)
def test_a_run_that_ends_early_keeps_what_was_written(
    tmp_path: Path, error: BaseException, status: str, text: str
) -> None:
    with pytest.raises(type(error)), Recorder(tmp_path, Tally(SCENARIO), LINEAR) as recorder:
        for number in range(5):
            recorder.record(step(number), framing(step(number).time))
        raise error
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert (summary["status"], summary["steps"]) == (status, 4)
    assert text in summary["error"]
    assert max(time for time, _ in index(tmp_path)) == step(4).time


def test_a_run_that_fails_at_the_start_has_a_summary(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError), Recorder(tmp_path, Tally(SCENARIO), LINEAR):
        raise RuntimeError("the start is inconsistent")
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert (summary["status"], summary["steps"], summary["seconds_per_step"]) == ("failed", 0, None)


def test_earlier_results_are_replaced_and_nothing_else(tmp_path: Path) -> None:
    recorded(tmp_path, steps=9)
    (tmp_path / "notes.txt").write_text("mine", encoding="utf-8")
    (tmp_path / ".results.pvd.123").write_text("of a killed run", encoding="utf-8")
    check_folder(tmp_path, overwrite=True)
    recorded(tmp_path, steps=3)
    assert sorted({time for time, _ in index(tmp_path)}) == [0.0, step(3).time]
    assert len(list((tmp_path / "frames").iterdir())) == 6
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert not (tmp_path / ".results.pvd.123").exists()


def test_a_folder_that_is_no_results_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("precious", encoding="utf-8")
    with pytest.raises(ScenarioError, match=r"--out .* is refused: it holds files that no run wrote.*; give a new"):
        check_folder(tmp_path)
    with pytest.raises(ScenarioError, match=r"it is a file; give a folder"), locked(tmp_path / "thesis.tex"):
        pass
    out = tmp_path / "thesis.tex" / "out"
    with pytest.raises(ScenarioError, match=r"cannot be written \(Not a directory\); give another"), locked(out):
        pass
    with pytest.raises(ScenarioError, match=r"cannot be written"), locked("/proc/out"):
        pass


def test_results_are_not_replaced_by_the_scenario_they_hold(tmp_path: Path) -> None:
    recorded(tmp_path)
    with pytest.raises(ScenarioError, match=r"it holds .*scenario\.toml, which this run reads .*; give another folder"):
        check_folder(tmp_path, file=tmp_path / "scenario.toml", overwrite=True)
    check_folder(tmp_path, file=tmp_path / "scenario.toml", resume=True)
    check_folder(tmp_path / "again", file=tmp_path / "scenario.toml")


KILLED = """
import sys
sys.path[:0] = [{root!r}]
from tests.studies.test_folder import SCENARIO, LINEAR, Recorder, Tally, framing, step
with Recorder({folder!r}, Tally(SCENARIO), LINEAR) as recorder:
    for number in range(10**9):
        recorder.record(step(number), framing(step(number).time))
        print(number, flush=True)
"""


@pytest.mark.parametrize("steps", [1, 8, 21])
def test_a_killed_run_leaves_every_finished_frame_readable(tmp_path: Path, steps: int) -> None:
    script = KILLED.format(root=str(ROOT), folder=str(tmp_path))
    child = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    while int(child.stdout.readline()) < steps:
        pass
    child.send_signal(signal.SIGKILL)
    child.wait()
    child.stdout.close()
    entries = index(tmp_path)
    assert len({time for time, _ in entries}) >= 1 + steps // 3
    for _, name in entries:
        assert pv.read(tmp_path / name).n_points > 0
    for name in ("energy", "piercings", "steps"):
        text = (tmp_path / f"{name}.csv").read_text()
        assert text.endswith("\n")
        assert len({line.count(",") for line in text.splitlines()}) == 1
    assert (tmp_path / MARK).is_file()
    assert load(tmp_path / "scenario.toml") == SCENARIO
    assert not (tmp_path / "summary.json").exists()
    check_folder(tmp_path, resume=True)


FULL = """
import resource, sys
sys.path[:0] = [{root!r}]
from pathlib import Path
from studies.output.columns import Column
from studies.output.tables import CsvFile
from studies.output.files import write_text
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
table = CsvFile(Path({path!r}), [Column("number", "-", "", lambda number: number, kind="whole")])
write_text(Path({text!r}), "first")
try:
    write_text(Path({text!r}), "x" * 2000)
except OSError:
    print("refused")
for number in range(10**6, 10**7):
    table.append([number, number])
"""


def test_a_full_disk_leaves_whole_lines_and_whole_files(tmp_path: Path) -> None:
    table, text = tmp_path / "table.csv", tmp_path / "text"
    script = FULL.format(root=str(ROOT), path=str(table), text=str(text))
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 1 and "OSError" in done.stderr
    numbers = table.read_text().splitlines()[1:]
    assert table.read_text().endswith("\n")
    assert len(numbers) % 2 == 0 and len(numbers) > 50
    assert all(re.fullmatch(r"\d{7}", number) for number in numbers)
    assert (done.stdout, text.read_text(), len(os.listdir(tmp_path))) == ("refused\n", "first", 2)


def test_a_table_quotes_what_needs_it(tmp_path: Path) -> None:
    names = ['a "b", c', "d", "é|;'", "two\nlines", '"']
    columns = [
        Column("piercing", "", "", lambda name: name, kind="text"),
        Column("length", "m", "", lambda name: 1.5 * len(name)),
    ]
    table = CsvFile(tmp_path / "t.csv", columns)
    table.append(names)
    table.close()
    expected = [{"piercing": name, "length [m]": str(1.5 * len(name))} for name in names]
    assert rows(tmp_path / "t.csv") == expected


def test_json_holds_plain_numbers_only(tmp_path: Path) -> None:
    write_json(tmp_path / "a.json", {"a": np.array([1.0, math.nan]), "b": np.float64(math.inf), "c": np.int64(3)})
    assert json.loads((tmp_path / "a.json").read_text()) == {"a": [1.0, None], "b": None, "c": 3}


def test_a_file_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    write_text(tmp_path / "a.txt", "first")
    with pytest.raises(UnicodeEncodeError):
        write_text(tmp_path / "a.txt", "\ud800")
    with pytest.raises(IsADirectoryError):
        write_text(tmp_path, "text")
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]
    assert (tmp_path / "a.txt").read_text() == "first"


def test_provenance_names_versions_but_no_place() -> None:
    origin = provenance()
    assert origin["packages"]["numpy"] == np.__version__
    text = json.dumps(origin)
    assert os.uname().nodename not in text
    assert str(ROOT) not in text
