"""The benchmark: every solver that is there has a row; no time is asserted."""

import json
from pathlib import Path

import pytest

from studies.bench import finite, many, step
from studies.command import command
from studies.command.parser import read
from studies.command.sweeps import cases_of
from studies.scenario import load, parse
from studies.scenario.toml import changed
from studies.scenario.toml import read as tables_of
from studies.simulation import prepare
from tests.bounds import IDENTITY
from tissue.solvers.choice import MULTIGRID
from tissue.solvers.direct import LIBRARIES, is_installed


def test_bench_organ(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "bench.json"
    assert command.main(["bench", "organ", "--sizes", "1000", "--json", str(path)]) == 0
    head, rule, *rows = [line for line in capsys.readouterr().out.splitlines() if line.startswith("|")]
    there = [*(name for name in LIBRARIES if is_installed(name)), MULTIGRID]
    assert [row.split("|")[3].strip() for row in rows] == there
    assert {line.count("|") for line in (head, rule, *rows)} == {12}
    written = json.loads(path.read_text())
    assert [row["solver"] for row in written["rows"]] == there
    assert written["bandwidth"] > 0.0
    for row in written["rows"]:
        assert (row["iterations"] is None) == (row["left"] is None) == (row["solver"] != MULTIGRID)
        assert row["left"] is None or row["left"] <= IDENTITY


def test_bench_step(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: whole runs of a scene as long as they are within the most, its iterations as a run has them,
    times in their order, and a floor of an organ alone; the same in print and JSON."""
    path, short = tmp_path / "bench.json", "solve.duration=0.006"
    coarse = ["tissue.inertia=false", "tissue.mesh.h=8e-3", "tissue.mesh.accuracy=given", "tissue.mesh.h_site=4e-3"]
    cases = {"thread": ("paper_figure_1", [short]), "organ": ("two_piercings", [short, *coarse])}
    monkeypatch.setattr(step, "CASES", cases)
    monkeypatch.setattr(step, "MOST", 15)
    assert command.main(["bench", "step", "--json", str(path)]) == 0
    rows = json.loads(path.read_text())["milliseconds_per_step"]
    printed = capsys.readouterr().out.splitlines()[2:]
    assert [line.split()[1] for line in printed] == [row["case"] for row in rows] == list(cases)
    assert [row["steps"] for row in rows] == [12, 12] and [row["floor"] is None for row in rows] == [True, False]
    for row, (scene, overrides) in zip(rows, cases.values(), strict=True):
        assert 0.0 < row["median"] <= row["late"] <= row["worst"] and min(row["at_once"], row["recorded"]) > 0.0
        records = [record for record, _ in prepare(load(scene, overrides)).advance()]
        assert row["newton_iterations"] == sum(record.newton_iterations for record in records) / 6


def test_bench_many(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: in print and in JSON, where other numbers stay; the ratio of two tensions by the time of one
    run, of commands that can be read."""
    path = tmp_path / "bench.json"
    path.write_text('{"milliseconds_per_step": []}')
    asked: list[list[str]] = []
    monkeypatch.setattr(many, "time_command", lambda verb, *words, kept="": asked.append([verb, *words]) or 100.0)
    monkeypatch.setattr(many, "measure_folder", lambda: 12.0)
    assert many.main(path, 2) == 0
    written = json.loads(path.read_text())
    assert [row["times_as_cheap"] for row in written["tensions"]] == [2.0, 2.0, 2.0]
    short = ["run", "--no-picture", "--set=solve.duration=2e-3"]
    others = ["run", many.NUMPY], ["run", many.WHOLE]
    assert asked[:7] == [short, short, short, ["run"], ["run", "--no-picture"], *others]
    job = written["main_job_seconds"]
    assert (job["to its picture"], job["without one"], job["in numpy"]) == (100.0, 100.0, 100.0)
    assert 0.0 < job["for --help"] < 100.0 and job["to compile the loops"] == 0.0
    assert written["main_job_megabytes"] == 12.0
    options = [read([verb, str(many.COUPLED), "--out", "out", *words]) for verb, *words in asked[7:]]
    sweeps = [cases_of(each) for each in options[::3]]
    assert [[len(cases), len(cases[0])] for cases in sweeps] == [[2, 1], [2, 2], [2, 2]]
    for cases, each, run in zip(sweeps, options[::3], options[1::3], strict=True):
        last = parse(changed(tables_of(each.file, each.set), cases[-1]))
        assert last == parse(tables_of(run.file, run.set)) and last.solve.kind == "static"
    assert written["milliseconds_per_step"] == [] and written["provenance"]
    assert "speed-up" in capsys.readouterr().out


def test_bench_finite(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: a row of the pull and one of the step, in print and JSON, beside what is in the file."""
    path = tmp_path / "bench.json"
    path.write_text('{"tensions": []}')
    monkeypatch.setattr(finite, "LOAD_STEPS", 1)
    monkeypatch.setattr(finite, "WARM_UP", 1)
    monkeypatch.setattr(finite, "STEPS", 2)
    assert finite.main(path, "superlu", {"coarse": (8e-3, 4e-3)}, (8e-3, 4e-3)) == 0
    written = json.loads(path.read_text())
    (pull,), step = written["finite_at_rest"], written["finite_in_time"]
    assert pull["solver"] == "superlu" and pull["tissue_unknowns"] > 0.0 < pull["pull"]
    assert step["times_as_long"] == step["step"] / step["linear"] > 0.0
    assert written["tensions"] == [] and written["provenance"]
    assert "times as long" in capsys.readouterr().out
