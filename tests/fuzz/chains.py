"""Chains of kills: a run, or a sweep, is killed again and again at seeded moments and goes on to the bytes of one."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from random import Random
from typing import Any

from studies.command import command
from tests.fuzz.scenarios import SMALL
from tests.fuzz.trial import Tally

ROOT = Path(__file__).parents[2]
LONGEST = 4  # kills in a chain
PATIENCE = 3600  # s for a chain: five starts of an interpreter, on a machine that does other things
# The process ends at the n-th event: a file before or after it is renamed, a table in the middle of a row.
DYING = """
import os, signal, sys
sys.path[:0] = [{root!r}]
from studies.command import command
from studies.output import files, tables

left = [{moment}]
replace, write = os.replace, tables.CsvFile._write

def event():
    left[0] -= 1
    return left[0] == 0

def die():
    os.kill(os.getpid(), signal.SIGKILL)

def dying_replace(source, target):
    event() and die()
    replace(source, target)
    event() and die()

def dying_write(table, data):
    if event():
        table._file.write(data[:len(data) // 2])
        die()
    write(table, data)

files.os.replace, tables.CsvFile._write = dying_replace, dying_write
sys.exit(command.main({words!r}))
"""


def run(count: int, seed: int, folder: Path) -> Tally:
    """Try so many chains."""
    tally, file = Tally(), folder / "small.toml"
    kinds = [(_run, 130), (_sweep, 16)]  # by the seed's parity: what is done, and the events in it
    file.write_text(SMALL.replace("duration = 0.02", "duration = 0.024") + "[output]\nevery = 5\n", encoding="utf-8")
    for words, _ in {number % 2: kinds[number % 2] for number in range(seed, seed + count)}.values():
        assert command.main([word for word in words(file, _whole(folder, words)) if word != "--resume"]) == 0
    for number in range(seed, seed + count):
        words, events = kinds[number % 2]
        attempt = partial(_attempt, Random(number), partial(words, file), events, _whole(folder, words), number)
        tally.trial(f"chain {number}", attempt, (), PATIENCE)
    return tally


def _whole(folder: Path, words: Callable[..., list[str]]) -> Path:
    """Name the folder of what is not killed."""
    return folder / f"whole{words.__name__}"


def _run(file: Path, out: Path) -> list[str]:
    return ["run", str(file), "--out", str(out), "--quiet", "--no-picture", "--resume"]


def _sweep(file: Path, out: Path) -> list[str]:
    return ["sweep", str(file), "--over", "solve.duration=[1e-3, 2e-3, 3e-3]", "--out", str(out), "--json"]


def _attempt(random: Random, words: Callable[[Path], list[str]], events: int, whole: Path, number: int) -> str:
    out = whole.with_name(f"chain{number}")
    for _ in range(random.randint(1, LONGEST)):
        script = DYING.format(root=str(ROOT), moment=random.randint(1, events), words=words(out))
        environment = dict(os.environ, OMP_NUM_THREADS="1")
        done = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, check=False)
        if done.returncode not in (0, -signal.SIGKILL):
            raise AssertionError(done.stderr.decode(errors="replace")[-500:])
    assert command.main(words(out)) == 0
    differing = [name for name in sorted(_names(whole) | _names(out)) if not _same(whole / name, out / name)]
    assert not differing, f"other bytes in {differing}"
    return "same bytes"


def _names(folder: Path) -> set[str]:
    """Name all files of a run but those with times of day in them, the log among them, and the binary memory of the
    clock."""
    timed = {"provenance.json", "checkpoint.npz", "suture.log", "sweep.json"}
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file() and path.name not in timed}


def _same(one: Path, other: Path) -> bool:
    if not one.is_file() or not other.is_file():
        return False
    if one.name == "summary.json" or one.parent.name == "cases":
        summaries = [json.loads(path.read_text(encoding="utf-8")) for path in (one, other)]
        return _untimed(summaries[0]) == _untimed(summaries[1])
    if one.name == "steps.csv":
        rows = [[line.rpartition(b",")[0] for line in path.read_bytes().splitlines()] for path in (one, other)]
        return rows[0] == rows[1]
    return one.read_bytes() == other.read_bytes()


def _untimed(summary: dict[str, Any]) -> dict[str, Any]:
    timed = ("provenance", "seconds_per_step", "seconds")
    return {key: _untimed(v) if isinstance(v, dict) else v for key, v in summary.items() if key not in timed}
