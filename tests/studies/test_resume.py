"""Checkpoint and resume: a run that was killed, interrupted or out of disk goes on to the same numbers, bit by bit."""

import errno
import io
import json
import os
import signal
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import pyvista as pv

from studies.command import command
from studies.output.checkpoint import CHECKPOINT, changes, first_in_words, read_checkpoint, sealed, write_checkpoint
from studies.output.folder import Recorder, can_resume
from studies.output.manifest import MARK
from studies.output.records import StepRecord
from studies.output.tally import Tally
from studies.scenario import ScenarioError, dump, load, parse
from studies.scenario.toml import tables
from studies.simulation import prepare

ROOT = Path(__file__).parents[2]
STEPS, EVERY = 24, 5
SCENARIO = f"""
title = "a stitch that begins and one that ends"
[thread]
suture = "2-0 polypropylene"
control_points = 30
path = [[-0.015, 0, 0.015], [-0.005, 0, 0.006], [-0.005, 0, -0.005], [0.005, 0, -0.005], [0.005, 0, 0.006],
        [0.015, 0, 0.015]]
start = {{ kind = "pulled", force = [-0.02, 0, 0.02], ramp = 0.01 }}
end = {{ kind = "driven", waypoints = [[0, 0.015, 0, 0.015], [0.06, 0.02, 0, 0.018]] }}
damping = 20.0
[tissue]
youngs_modulus = 1.0e5
poisson_ratio = 0.45
density = 1070.0
rayleigh = [5.0, 5.0e-4]
clamp = ["bottom"]
[tissue.mesh]
accuracy = "given"
kind = "block"
size = [0.03, 0.02, 0.01]
h = 5.0e-3
[[piercing]]
name = "entry"
at = [-0.005, 0, 0]
direction = "normal"
footprint = 2.0e-3
friction = {{ static = 0.12, kinetic = 0.1 }}
until = 0.019
[[piercing]]
name = "exit"
at = [0.007, 0, 0]
direction = "normal"
footprint = 2.0e-3
from = 0.0115
[solve]
dt = 1.0e-3
duration = {STEPS}.0e-3
[output]
every = {EVERY}
"""
TIMINGS = ("provenance", "seconds_per_step")


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scenario") / "late.toml"
    path.write_text(SCENARIO, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def whole(file: Path) -> Path:
    """An uninterrupted run."""
    out = file.parent / "whole"
    assert start(file, out) == 0
    return out


def start(file: Path, out: Path, *more: str) -> int:
    return command.main(["run", str(file), "--out", str(out), "--quiet", "--no-picture", *more])


def numbers(folder: Path) -> dict[str, Any]:
    """The summary without timings."""
    summary = json.loads((folder / "summary.json").read_text())
    return {key: value for key, value in summary.items() if key not in TIMINGS}


def without_seconds(folder: Path) -> list[str]:
    return [line.rpartition(",")[0] for line in (folder / "steps.csv").read_text().splitlines()]


def assert_same(folder: Path, whole: Path) -> None:
    """Summary, tables and every frame, to the last byte."""
    assert numbers(folder) == numbers(whole)
    assert without_seconds(folder) == without_seconds(whole)
    frames = sorted(path.name for path in (whole / "frames").iterdir())
    assert sorted(path.name for path in (folder / "frames").iterdir()) == frames
    for name in ("energy.csv", "piercings.csv", "events.csv", "results.pvd", *(f"frames/{name}" for name in frames)):
        assert (folder / name).read_bytes() == (whole / name).read_bytes(), name
    assert not [path for path in folder.rglob(".*")]


def readable_frames(folder: Path) -> int:
    """Number of frames that the index names, each of them parsed."""
    index = folder / "results.pvd"
    if not index.exists():
        return 0
    entries = list(ElementTree.parse(index).getroot().iter("DataSet"))
    for entry in entries:
        assert pv.read(folder / entry.attrib["file"]).n_points > 0
    return len({entry.attrib["timestep"] for entry in entries})


# -- killed ----------------------------------------------------------------------------------------------------------


DYING = """
import os, signal, sys
sys.path[:0] = [{root!r}]
from studies.command import command
from studies.output import files, tables

def die():
    os.kill(os.getpid(), signal.SIGKILL)

seen = {{"rename": 0, "row": 0}}
rename, append = os.replace, tables.CsvFile.append

def dying_rename(source, target):
    seen["rename"] += 1
    if {kind!r} == "rename" and seen["rename"] == {count}:
        die()
    rename(source, target)
    if {kind!r} == "renamed" and str(target).endswith({target!r}):
        seen["row"] += 1
        if seen["row"] == {count}:
            die()

def dying_append(table, rows):
    seen["row"] += {kind!r} == "row"
    if {kind!r} == "row" and seen["row"] == {count}:
        table._file.write(b"0.00123,1")
        die()
    append(table, rows)

files.os.replace, tables.CsvFile.append = dying_rename, dying_append
command.main(["run", {file!r}, "--out", {out!r}, "--quiet", "--no-picture"])
"""

KILLS = [  # the kind of moment, which of them, the file that was renamed, and how many frames are there then
    ("rename", 1, "", 0),  # before the first file is there
    ("rename", 2, "", 0),  # before scenario.toml is there: nothing to go on with
    ("rename", 7, "", 1),  # before the first checkpoint
    ("row", 4 + 4 * 9 + 2, "", 2),  # in the middle of a row of step 9
    ("renamed", 3, "results.pvd", 3),  # a frame is written and its checkpoint is not
    ("renamed", 4, CHECKPOINT, 4),  # between the two events
    ("rename", 32, "", 6),  # all is there but the summary
    ("renamed", 1, "summary.json", 6),  # at the very end
]


@pytest.mark.parametrize(("kind", "count", "target", "frames"), KILLS)
def test_a_killed_run_goes_on_to_the_same_numbers(
    file: Path, whole: Path, tmp_path: Path, kind: str, count: int, target: str, frames: int
) -> None:
    """Consistency check: SIGKILL at a chosen moment leaves whole frames; resumed, every file is that of one run."""
    out = tmp_path / "out"
    script = DYING.format(root=str(ROOT), kind=kind, count=count, target=target, file=str(file), out=str(out))
    environment = dict(os.environ, OMP_NUM_THREADS="1")
    died = subprocess.run([sys.executable, "-c", script], env=environment, check=False)
    assert died.returncode == -signal.SIGKILL
    assert readable_frames(out) == frames
    assert start(file, out, "--resume") == 0
    assert_same(out, whole)


def test_a_run_may_be_resumed_again_and_again(
    file: Path, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Consistency check: interrupted at steps 3, 9, 16 and 22; the folder names each time it was taken up."""
    out, update = tmp_path / "out", command.Progress.update
    for number in (3, 9, 16, 22):

        def interrupting(
            self: command.Progress, step: int, time: float, n: int, seconds: float, at: int = number
        ) -> None:
            update(self, step, time, n, seconds)
            if step == at:
                os.kill(os.getpid(), signal.SIGINT)

        monkeypatch.setattr(command.Progress, "update", interrupting)
        assert start(file, out, "--resume") == 128 + signal.SIGINT
        summary = json.loads((out / "summary.json").read_text())
        assert (summary["status"], summary["steps"]) == ("interrupted", number)
        assert readable_frames(out) == 2 + number // EVERY
    monkeypatch.undo()
    assert start(file, out, "--resume") == 0
    assert_same(out, whole)
    assert len(json.loads((out / MARK).read_text())["resumed"]) == 4


# -- lengthened ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("duration", [0.015, 0.0148, 0.003])
def test_a_run_that_is_lengthened_is_one_of_the_longer_duration(
    file: Path, whole: Path, tmp_path: Path, duration: float
) -> None:
    """Consistency check: from an end at a frame that was due, from one within a step, whose last state the longer run
    never comes by, and from one before the first checkpoint; every file is that of one run, the scenario's too."""
    out = tmp_path / "out"
    assert start(file, out, "--set", f"solve.duration={duration}") == 0
    assert start(file, out, "--resume") == 0
    assert_same(out, whole)
    assert (out / "scenario.toml").read_bytes() == (whole / "scenario.toml").read_bytes()
    digests = [json.loads((folder / MARK).read_text())["scenario_sha256"] for folder in (out, whole)]
    assert digests[0] == digests[1]
    assert start(file, out, "--resume") == 0  # nothing remains to be done


def test_only_the_duration_may_grow(file: Path, whole: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Independent check: a shorter one, another key beside it, and that of statics, where loads follow it."""
    for override, said in [
        (["solve.duration=0.02"], "solve.duration was 0.024 and is 0.02"),
        (["solve.duration=0.03", "solve.dt=5e-4"], "solve.dt was 0.001 and is 0.0005"),
        (["solve.duration=0.03", "solve.epsilon=1e-9"], "solve.epsilon was 0.0 and is 1e-09"),
    ]:
        assert start(file, whole, "--resume", *(word for each in override for word in ("--set", each))) == 2
        assert said in capsys.readouterr().err
    held = parse(tomllib.loads(SCENARIO)).model_copy(update={"piercing": ()})
    longer = [held.model_copy(update={"solve": held.solve.model_copy(update={"kind": "static", "duration": at})})
              for at in (0.1, 0.2)]  # fmt: skip
    with Recorder(file.parent / "static", Tally(longer[0])):
        pass
    with pytest.raises(ScenarioError, match=r"solve\.duration was 0\.1 and is 0\.2"):
        can_resume(file.parent / "static", longer[1])


# -- out of disk -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("when", [9, 16, 21])
def test_a_full_disk_is_a_failed_run_that_goes_on(
    file: Path, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, when: int
) -> None:
    """Consistency check: from some file on nothing can be written, not even the summary; then there is room again."""
    out, write, written = tmp_path / "out", Path.write_bytes, [0]

    def full(path: Path, data: bytes) -> int:
        written[0] += 1
        if written[0] >= when:
            write(path, data[: len(data) // 2])
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
        return write(path, data)

    monkeypatch.setattr(Path, "write_bytes", full)
    assert start(file, out) == command.FAILED
    assert written[0] >= when
    assert not (out / "summary.json").exists()
    monkeypatch.undo()
    assert start(file, out, "--resume") == 0
    assert_same(out, whole)


def test_a_table_that_cannot_grow_is_a_failed_run_that_goes_on(file: Path, whole: Path, tmp_path: Path) -> None:
    """Consistency check: the kernel refuses to let files grow beyond what piercings.csv needs for some twelve steps;
    the summary says what failed."""
    limit = (whole / "piercings.csv").stat().st_size // 2
    out = tmp_path / "out"
    script = (
        f"import resource, sys; sys.path[:0] = [{str(ROOT)!r}]\n"
        "from studies.command import command\n"
        "from studies.output import tables\n"
        "append = tables.CsvFile.append\n"
        "def limited(table, rows):\n"
        "    if table._file.name.endswith('piercings.csv'):\n"
        f"        resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, resource.RLIM_INFINITY))\n"
        "    try:\n        append(table, rows)\n"
        "    finally:\n"
        "        resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))\n"
        "tables.CsvFile.append = limited\n"
        f"sys.exit(command.main(['run', {str(file)!r}, '--out', {str(out)!r}, '--quiet', '--no-picture']))\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == command.FAILED
    assert "Traceback" not in done.stderr
    summary = json.loads((out / "summary.json").read_text())
    assert summary["status"] == "failed"
    assert 5 < summary["steps"] < STEPS
    assert start(file, out, "--resume") == 0
    assert_same(out, whole)


# -- what is not resumed ---------------------------------------------------------------------------------------------


def test_a_completed_run_is_left_alone(file: Path, whole: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Independent check: nothing to do is no error, and touches nothing."""
    before = {path: path.stat().st_mtime_ns for path in whole.rglob("*")}
    assert command.main(["run", str(file), "--out", str(whole), "--resume"]) == 0
    assert "is complete; nothing remains to be done" in capsys.readouterr().out
    assert {path: path.stat().st_mtime_ns for path in whole.rglob("*")} == before
    assert command.main(["run", str(whole / "scenario.toml"), "--out", str(whole), "--resume", "--quiet"]) == 0


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("solve.dt=5e-4", "solve.dt was 0.001 and is 0.0005"),
        ("piercing.exit.until=0.02", "piercing.exit.until was not given and is 0.02"),
        ("output.every=3", "output.every was 5 and is 3"),
    ],
)
def test_another_scenario_is_refused(
    file: Path, whole: Path, capsys: pytest.CaptureFixture[str], override: str, said: str
) -> None:
    """Independent check: the first key that changed is named with both values, status 2, before a mesh is made."""
    assert start(file, whole, "--resume", "--set", override) == command.REFUSED
    message = capsys.readouterr().err
    assert message.startswith("suture: --resume is refused: ")
    assert said in message
    assert "run with --overwrite to start again" in message


def test_another_mesh_is_refused(tmp_path: Path) -> None:
    """Independent check: the same path with other contents."""
    mesh = tmp_path / "organ.msh"
    mesh.write_text("a mesh", encoding="utf-8")
    data = tables(parse(tomllib.loads(SCENARIO)))
    data["tissue"] |= {"mesh": {"kind": "file", "path": str(mesh), "accuracy": "given"}, "clamp": ["bottom"]}
    with Recorder(tmp_path / "out", Tally(parse(data))):
        pass
    assert can_resume(tmp_path / "out", parse(data))
    mesh.write_text("another mesh", encoding="utf-8")
    with pytest.raises(ScenarioError, match=r"contents of tissue\.mesh\.path changed"):
        can_resume(tmp_path / "out", parse(data))


def test_an_empty_folder_begins_anew(file: Path, whole: Path, tmp_path: Path) -> None:
    """Consistency check: --resume may be written always."""
    assert start(file, tmp_path / "new", "--resume") == 0
    assert_same(tmp_path / "new", whole)


@pytest.mark.parametrize(
    "damage", ["truncated", "rows lost", "arrays one by one", "other columns", "state.q", "extremes.forces"]
)
def test_a_damaged_folder_is_refused(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], damage: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Independent check: no guess is made at what is missing."""
    out = tmp_path / "out"
    monkeypatch.setattr(command.Progress, "update", lambda self, step, *_: step == 7 and signal.raise_signal(2))
    assert start(file, out) == 128 + signal.SIGINT
    monkeypatch.undo()
    if damage == "truncated":
        (out / CHECKPOINT).write_bytes((out / CHECKPOINT).read_bytes()[:1000])
    elif damage == "rows lost":
        rows = (out / "energy.csv").read_bytes().splitlines(keepends=True)
        (out / "energy.csv").write_bytes(b"".join(rows[:4]))
    elif damage == "other columns":
        rows = (out / "steps.csv").read_bytes()
        (out / "steps.csv").write_bytes(rows.replace(b"time [s]", b"time", 1))
    elif damage == "arrays one by one":
        written = io.BytesIO()
        np.savez(written, **read_checkpoint(out) or {})  # type: ignore[arg-type]
        (out / CHECKPOINT).write_bytes(sealed(written.getvalue()))
    else:
        held = read_checkpoint(out)
        assert held is not None
        write_checkpoint(out, {name: array for name, array in held.items() if name != damage})  # of another version
    capsys.readouterr()
    assert start(file, out, "--resume") == command.REFUSED
    assert "run with --overwrite to start again" in capsys.readouterr().err
    assert (out / "summary.json").is_file() or damage == "state.q"  # that is found out once the run is prepared
    assert start(file, out, "--overwrite") == 0


# -- bit by bit ------------------------------------------------------------------------------------------------------


WOUND = 'tissue.mesh={kind="wound", size=[0.03, 0.02, 0.01], length=0.014, depth=0.006, h=3e-3, accuracy="given"}'
PRESSED = """tissue.load=[{ boundary = "left", pressure = 1e3 }, { boundary = "right", pressure = 1e3 },
                          { boundary = "top", pressure = -2e3, course = { kind = "ramp", over = 0.024 } }]"""
METHODS = {
    "euler": ("solve.integrator=euler",),
    "bdf2": ("solve.integrator=bdf2",),
    "staggered": ("solve.coupling=staggered", "thread.control_points=60"),
    "quasi-static": ("tissue.inertia=false",),
    "krylov": ("solve.organ=krylov",),
    "lips": ("tissue.inertia=false", "tissue.contact=true", "tissue.youngs_modulus=1e6", WOUND, PRESSED),
    "relaxing": ("tissue.material=neo-hookean", "tissue.rayleigh=[5, 0]", "tissue.relaxation=[[0.3, 0.01]]"),
    "static": ("solve.kind=static", "piercing.exit.from=0.0", "piercing.entry.until=1.0", "solve.load_steps=8"),
}


@pytest.mark.parametrize("method", METHODS)
def test_the_next_step_depends_on_the_checkpoint_alone(file: Path, tmp_path: Path, method: str) -> None:
    """Consistency check: from a checkpoint on disk, a simulation built afresh takes the same steps by every method,
    every recorded number and all of the memory equal, bit by bit. What is made of the displacement is left out."""
    scenario = load(file, METHODS[method])
    records = [step for step, _ in prepare(scenario).advance()]
    for number in (0, 6):
        memory = records[number].memory
        assert memory is not None and not any(name.endswith(".MU") for name in memory)
        write_checkpoint(tmp_path, memory)
        again = [step for step, _ in prepare(scenario).advance(read_checkpoint(tmp_path))]
        assert [step.step for step in again] == [step.step for step in records[number:]]
        for before, after in zip(records[number + 1 :], again[1:], strict=True):
            assert_equal(before, after)


def assert_equal(before: StepRecord, after: StepRecord) -> None:
    assert before.memory is not None and after.memory is not None
    assert before.memory.keys() == after.memory.keys()
    for name, array in before.memory.items():
        assert np.array_equal(array, after.memory[name]), name
        assert array.dtype == after.memory[name].dtype, name
    assert before.energy == after.energy
    assert repr(before.events) == repr(after.events)
    for one, other in zip(before.piercings, after.piercings, strict=True):
        assert (one.state, one.slip, one.s) == (other.state, other.slip, other.s)


def test_differences_are_named_by_key() -> None:
    """Independent check: a value, a key that appears, an entry of a list; equal scenarios differ in nothing."""
    text = dump(parse(tomllib.loads(SCENARIO)))
    assert first_in_words(changes(text, text)) is None
    assert first_in_words(changes("a = 1\n[b]\nc = 2", "a = 1\n[b]\nc = 3")) == "b.c was 2 and is 3"
    assert first_in_words(changes("a = 1", "a = 1\nb = 2")) == "b was not given and is 2"
    assert first_in_words(changes('[[p]]\nname = "x"\ns = 1', '[[p]]\nname = "x"\ns = 2')) == "p.x.s was 1 and is 2"
