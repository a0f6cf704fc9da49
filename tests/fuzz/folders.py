"""Mutated folders of finished runs: each is shown, opened or resumed, or refused in words."""

import json
import shutil
import tomllib
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from random import Random
from unittest.mock import patch

from studies.command.command import ALL_REFUSALS, main
from studies.output.checkpoint import read_checkpoint
from studies.output.folder import Recorder, can_resume, check_folder
from studies.output.reading import open_run
from studies.output.tally import Tally as RunTally
from studies.pictures import looking
from studies.scenario import Scenario, parse
from tests.fuzz.mutations import mutated_bytes, mutated_tables
from tests.fuzz.scenarios import text_of
from tests.fuzz.trial import Tally
from tests.studies.samples import LINEAR, framing, step
from tests.studies.test_report import record_run

COLUMNS = ("piercings.entry.slip", "piercings.exit.force", "energy.kinetic")


def run(count: int, seed: int, folder: Path) -> Tally:
    """Try so many mutated folders."""
    tally, whole = Tally(), record_run(folder / "whole")
    acts = (_report, _plot, _view, _open, _resume)
    with patch.object(looking, "draw_scene", _drawn):
        for number in range(seed, seed + count):
            random, there = Random(number), folder / "mutated"
            shutil.rmtree(there, ignore_errors=True)
            shutil.copytree(whole, there)
            name = _mutate(there, random)
            act, refusals = random.choice(acts), (*ALL_REFUSALS, OSError)
            label = f"folder {number} ({act.__name__[1:]}, {name})"
            tally.trial(label, lambda act=act, there=there: act(there), refusals)
    return tally


def _drawn(*_: object, **__: object) -> tuple[str, str]:
    """Say that a picture was drawn: that is tried elsewhere."""
    return "picture", ""


def _mutate(folder: Path, random: Random) -> str:
    """Change, empty, remove, or make a folder of one of the files; return its name."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    kinds = sorted({path.suffix for path in files})
    kind = random.choice(kinds)
    path = random.choice([path for path in files if path.suffix == kind])
    name, change = str(path.relative_to(folder)), random.random()
    if change < 0.1:
        path.unlink()
    elif change < 0.15:
        path.write_bytes(b"")
    elif change < 0.2:
        path.unlink()
        path.mkdir()
    elif change < 0.6 and kind == ".json":
        path.write_text(json.dumps(mutated_tables(json.loads(path.read_bytes()), random)), encoding="utf-8")
    elif change < 0.6 and kind == ".toml":
        data = mutated_tables(tomllib.loads(path.read_text(encoding="utf-8")), random)
        path.write_text(text_of(data), encoding="utf-8")
    else:
        path.write_bytes(mutated_bytes(path.read_bytes(), random))
    return name


def _command(*words: object) -> str:
    """Return what became of a command; what it says on standard error is its refusal."""
    said = StringIO()
    with redirect_stdout(StringIO()), redirect_stderr(said):
        status = main([str(word) for word in words])
    assert status == 0 or "suture: " in said.getvalue(), f"status {status} without words"
    return "shown" if status == 0 else "refused"


def _report(folder: Path) -> str:
    return _command("report", folder, "--out", folder.with_name("page.html"))


def _plot(folder: Path) -> str:
    return _command("plot", folder, *COLUMNS, "--out", folder.with_name("plot.svg"))


def _view(folder: Path) -> str:
    return _command("view", folder, "--out", folder.with_name("view.gif"))


def _open(folder: Path) -> str:
    opened = open_run(folder)
    reads: list[Callable[[], object]] = [lambda: opened.scenario, lambda: opened.quantities, lambda: opened.remarks]
    for read in [*reads, *(lambda name=name: opened.table(name) for name in opened.tables)]:
        read()
    for number in range(len(opened.times)):
        opened.frame(number)
    return repr(opened) and "opened"


def _resume(folder: Path) -> str:
    scenario = _scenario_of(folder.with_name("whole"))
    check_folder(folder, scenario, resume=True)
    if not can_resume(folder, scenario):
        return "begun anew"
    kept = read_checkpoint(folder)
    with Recorder(folder, RunTally(scenario, memory=kept), LINEAR) as recorder:
        for number in range(0 if kept is None else int(kept["step"]), 4):
            recorder.record(step(number), framing(step(number).time))
    return "resumed"


def _scenario_of(folder: Path) -> Scenario:
    return parse(tomllib.loads((folder / "scenario.toml").read_text(encoding="utf-8")))
