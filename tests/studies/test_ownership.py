"""Whose a folder is: nothing is lost that no run wrote, no run is replaced without leave, and one runs at a time."""

import errno
import fcntl
import json
import os
import signal
import subprocess
import sys
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from studies.command import command, start
from studies.output import budget, manifest
from studies.output.checkpoint import CHECKPOINT, read_checkpoint, write_checkpoint
from studies.output.folder import Recorder, can_resume, check_folder, completed_run
from studies.output.lock import LOCK, locked
from studies.output.manifest import MARK, files_of
from studies.output.provenance import LOG, ROOT
from studies.output.tally import Tally
from studies.scenario import Scenario, ScenarioError, load, parse, schema
from studies.scenario.toml import tables
from studies.simulation import prepare
from studies.sweeps.sweep import check_folder as check_sweep_folder
from tests.studies.samples import CONTRACT, LINEAR, Stub, framing, step

SCENARIO = parse(tomllib.loads(CONTRACT.replace("every = 10", "every = 3")))


def recorded(folder: Path, scenario: Scenario = SCENARIO, steps: int = 7) -> Path:
    with Recorder(folder, Tally(scenario, 12), LINEAR) as recorder:
        for number in range(steps + 1):
            recorder.record(step(number), framing(step(number).time))
    return folder


