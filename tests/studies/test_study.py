"""The room that the studies share: names, arguments, tables, files and the command."""

import csv
import json
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure

from coupling.errors import StepError
from studies import study
from studies.command import command
from studies.figure import panels
from studies.output.lock import locked
from studies.scenario import ScenarioError
from studies.study import (
    NAMES,
    WRITTEN,
    Study,
    StudyError,
    Table,
    arguments,
    carry_out,
    check_folder,
    each,
    measure,
    measured,
    unit_field,
)
from studies.verdicts import bearing_strain, beyond_bearing, beyond_linear, not_settled, too_coarse, unrest
from studies.workers import workers_of


@dataclass(frozen=True)
class Row:
    way: str
    length: float = unit_field("m")


@dataclass(frozen=True, kw_only=True)
class Measured:
    way: str
    length: float = measured("m", lambda at: at.length)
    places: tuple[int, ...] = measured("", lambda at: at.places)


def main(lengths: tuple[float, ...] = (1.0, 2.0), count: int = 3) -> Iterator[Row]:
    for length in lengths:
        if length < 0.0:
            raise StepError(0.1, 1e-3, "no length is negative", "entry")
        yield Row(f"way {count}", length)


def figure(rows: list[Row]) -> Figure:
    drawing, grid = panels(1, 1)
    grid[0, 0].plot([row.length for row in rows])
    grid[0, 0].set(xlabel="length [m]")
    return drawing


SAMPLE = Study(
    main=main,
    question="How long is it?",
    independent="none",
    consistency="with itself",
    table=lambda rows: Table(("way", "length [mm]"), [[row.way, f"{1e3 * row.length:g}"] for row in rows]),
    figure=figure,
    remarks=lambda rows: ["not converged"],
    quick={"lengths": (0.5,)},
)


@pytest.fixture
def sample(monkeypatch: pytest.MonkeyPatch) -> None:
    """The sample is the only study."""
    for module in (study, command):
        monkeypatch.setattr(module, "NAMES", ("sample",))
    monkeypatch.setattr(study, "import_module", lambda name: SAMPLE)
    monkeypatch.setattr(study, "study_list", lambda name: vars(SAMPLE))


@pytest.mark.parametrize("name", NAMES)
def test_every_scene_can_be_run(name: str) -> None:
    """Independent check: the scene of a study is a whole scenario, and one with an unknown key is refused."""
    if (Path(study.__file__).parent / name / "scene.toml").exists():
        assert study.scene(name, {"title": "another"}).title == "another"
        with pytest.raises(ScenarioError, match="there is no such key"):
            study.scene(name, {"tissue.colour": "red"})


def test_what_is_measured_is_declared_once() -> None:
    """Independent check: a field is measured on the end of a run, in Python's own numbers, and has its unit."""
    found = measure(Measured, SimpleNamespace(length=np.float64(2.0), places=np.arange(2)), way="new")
    assert (found.way, found.length, found.places) == ("new", 2.0, (0, 1)) and type(found.length) is float
    assert study.numbers([found]).splitlines() == ["way,length [m],places", 'new,2.0,"(0, 1)"']


def job(length: float) -> Row:
    """A row of a job, or an error of the coupling."""
    if length < 0.0:
        raise StepError(0.1, 1e-3, "no length is negative", "entry")
    time.sleep(0.5 if length == 1.0 else 0.0)  # the error is met while this one is done
    return Row("job", length)


def jobs(lengths: tuple[float, ...] = (1.0, 2.0, 3.0)) -> Iterator[Row]:
    yield from each([*(partial(job, length) for length in lengths), partial(list, [Row("last", 0.0)])])


def test_jobs_give_the_rows_of_one_process(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Consistency check: two processes give the same rows in the same order, and an error of the coupling comes across
    as what it is."""
    spread = replace(SAMPLE, main=jobs)
    monkeypatch.setattr(study, "import_module", lambda name: spread)
    monkeypatch.setattr(study, "study_list", lambda name: vars(spread))
    monkeypatch.setattr(study, "NAMES", ("sample",))
    told: list[list[Row]] = [[], []]
    for number, workers in enumerate((None, workers_of(2))):
        with pytest.raises(StepError, match="no length is negative"):
            study.carry_out("sample", "full", {"lengths": (1.0, 2.0, -1.0)}, tmp_path, told[number].extend, workers)
    assert told[0] == told[1]
    assert told[0][-1].length == 2.0
    assert [row.length for row in jobs()] == [1.0, 2.0, 3.0, 0.0]


def test_presets_and_settings() -> None:
    """Full is the defaults of main; a setting is converted to the argument's type, whole numbers to floats too."""
    assert arguments(SAMPLE, "full") == {}
    assert arguments(SAMPLE, "quick") == {"lengths": (0.5,)}
    assert arguments(SAMPLE, "quick", ["lengths=[1, 3]", "count=4"]) == {"lengths": (1.0, 3.0), "count": 4}


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("length=[1]", "the nearest is lengths"),
        ("lengths", "write NAME=VALUE with a name of lengths, count"),
        ("count=many", "count=many is refused"),
        ("lengths=[]", "the list is empty"),
        ("lengths=[1, nan]", "it must be a finite number, and not nan"),
        ("lengths=[1, ]]", "lengths=[1, ]] is refused"),
    ],
)
def test_a_wrong_setting_is_refused(setting: str, words: str) -> None:
    with pytest.raises(StudyError) as caught:
        arguments(SAMPLE, "full", [setting])
    assert words in str(caught.value)


