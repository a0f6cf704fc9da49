"""The command line: exit status, sentences instead of tracebacks, and what a run prints."""

import io
import json
import os
import signal
import subprocess
import sys
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import pytest

from coupling.calls import ask_before_correction
from coupling.errors import CouplingError
from coupling.run import run
from coupling.step import tables
from meshes.errors import MeshError
from studies.command import command, help
from studies.command.lines import print_lines
from studies.command.parser import TABLE
from studies.command.progress import Progress, duration
from studies.output.budget import size_text
from studies.output.provenance import ROOT
from studies.output.remarks import Remark
from studies.scenario import Scenario, load
from tests.studies.samples import CONTRACT, Stub
from tissue.organs import krylov

Prepare = Callable[..., None]


@pytest.fixture
def contract(tmp_path: Path) -> str:
    path = tmp_path / "contract.toml"
    path.write_text(CONTRACT, encoding="utf-8")
    return str(path)


@pytest.fixture
def stub(monkeypatch: pytest.MonkeyPatch) -> Prepare:
    """Runs are made by a stub; call it to make them fail."""

    def prepare(fail: Exception | Callable[[], None] | None = None, topology: object = None) -> None:
        def prepared(scenario: Scenario, store: object = None) -> Stub:
            return replace(Stub(scenario, fail), topology=topology)  # type: ignore[arg-type]

        monkeypatch.setattr(command, "prepare", prepared)

    prepare()
    return prepare


