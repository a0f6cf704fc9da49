"""Chains of kills: a run, a sweep, a refinement or a report is killed again and again at seeded moments, and goes on to
the bytes of one that was not."""

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import redirect_stdout
from functools import partial
from io import StringIO
from pathlib import Path
from random import Random
from typing import Any

from studies.command import command
from tests.fuzz.scenarios import SMALL
from tests.fuzz.trial import Tally

ROOT = Path(__file__).parents[2]
LONGEST = 4  # kills in a chain
PATIENCE = 3600  # s for a chain: five starts of an interpreter, on a machine that does other things
# The process ends at the n-th event: a file before or after it is renamed, or torn, a table in the middle of a row. It
# tells how many there were where it does not.
DYING = """
import os, signal, sys
from pathlib import Path
sys.path[:0] = [{root!r}]
from studies.command import command
from studies.output import files, tables

count = 0
replace, write, write_bytes = os.replace, tables.CsvFile._write, Path.write_bytes

def event():
    global count
    count += 1
    return count == {moment}

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

def dying_write_bytes(path, data):
    if event():
        write_bytes(path, data[:len(data) // 2])
        die()
    return write_bytes(path, data)

files.os.replace, tables.CsvFile._write, Path.write_bytes = dying_replace, dying_write, dying_write_bytes
status = command.main({words!r})
sys.stderr.write(f"\\n{{count}}")
sys.exit(status)
"""


def run(count: int, seed: int, folder: Path) -> Tally:
    """Try so many chains."""
    tally, file, known = Tally(), folder / "small.toml", dict[int, int]()
    file.write_text(SMALL.replace("duration = 0.02", "duration = 0.024") + "[output]\nevery = 5\n", encoding="utf-8")
    for number in range(seed, seed + count):
        which = number % len(KINDS)  # what is done
        if which not in known:
            known[which] = _events(folder, which)
        words = partial(KINDS[which], folder)
        attempt = partial(_attempt, Random(number), words, known[which], _whole(folder, which), number)
        tally.trial(f"chain {number} ({KINDS[which].__name__[1:]})", attempt, (), PATIENCE)
    return tally


def _events(folder: Path, which: int) -> int:
    """Make what is not killed, and count the events in it."""
    words = KINDS[which](folder, _whole(folder, which))
    done = _started(0, [word for word in words if word != "--resume"])
    assert done.returncode == 0, done.stderr
    return int(done.stderr.splitlines()[-1])


def _started(moment: int, words: list[str]) -> "subprocess.CompletedProcess[bytes]":
    script = DYING.format(root=str(ROOT), moment=moment, words=words)
    environment = dict(os.environ, OMP_NUM_THREADS="1")
    return subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, check=False)


def _whole(folder: Path, which: int) -> Path:
    """Name the folder of what is not killed."""
    return folder / f"whole{KINDS[which].__name__}"


def _run(folder: Path, out: Path) -> list[str]:
    return ["run", str(folder / "small.toml"), "--out", str(out), "--quiet", "--no-picture", "--resume"]


def _sweep(folder: Path, out: Path) -> list[str]:
    over = "solve.duration=[1e-3, 2e-3, 3e-3]"
    return ["sweep", str(folder / "small.toml"), "--over", over, "--out", str(out), "--json"]


def _refine(folder: Path, out: Path) -> list[str]:
    asked = ["--quantity", "piercings.exit.slip", "--over", "control_points", "--levels", "3", "--json"]
    file = folder / "short.toml"
    file.write_text(SMALL.replace("duration = 0.02", "duration = 0.002"), encoding="utf-8")
    return ["refine", str(file), *asked, "--out", str(out)]


def _report(folder: Path, out: Path) -> list[str]:
    run = folder / "reported"
    if not run.exists():
        assert command.main([word for word in _run(folder, run) if word != "--resume"]) == 0
    return ["report", str(run), "--out", str(out / "page.html")]


KINDS = (_run, _sweep, _refine, _report)


def _attempt(random: Random, words: Callable[[Path], list[str]], events: int, whole: Path, number: int) -> str:
    out = whole.with_name(f"chain{number}")
    for _ in range(random.randint(1, LONGEST)):
        done = _started(random.randint(1, events), words(out))
        if done.returncode not in (0, -signal.SIGKILL):
            raise AssertionError(done.stderr.decode(errors="replace")[-500:])
    with redirect_stdout(StringIO()):
        assert command.main(words(out)) == 0
    differing = [name for name in sorted(_names(whole) | _names(out)) if not _same(whole / name, out / name)]
    assert not differing, f"other bytes in {differing}"
    shutil.rmtree(out)
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
    timed = ("provenance", "seconds_per_step", "seconds", "rounds")  # each round of refinement has its seconds
    return {key: _untimed(v) if isinstance(v, dict) else v for key, v in summary.items() if key not in timed}