@pytest.mark.parametrize("name", NAMES)
def test_every_study_says_what_it_is(name: str) -> None:
    """Its presets name arguments of its main, and it asks a question and says what it checks."""
    found = study.study(name)
    assert found.question.endswith("?") and found.independent and found.consistency
    kinds = study.get_type_hints(found.main)
    assert set(found.quick) <= set(kinds)
    assert all(study.TypeAdapter(kinds[key]).validate_python(value) for key, value in found.quick.items())


def test_a_study_into_a_folder(sample: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Table, numbers with units in the header, a picture in two formats, and what was asked; twice the same bytes."""
    out = tmp_path / "out"
    pictures = []
    for _ in range(2):
        assert command.main(["study", "sample", "--set", "count=7", "--overwrite", "--out", str(out)]) == 0
        pictures.append([(out / f"figure.{kind}").read_bytes() for kind in ("png", "svg")])
    assert pictures[0] == pictures[1]
    assert pictures[0][0].startswith(b"\x89PNG") and b"length [m]" in pictures[0][1]
    printed = capsys.readouterr().out
    assert "How long is it?" in printed and "independent  none" in printed and "* not converged" in printed
    with (out / "runs.csv").open() as file:
        assert list(csv.DictReader(file)) == [{"way": "way 7", "length [m]": "0.5"}]
    with (out / "table.csv").open() as file:
        assert list(csv.reader(file)) == [["way", "length [mm]"], ["way 7", "500"]]
    asked = json.loads((out / "study.json").read_text())
    assert (asked["preset"], asked["arguments"]) == ("quick", {"lengths": [0.5], "count": 7})
    assert asked["remarks"] == ["not converged"] and "python" in asked["provenance"]


def test_the_list_and_a_name_that_is_none(sample: None, capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(["study", "list"]) == 0
    assert capsys.readouterr().out.split() == ["sample", *SAMPLE.question.split()]
    assert command.main(["study", "samples"]) == 2
    assert "the nearest is sample" in capsys.readouterr().err


def test_a_folder_of_somebody_else_is_refused(sample: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "letter.txt").write_text("dear")
    assert command.main(["study", "sample", "--out", str(tmp_path)]) == 2
    assert "files that no study wrote (letter.txt)" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["letter.txt"]
    with pytest.raises(ScenarioError, match="it is a file"):
        carry_out("sample", "quick", {}, tmp_path / "letter.txt", lambda rows: None)
    (tmp_path / "letter.txt").unlink()
    for name, text in (("table.csv", "mine"), ("study.json", '{"study": "mine"}')):
        (tmp_path / name).write_text(text)
        with pytest.raises(ScenarioError, match=r"files that no study wrote \(study\.json\)|\(table\.csv\)"):
            check_folder(tmp_path, overwrite=True)


def test_a_study_has_its_folder_alone_and_knows_what_it_was_writing(sample: None, tmp_path: Path) -> None:
    """Independent check: refused while another is at work there; what a killed one left unfinished goes."""
    with locked(tmp_path / "out"), pytest.raises(ScenarioError, match="another run uses it"):
        carry_out("sample", "quick", {}, tmp_path / "out", lambda rows: None)
    for name in (".study.json.4711", ".runs.csv.4711", ".suture.lock"):
        (tmp_path / "out" / name).write_text("{")
    assert command.main(["study", "sample", "--out", str(tmp_path / "out")]) == 0
    assert {path.name for path in (tmp_path / "out").iterdir()} == set(WRITTEN)


def test_marks() -> None:
    """Independent check: on either side of the limits."""
    assert [*beyond_linear("run", 0.29e-3, 1e-3), *too_coarse("run", 1e-3, 1e-3), *not_settled("run", 1e-4)] == []
    assert "moved by 0.31 footprints, BEYOND" in next(beyond_linear("run", 0.31e-3, 1e-3))
    assert "cells of 1.1 footprint radii, TOO COARSE" in next(too_coarse("run", 1.1e-3, 1e-3))
    assert "2 of the elastic" in next(not_settled("run", 2.0)) and unrest(0.0, 0.0) == 0.0
    assert "inf of the elastic" in next(not_settled("run", unrest(1e-9, 0.0)))
    assert list(beyond_bearing("run", bearing_strain(1.0, 0.3e-3, 5e-3, 3e6))) == []
    assert "T/(d ℓ E) is 0.67, BEYOND" in next(beyond_bearing("run", bearing_strain(1.0, 0.3e-3, 5e-3, 1e6)))


def test_a_study_that_fails_keeps_its_rows(sample: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """And nothing of an earlier one is left beside them; a study that is refused leaves the earlier one alone."""
    assert command.main(["study", "sample", "--out", str(tmp_path)]) == 0
    assert {path.name for path in tmp_path.iterdir()} == set(WRITTEN)
    again = ["--overwrite", "--out", str(tmp_path)]
    assert command.main(["study", "sample", "--out", str(tmp_path)]) == 2
    assert "it already holds a study; add --overwrite" in capsys.readouterr().err
    assert command.main(["study", "sample", "--set", "lengths=[-1]", *again]) == 1
    assert {path.name for path in tmp_path.iterdir()} == set(WRITTEN)
    assert "the completed rows" not in capsys.readouterr().err
    assert command.main(["study", "sample", "--set", "lengths=[1, 2, -1]", *again]) == 1
    assert {path.name for path in tmp_path.iterdir()} == {"runs.csv", "study.json"}
    check_folder(tmp_path, overwrite=True)
    assert (tmp_path / "runs.csv").read_text() == "way,length [m]\nway 3,1.0\nway 3,2.0\n"
    told = capsys.readouterr().err
    assert "row 1, " in told and "way 3" in told and "row 2, " not in told  # of the same words
    assert "no length is negative" in told and "the completed rows" in told