def test_a_run(contract: str, stub: Prepare, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert command.main(["run", contract, "--out", str(out), "--set", "output.every=2"]) == 0
    printed = capsys.readouterr()
    for word in (
        "two piercings",
        "completed",
        "entry",
        "slip [mm]",
        "energy [J]",
        "results.pvd",
        "picture.png",
    ):
        assert word in printed.out
    assert "100 %  step 7/7" in printed.err
    assert json.loads((out / "summary.json").read_text())["status"] == "completed"
    assert (out / "picture.png").stat().st_size > 10_000
    assert command.main(["check", str(out / "scenario.toml")]) == 0
    assert "2 piercings, 40 control points, 12 tissue unknowns, 7 steps" in capsys.readouterr().out


def test_a_shipped_scene_is_checked_and_run_by_its_name(
    stub: Prepare, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert command.main(["check", "two_piercings"]) == 0
    for _ in range(2):  # the second time a folder of that name is there
        assert command.main(["run", "two_piercings", "--out", "two_piercings", "--no-picture", "--overwrite"]) == 0
    assert load("two_piercings/scenario.toml").title == load("two_piercings").title
    assert command.main(["mesh", "two_percings", "--out", "organ.vtu"]) == 2
    assert "two_piercings" in capsys.readouterr().err


def test_a_quiet_run_prints_nothing(
    contract: str, stub: Prepare, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["run", contract, "--out", str(tmp_path / "out"), "--quiet", "--no-picture"]
    assert command.main(arguments) == 0
    assert capsys.readouterr() == ("", "")
    assert not (tmp_path / "out" / "picture.png").exists()


def test_a_quiet_run_says_which_numbers_are_not_supported(
    contract: str, stub: Prepare, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Independent check: remarks of severity "unsupported" are one line on standard error, in a quiet run and in one
    that was completed before; notes are none."""
    found = [Remark("after-end", "note", "late", "cut.0.time")]
    found.append(Remark("thread-strength", "unsupported", "it would break", "thread"))
    found.append(Remark("hole-strain", "unsupported", "drawn far", "exit"))
    monkeypatch.setattr(Stub, "remarks", lambda self, ending=None: found)
    arguments = ["run", contract, "--out", str(tmp_path / "out"), "--quiet", "--no-picture"]
    for more in ([], ["--resume"]):
        assert command.main([*arguments, *more]) == 0
        printed = capsys.readouterr()
        assert printed.out == ""
        assert printed.err.count("\n") == 1
        assert printed.err.startswith("suture: unsupported: thread (thread-strength), exit (hole-strain); ")
        assert "after-end" not in printed.err


def test_bad_input_is_refused_before_anything_is_written(
    contract: str, stub: Prepare, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    faults = ["--set", "solve.dt=0", "--set", "tissue.density=-1"]
    assert command.main(["run", contract, "--out", str(out), *faults]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 2
    assert lines[0].startswith("suture: tissue.density = -1 is refused")
    assert not out.exists()


@pytest.mark.parametrize("verb", ["run", "check"])
def test_what_the_preparation_refuses_is_refused(
    contract: str,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    verb: str,
) -> None:
    def prepare(scenario: Scenario) -> Stub:
        raise MeshError("the mesh is inside out; turn it")

    monkeypatch.setattr(command, "prepare", prepare)
    out = ["--out", str(tmp_path / "out")] if verb == "run" else []
    assert command.main([verb, contract, *out]) == 2
    assert capsys.readouterr().err == "suture: the mesh is inside out; turn it\n"


def test_a_folder_of_somebody_else_is_refused(
    contract: str, stub: Prepare, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command.main(["run", contract, "--out", str(tmp_path)]) == 2
    assert "holds files that no run wrote" in capsys.readouterr().err


def test_a_run_that_fails(contract: str, stub: Prepare, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stub(CouplingError("no convergence at piercing 'exit'"))
    out = tmp_path / "out"
    assert command.main(["run", contract, "--out", str(out), "--no-picture"]) == 1
    printed = capsys.readouterr()
    assert "the run failed in step 4, after t = 0.3 s: no convergence at piercing 'exit'" in printed.err
    assert "Traceback" not in printed.err
    assert "failed at t = 0.3" in printed.out
    summary = json.loads((out / "summary.json").read_text())
    assert (summary["status"], summary["steps"]) == ("failed", 3)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_run_that_is_interrupted(
    contract: str, stub: Prepare, tmp_path: Path, capsys: pytest.CaptureFixture[str], number: int
) -> None:
    before = signal.getsignal(number)
    stub(lambda: os.kill(os.getpid(), number))
    out = tmp_path / "out"
    assert command.main(["run", contract, "--out", str(out), "--no-picture"]) == 128 + number
    assert "interrupted" in capsys.readouterr().err
    summary = json.loads((out / "summary.json").read_text())
    assert (summary["status"], summary["steps"]) == ("interrupted", 4)  # the step is finished first
    assert signal.getsignal(number) is before


def test_a_signal_within_a_long_step_ends_it_between_two_corrections(
    contract: str, stub: Prepare, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Independent check: a step that would correct for ever stops where the signal comes, at what was recorded."""

    def corrects_for_ever() -> None:
        for number in range(1000):
            if number == 2:
                os.kill(os.getpid(), signal.SIGTERM)
            ask_before_correction()
        pytest.fail("the signal was not heeded")

    stub(corrects_for_ever)
    out = tmp_path / "out"
    assert command.main(["run", contract, "--out", str(out), "--no-picture"]) == 128 + signal.SIGTERM
    assert "interrupted" in capsys.readouterr().err
    assert json.loads((out / "summary.json").read_text())["status"] == "interrupted"
    ask_before_correction()


@pytest.mark.parametrize("module", [run, tables, krylov])
def test_what_a_step_waits_for_is_said(
    module: ModuleType, contract: str, stub: Prepare, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Independent check: that a rest is sought, that loops are compiled, of a step or of steps at once, and that an
    organ goes on whole, is a line of the console, unless it is to be quiet."""
    stub(lambda: module.log.info("compiling the step"))
    asked = ["run", contract, "--no-picture", "--out"]
    assert command.main([*asked, str(tmp_path / "told")]) == 0
    assert "compiling the step" in capsys.readouterr().err
    assert command.main([*asked, str(tmp_path / "quiet"), "--quiet"]) == 0
    assert capsys.readouterr().err == ""


def test_a_defect_of_the_code_is_not_hidden(contract: str, stub: Prepare, tmp_path: Path) -> None:
    stub(ZeroDivisionError("a bug"))
    with pytest.raises(ZeroDivisionError):
        command.main(["run", contract, "--out", str(tmp_path / "out"), "--quiet"])
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["status"] == "failed"


def test_what_is_printed_as_json(
    contract: str, stub: Prepare, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Consistency check: a run prints its summary, a check its counts and remarks, the scenes their titles, and nothing
    else. The log in the folder has the beginning and the end."""
    out = tmp_path / "out"
    assert command.main(["run", contract, "--out", str(out), "--no-picture", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads((out / "summary.json").read_text())
    log = (out / "suture.log").read_text(encoding="utf-8").splitlines()
    assert f"suture run {contract}" in log[0]
    assert log[1].endswith("  completed")
    assert command.main(["check", contract, "--json", "--picture", str(tmp_path / "start.png")]) == 0
    checked = json.loads(capsys.readouterr().out)
    assert (checked["steps"], checked["piercings"], checked["tissue_dofs"]) == (7, 2, 12)
    assert checked["bytes"] > 0 and checked["memory"] > 0
    assert "picture" in checked["picture"] or "section" in checked["picture"]
    assert (tmp_path / "start.png").stat().st_size > 10_000
    assert command.main(["scenes", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)["two_piercings"]
    assert listed["title"] == load("two_piercings").title and listed["cost"].endswith(" GB")


def test_a_new_scenario_can_be_run(
    stub: Prepare, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Independent check: it is valid as it is written, and one that is there is not written over."""
    monkeypatch.chdir(tmp_path)
    assert command.main(["new", "mine"]) == 0
    assert command.main(["check", "mine.toml"]) == 0
    assert "suture run mine.toml --out" in capsys.readouterr().out
    assert command.main(["new", "neu ü.toml"]) == 0
    assert "suture run 'neu ü.toml' --out 'results/neu ü'" in capsys.readouterr().out
    assert command.main(["new", "wound", "--stitches"]) == 0
    assert command.main(["check", "wound.toml"]) == 0
    assert command.main(["new", "mine.toml"]) == 2
    assert "it already exists" in capsys.readouterr().err


def test_help_and_version_load_no_library(capsys: pytest.CaptureFixture[str]) -> None:
    """Independent check: a process of its own has imported neither numpy nor pydantic by then."""
    code = (
        "import sys\nfrom studies.command.start import main\nsys.argv = ['suture', '{}']\n"
        "try:\n    main()\nexcept SystemExit as end:\n    assert not end.code\n"
        "assert not {{'numpy', 'pydantic', 'scipy'}} & set(sys.modules)"
    )
    for word in ("--help", "--version"):
        done = subprocess.run([sys.executable, "-c", code.format(word)], capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (0, "")
        assert "suture" in done.stdout


def test_the_doctor_and_the_completion(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Independent check: what is missing has its remedy, every extra is asked for; each shell is
    told every command and its options."""
    of_extras = [check for check in help.CHECKS if check.__name__ == "find"]
    monkeypatch.setattr(help, "CHECKS", (help.find_code, help.finder("Dask", "distributed", "clusters")))
    monkeypatch.setattr(help, "installed_version", lambda library: None if library == "distributed" else "1")
    assert command.main(["doctor"]) == 0
    assert "needed for clusters; pip install 'suturefem[cluster]'" in capsys.readouterr().out
    assert command.main(["doctor", "--json"]) == 0
    assert [finding["there"] for finding in json.loads(capsys.readouterr().out)] == [True, False]
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    remedies = {check()["remedy"] for check in of_extras}
    assert remedies == {
        f"pip install 'suturefem[{name}]'" for name in set(project["optional-dependencies"]) - {"test", "all", "mesh"}
    }
    for shell in ("bash", "zsh", "fish"):
        assert command.main(["completion", shell]) == 0
        said = capsys.readouterr().out
        assert all(name in said for name in TABLE)
        assert "--over" in said
        assert "two_piercings" in said


def test_lines_on_a_terminal_are_no_longer_than_it_is_wide(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Consistency: 80 columns of a terminal break lines under their first word, and into a file they stay whole."""
    remark = "remarks    " + "note: the thread lies deep " * 5
    whole = [remark.rstrip(), "word " * 20 + "x" * 90, "short"]
    print_lines(whole)
    assert capsys.readouterr().out.splitlines() == whole
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    print_lines(whole)
    printed = capsys.readouterr().out.splitlines()
    assert [line for line in printed if len(line) > 80] == ["x" * 90]
    assert printed[1][:11].isspace()
    assert printed[1][11] != " "
    assert " ".join(" ".join(printed).split()) == " ".join(" ".join(whole).split())


def test_schema_and_catalogue(capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(["schema"]) == 0
    assert json.loads(capsys.readouterr().out)["title"] == "Scenario"
    assert command.main(["catalogue"]) == 0
    assert "2-0 polypropylene" in capsys.readouterr().out


def test_wrong_use_exits_with_2(capsys: pytest.CaptureFixture[str]) -> None:
    for arguments in ([], ["fly"], ["run", "a.toml"]):
        with pytest.raises(SystemExit, match="2"):
            command.main(arguments)
    assert "Traceback" not in capsys.readouterr().err


def test_a_misspelt_command_is_refused_with_the_nearest(capsys: pytest.CaptureFixture[str]) -> None:
    for asked, near in (("chek", "the nearest is check"), ("sweeep", "the nearest is sweep")):
        with pytest.raises(SystemExit, match="2"):
            command.main([asked, "a.toml"])
        assert f"{asked} is refused: there is no such command; {near}" in capsys.readouterr().err
    with pytest.raises(SystemExit, match="2"):
        command.main(["zzz"])
    refused = capsys.readouterr().err
    assert "nearest" not in refused and "refine" in refused


def test_progress_elsewhere_than_on_a_terminal_is_ten_lines() -> None:
    stream = io.StringIO()
    progress = Progress(1000, stream=stream)
    for number in range(1001):
        progress.update(number, number * 1e-3, 4, 1e-6)
    progress.close()
    lines = stream.getvalue().splitlines()
    assert [int(line.split()[0]) for line in lines] == list(range(10, 101, 10))
    assert all("left" in line for line in lines[:-1])
    assert "in all" in lines[-1]


def test_progress_on_a_terminal_redraws_one_line() -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    stream = Terminal()
    progress = Progress(3, stream=stream)
    for number in range(4):
        progress.update(number, float(number), 4, 1e-6)
    progress.close()
    assert stream.getvalue().count("\n") == 1
    assert "[##############################] step 3/3" in stream.getvalue()


def test_durations() -> None:
    assert [duration(value) for value in (3.4, 61, 7322)] == ["3 s", "1 min 01 s", "2 h 02 min"]


def test_sizes() -> None:
    told = [size_text(size) for size in (340.0, 92e3, 0.95e6, 16.6e6, 1.26e9, 123e9)]
    assert told == ["0.34 kB", "92 kB", "950 kB", "17 MB", "1.3 GB", "123 GB"]