@pytest.fixture
def contract(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A scenario whose runs are made by a stub."""
    path = tmp_path / "contract.toml"
    path.write_text(CONTRACT, encoding="utf-8")
    monkeypatch.setattr(command, "prepare", lambda scenario: replace(Stub(scenario, None), topology=None))
    return path


def run(file: Path, out: Path | str, *more: str) -> int:
    return command.main(["run", str(file), "--out", str(out), "--quiet", "--no-picture", *more])


# -- what is the user's ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text", ["{}", '{"suturefem": 1, "files"', "", "[1]", '{"author": "me", "files": []}', "\0", "[" * 100_000]
)
def test_another_provenance_makes_no_results_folder(tmp_path: Path, text: str) -> None:
    """Independent check: a file of that name, or a torn one, gives no leave to write into a folder."""
    (tmp_path / MARK).write_text(text, encoding="utf-8")
    with pytest.raises(ScenarioError, match=r"holds files that no run wrote \(provenance\.json"):
        check_folder(tmp_path, overwrite=True)
    with pytest.raises(ScenarioError, match=r"would overwrite provenance\.json, which no run wrote; move"):
        Recorder(tmp_path, Tally(SCENARIO), LINEAR)
    assert (tmp_path / MARK).read_text(encoding="utf-8") == text


def test_what_no_run_wrote_is_kept(tmp_path: Path) -> None:
    """Independent check: files of one's own between those of a run, also in its folders and named like frames."""
    own = ["mesh/organ.msh", "frames/render.png", "frames/render_000003.vtu", ".summary.json.swp", "contact.csv"]
    recorded(tmp_path)
    (tmp_path / "mesh").mkdir()
    for name in own:
        (tmp_path / name).write_text("mine", encoding="utf-8")
    recorded(tmp_path, steps=2)
    assert [(tmp_path / name).read_text(encoding="utf-8") for name in own] == ["mine"] * len(own)
    assert len(list((tmp_path / "frames").iterdir())) == 2 + 3 + 3


def test_a_run_that_would_write_over_a_file_is_refused(tmp_path: Path) -> None:
    """Independent check: the mesh of another run would take the place of a user's mesh of that name."""
    recorded(tmp_path / "out")
    (tmp_path / "out" / "mesh").mkdir()
    for place in ("out/mesh/organ.msh", "organ.msh"):
        (tmp_path / place).write_text("a mesh", encoding="utf-8")
    data = tables(SCENARIO)
    data["tissue"] |= {
        "mesh": {"kind": "file", "path": str(tmp_path / "organ.msh"), "accuracy": "given"},
        "clamp": ["bottom"],
    }
    with pytest.raises(ScenarioError, match=r"would overwrite mesh/organ\.msh, which no run wrote"):
        check_folder(tmp_path / "out", parse(data), overwrite=True)
    (tmp_path / "out/mesh/organ.msh").unlink()
    check_folder(tmp_path / "out", parse(data), overwrite=True)
    with pytest.raises(ScenarioError, match=r"it holds .*organ\.msh, which this run reads and replaces"):
        recorded(tmp_path / "out", parse(data))
        data["tissue"]["mesh"]["path"] = str(tmp_path / "out/mesh/organ.msh")
        check_folder(tmp_path / "out", parse(data), overwrite=True)


def test_a_folder_inside_that_is_a_link_is_not_followed(tmp_path: Path) -> None:
    """Independent check: a run is refused whose `frames` lead elsewhere, and a sweep whose `cases` do; the files there
    are kept."""
    recorded(tmp_path / "out")
    elsewhere = (tmp_path / "out" / "frames").rename(tmp_path / "elsewhere")
    kept = sorted(elsewhere.iterdir())
    (tmp_path / "out" / "frames").symlink_to(elsewhere)
    for act in (lambda: check_folder(tmp_path / "out", SCENARIO, overwrite=True), lambda: recorded(tmp_path / "out")):
        with pytest.raises(ScenarioError, match=r"frames in it is a link to another folder; replace the link by"):
            act()
    assert sorted(elsewhere.iterdir()) == kept
    (tmp_path / "sweep").mkdir()
    (tmp_path / "sweep" / "cases").symlink_to(elsewhere)
    with pytest.raises(ScenarioError, match="cases in it is a link"):
        check_sweep_folder(tmp_path / "sweep")


def test_a_manifest_names_what_a_run_writes(tmp_path: Path) -> None:
    """Consistency check: all that is there after a run, but frames, and a manifest that names strange files gives no
    leave to remove them."""
    found = manifest.read(recorded(tmp_path / "out"))
    assert found is not None
    there = {path.name for path in (tmp_path / "out").iterdir() if path.is_file()}
    assert there - set(found["files"]) == set()
    assert set(found["files"]) - there == {"picture.png", CHECKPOINT, LOG}  # none is made by this recorder's steps
    (tmp_path / "precious").write_text("mine", encoding="utf-8")
    text = json.dumps(found | {"files": [*files_of(SCENARIO), "../precious", "mesh/../../precious", 7]})
    (tmp_path / "out" / MARK).write_text(text, encoding="utf-8")
    recorded(tmp_path / "out")
    assert (tmp_path / "precious").exists()


def test_a_run_is_replaced_with_leave_alone(contract: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Independent check: refused in a sentence with both remedies, status 2, nothing touched."""
    out = tmp_path / "out"
    assert run(contract, out) == 0
    before = {path: path.stat().st_mtime_ns for path in out.rglob("*")}
    assert run(contract, out) == command.REFUSED
    message = capsys.readouterr().err
    assert "it already holds a run; add --overwrite to replace it, --resume to continue it" in message
    assert {path: path.stat().st_mtime_ns for path in out.rglob("*")} == before
    assert run(contract, out, "--overwrite") == 0
    assert {path: path.stat().st_mtime_ns for path in out.rglob("*")} != before
    with pytest.raises(SystemExit, match="2"):
        run(contract, out, "--overwrite", "--resume")


# -- one run at a time -----------------------------------------------------------------------------------------------


HOLDING = "import sys; sys.path[:0] = [{root!r}]\nfrom studies.output.lock import locked\nwith locked({folder!r}):\n"
HOLDING += "    print('held', flush=True)\n    sys.stdin.read()\n"


def test_one_run_at_a_time(contract: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Independent check: another process holds the folder; killed, it holds it no more, and leaves no trace behind."""
    out = tmp_path / "out"
    script = HOLDING.format(root=str(Path(__file__).parents[2]), folder=str(out))
    with subprocess.Popen([sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        assert other.stdout is not None and other.stdout.readline() == b"held\n"
        assert run(contract, out) == command.REFUSED
        assert "another run uses it; wait until this run ends" in capsys.readouterr().err
        other.send_signal(signal.SIGKILL)
        other.wait()
    assert (out / LOCK).exists()
    assert run(contract, out) == 0
    assert not (out / LOCK).exists()


def test_a_lock_is_of_the_file_that_is_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: a run ends, and removes its lock, between another's opening of it and its locking."""
    flock, taken = fcntl.flock, []

    def ending(file: int, operation: int) -> None:
        if not taken:
            (tmp_path / LOCK).unlink()
        taken.append(file)
        flock(file, operation)

    monkeypatch.setattr(fcntl, "flock", ending)
    with locked(tmp_path):
        assert len(taken) > 1 and (tmp_path / LOCK).exists()
        with pytest.raises(ScenarioError, match="another run uses it"), locked(tmp_path):
            pass
    with locked(tmp_path):
        pass


# -- no traceback ----------------------------------------------------------------------------------------------------


def circle(path: Path) -> Path:
    path.symlink_to(path)
    return path


@pytest.mark.parametrize("folder", [lambda path: path / ("x" * 300), lambda path: circle(path / "circle")])
@pytest.mark.parametrize("more", [(), ("--resume",), ("--overwrite",)])
def test_a_folder_that_cannot_be_is_refused(
    contract: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    folder: Callable[[Path], Path],
    more: tuple[str, ...],
) -> None:
    """Independent check: a name too long, and a link to itself."""
    assert run(contract, folder(tmp_path), *more) == command.REFUSED
    assert "cannot be written" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["x" * 300, "circle", "."])
def test_a_scenario_that_cannot_be_read_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    """Independent check: a name too long, a link to itself, a folder."""
    circle(tmp_path / "circle")
    assert command.main(["check", str(tmp_path / name)]) == command.REFUSED
    assert "cannot be read" in capsys.readouterr().err


@pytest.mark.parametrize("when", range(3))
def test_a_disk_that_is_full_before_the_first_step(
    contract: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, when: int
) -> None:
    """Independent check: manifest, scenario and first frame cannot be written; status 1, and a run when there is room
    again."""
    out, write, written = tmp_path / "out", Path.write_bytes, [0]

    def full(path: Path, data: bytes) -> int:
        written[0] += 1
        if written[0] > when:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
        return write(path, data)

    monkeypatch.setattr(Path, "write_bytes", full)
    assert run(contract, out) == command.FAILED
    assert "No space left on device" in capsys.readouterr().err
    monkeypatch.setattr(Path, "write_bytes", write)
    assert run(contract, out, "--resume") == 0


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("output.every=1", "output.every = 1 is refused: the frames take about"),
        ("solve.dt=1e-6", "solve.dt = 1e-06 is refused: 1000000 steps take about"),
    ],
)
def test_a_disk_that_would_be_full(
    contract: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
    setting: str, said: str,
) -> None:  # fmt: skip
    """Independent check: what would take most is named; the estimate is within a factor of two of what a run takes."""
    out = tmp_path / "out"
    monkeypatch.setattr(budget.shutil, "disk_usage", lambda folder: SimpleNamespace(free=2e6))
    assert run(contract, out, "--set", setting, "--set", "output.every=500" if "dt" in setting else setting) == 2
    assert said in capsys.readouterr().err
    assert list(out.iterdir()) == []


def test_the_disk_that_a_run_takes(tmp_path: Path) -> None:
    """Independent check: rows and frames of a run with an organ, within a factor of two."""
    organ = "tissue.mesh={kind='block',size=[0.04,0.03,0.02],h=3e-3,accuracy='given'}"
    simulation = prepare(load("two_piercings", [organ, "solve.duration=0.01", "output.every=5"]))
    with Recorder(tmp_path, simulation.tally(), simulation.topology) as recorder:
        for moment in simulation.advance():
            recorder.record(*moment)
    frames = sum(path.stat().st_size for path in (tmp_path / "frames").iterdir())
    rows = sum(path.stat().st_size for path in tmp_path.glob("*.csv"))
    expected = budget.frame_bytes(simulation.scenario, simulation.topology), budget.row_bytes(simulation.scenario)
    assert 0.5 < expected[0] / (frames * 4 / 3) < 2.0  # the last is due, and counted as one that is not
    assert 0.5 < expected[1] / rows < 2.0


MEASURED = """
from studies.output.budget import peak_memory
from studies.scenario import load
from studies.simulation import prepare

simulation = prepare(load("two_piercings", ["solve.kind='static'", "solve.load_steps=2"]))
before = peak_memory()
for _, frame in simulation.advance():
    frame()
print(before, peak_memory())
"""


@pytest.mark.skipif(sys.platform == "win32", reason="the system does not say how much memory a process has had")
def test_the_memory_that_a_run_takes() -> None:
    """Independent check: what a process of its own has had when a shipped scene is prepared is within a factor of two
    of what it has had at the end, and more than an interpreter alone takes."""
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    told = subprocess.run([sys.executable, "-c", MEASURED], capture_output=True, text=True, check=True, env=environment)
    before, after = map(float, told.stdout.split())
    assert 3e7 < before <= after < 2.0 * before


def test_an_interrupt_before_the_first_step(
    contract: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Independent check: while the run is prepared, and while the libraries are loaded."""

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(command, "prepare", interrupted)
    assert run(contract, tmp_path / "out") == 130
    assert list((tmp_path / "out").iterdir()) == []
    monkeypatch.setattr(command, "perform", interrupted)
    monkeypatch.setattr(sys, "argv", ["suture", "catalogue"])
    assert start.main() == 130
    assert capsys.readouterr().err == "suture: interrupted\n" * 2


@pytest.mark.parametrize("words", [["schema", "--table"], ["schema"], ["catalogue"]])
def test_a_closed_pipe_is_no_error(words: list[str]) -> None:
    """Independent check: nobody reads what is printed; nothing is said of it, and the status is that of a shell."""
    reading, writing = os.pipe()
    os.close(reading)
    search = dict(os.environ, PYTHONPATH=str(Path(__file__).parents[2]))
    line = [sys.executable, "-m", "studies.command.start", *words]
    done = subprocess.run(line, stdout=writing, stderr=subprocess.PIPE, env=search, check=False)
    os.close(writing)
    assert (done.stderr, done.returncode) == (b"", 141)


def begun(words: list[str], before: str = "", after: str = "") -> "subprocess.CompletedProcess[bytes]":
    """The command by a shell, with settings before it and redirections after it."""
    search = dict(os.environ, PYTHONPATH=str(Path(__file__).parents[2]))
    line = f'{before} exec "$0" -m studies.command.start "$@" {after}'
    return subprocess.run(["sh", "-c", line, sys.executable, *words], capture_output=True, env=search, check=False)


@pytest.mark.skipif(sys.platform == "win32", reason="has no such shell")
@pytest.mark.parametrize("closed", [">&-", "2>&-", ">&- 2>&-", "<&- >&- 2>&-"])
def test_a_closed_stream_is_no_error(closed: str) -> None:
    """Independent check: what is well is 0 and what is refused 2, with nothing said of the stream."""
    for words, status in ((["catalogue"], 0), (["check", "nowhere.toml"], 2), (["schemas"], 2)):
        done = begun(words, after=closed)
        assert (done.returncode, b"Traceback" in done.stderr) == (status, False)


@pytest.mark.skipif(sys.platform == "win32", reason="has no such shell")
def test_a_terminal_that_is_not_utf_8_gets_escapes() -> None:
    """Independent check: the table of sutures is written, the schema is the same JSON, a path has its letters named."""
    ascii_alone = "PYTHONIOENCODING=ascii"
    done = begun(["catalogue"], ascii_alone)
    assert (done.returncode, done.stderr) == (0, b"") and rb"EI [N m\u00b2]" in done.stdout
    assert json.loads(begun(["schema"], ascii_alone).stdout) == schema()
    assert rb"nowhere-\u00e9.toml does not exist" in begun(["check", "nowhere-é.toml"], ascii_alone).stderr


def test_what_a_run_was_writing_as_it_began_is_gone_with_the_next(tmp_path: Path) -> None:
    """Independent check: killed while it wrote its mark, it begins anew and leaves none of that; another's unfinished
    file is refused."""
    (tmp_path / ".provenance.json.4711").write_text("{")
    check_folder(tmp_path, SCENARIO, resume=True)
    recorded(tmp_path)
    assert [path for path in tmp_path.rglob(".*")] == []
    other = tmp_path / "other"
    other.mkdir()
    (other / ".letter.txt.4711").touch()
    with pytest.raises(ScenarioError, match=r"\.letter\.txt\.4711"):
        check_folder(other, SCENARIO)


# -- torn files ------------------------------------------------------------------------------------------------------


TORN = {
    "results.pvd": "run with --overwrite to start again",
    "scenario.toml": "run with --overwrite to start again",
    MARK: "holds files that no run wrote",
    CHECKPOINT: "run with --overwrite to start again",
    "summary.json": "",
}


def checkpointed(folder: Path) -> Path:
    """A run of seven steps that keeps the step's number alone."""
    with pytest.raises(KeyboardInterrupt), Recorder(folder, Tally(SCENARIO), LINEAR) as recorder:
        for number in range(8):
            kept = {"step": number}
            recorder.record(replace(step(number), kept=lambda kept=kept: kept), framing(step(number).time))
        raise KeyboardInterrupt
    return folder


def resumed(folder: Path) -> None:
    check_folder(folder, SCENARIO, resume=True)
    assert can_resume(folder, SCENARIO)
    assert completed_run(folder, SCENARIO) is None
    with Recorder(folder, Tally(SCENARIO, memory=read_checkpoint(folder)), LINEAR) as recorder:
        recorder.record(step(6), framing(step(6).time))


@pytest.mark.parametrize("name", TORN)
@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
def test_a_torn_file_is_refused_or_made_anew(tmp_path: Path, name: str, share: float) -> None:
    """Independent check: every file that a resumed run reads, cut short."""
    data = (checkpointed(tmp_path) / name).read_bytes()
    (tmp_path / name).write_bytes(data[: int(share * len(data))])
    if not TORN[name]:
        resumed(tmp_path)
        assert json.loads((tmp_path / name).read_text(encoding="utf-8"))["status"] == "completed"
        return
    with pytest.raises(ScenarioError, match=TORN[name]):
        resumed(tmp_path)


def test_a_checkpoint_with_a_flipped_bit_is_refused(tmp_path: Path) -> None:
    """Independent check: wherever a bit is flipped, and as it was written numpy reads it."""
    write_checkpoint(tmp_path, {"step": 7, "q": [1.0, 2.0]})
    data = (tmp_path / CHECKPOINT).read_bytes()
    assert read_checkpoint(tmp_path) is not None
    for place in range(len(data)):
        flipped = bytearray(data)
        flipped[place] ^= 1 << place % 8
        (tmp_path / CHECKPOINT).write_bytes(flipped)
        with pytest.raises(ScenarioError, match="is damaged: its checksum differs"):
            read_checkpoint(tmp_path)


def test_a_frame_that_is_lost_is_left_out_and_said(tmp_path: Path) -> None:
    """Independent check: one before the checkpoint is gone from the folder; the run goes on, without it in the index
    and with a remark that names it. Where the index itself lacks a frame, it is refused."""
    (checkpointed(tmp_path) / "frames" / "thread_000003.vtp").unlink()
    resumed(tmp_path)
    said = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))["remarks"]
    assert any(one["code"] == "frames-missing" and "thread_000003.vtp" in one["message"] for one in said)
    index = checkpointed(tmp_path / "other") / "results.pvd"
    assert "thread_000003.vtp" not in (tmp_path / "results.pvd").read_text(encoding="utf-8")
    index.write_text("\n".join(x for x in index.read_text(encoding="utf-8").splitlines() if "_000003" not in x))
    with pytest.raises(ScenarioError, match=r"lacks the frame of step 3"):
        resumed(tmp_path / "other")
