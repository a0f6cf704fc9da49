"""`suture bench many`: many tensions on one organ, and the main job.

The main job is measured from the command to its picture. The sweep over tensions is compared with
single runs. All times are processor times on one thread, in turn, so other work on the machine has
no effect.
"""

import os
import resource
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from studies.arrays import MEGA
from studies.bench.rows import EVERY_CASE, Numbers, keep, printed
from studies.bench.step import COUPLED

NUMPY = '--set=solve.newton="numpy"'
WHOLE = '--set=solve.organ="whole"'
TENSIONS = 64
LEAST, MOST = 0.1, 0.2  # N
ALONG = np.array([0.832, 0.0, 0.555])  # direction of the pull at the end; the start is pulled in opposite x
AT_REST = ("--set=solve.kind=static", "--set=solve.load_steps=1")
CASES = EVERY_CASE["tensions"]


def main(json_path: Path | None = None, tensions: int = TENSIONS) -> int:
    """Measure, print, and add to the JSON file if given; return the exit status."""
    job, size = measure_main_job(), measure_folder()
    print("\nby the command: " + ", ".join(f"{seconds:.2f} s {name}" for name, seconds in job.items()))
    print(f"its folder: {size:.1f} MB\n")
    many = printed("tensions", (measure_tensions(case, tensions) for case in CASES))
    found = {"tensions": many, "main_job_seconds": job, "main_job_megabytes": size}
    return keep(json_path, found)


# -- the command ---------------------------------------------------------------------------------------------------


def measure_main_job() -> dict[str, float]:
    """Return the processor times of variants of the main job [s].

    The times of compilation and of `--help` are also given.
    """
    short = ["--no-picture", "--set=solve.duration=2e-3"]
    time_command("run", *short)
    with TemporaryDirectory() as kept:
        first = time_command("run", *short, kept=kept)
        compiling = first - time_command("run", *short, kept=kept)
    whole = {"to its picture": time_command("run"), "without one": time_command("run", "--no-picture")}
    others = {"in numpy": time_command("run", NUMPY), "with the organ solved whole": time_command("run", WHOLE)}
    return whole | others | {"to compile the loops": compiling, "for --help": time_words("--help")}


def measure_folder() -> float:
    """Return the size of the main job's folder, with its picture [MB]."""
    with TemporaryDirectory() as folder:
        time_words("run", str(COUPLED), "--out", str(Path(folder) / "run"))
        return sum(path.stat().st_size for path in Path(folder).rglob("*") if path.is_file()) / MEGA


# -- many tensions ---------------------------------------------------------------------------------------------------


def measure_tensions(case: str, tensions: int) -> Numbers:
    """Return the processor times of many tensions on one organ [s].

    `sweep` is one command for all tensions, `run` a run of the last one with its picture, and
    `plain` the same run without a picture. Two ratios compare as many runs with the sweep.
    """
    forces = [(tension * ALONG).tolist() for tension in np.linspace(LEAST, MOST, tensions).tolist()]
    words = [*AT_REST, *CASES[case]]
    over = [f"--over={key}={[signed(force, key) for force in forces]}" for key in pulled_ends(case)]
    one = [f"--set={key}={signed(forces[-1], key)}" for key in pulled_ends(case)]
    sweep = time_command("sweep", *words, *over, *(["--paired"] if over[1:] else []))
    run, plain = (time_command("run", *words, *one, *more) for more in ((), ("--no-picture",)))
    found = {"case": case, "tensions": tensions, "sweep": sweep, "run": run, "plain": plain}
    ratios = {"times_as_cheap": run, "without_pictures": plain}
    return found | {name: tensions * single / sweep for name, single in ratios.items()}


def pulled_ends(case: str) -> list[str]:
    """Return the keys of the forces that a case varies."""
    return [f"thread.{end}.force" for end in ("start", "end") if end == "start" or CASES[case]]


def signed(force: list[float], key: str) -> list[float]:
    """Return the force on an end of the thread; the start is pulled in opposite x."""
    return [-force[0], *force[1:]] if key.startswith("thread.start") else force


def time_command(verb: str, *words: str, kept: str = "") -> float:
    """Return the processor time of a command on the main job, from start to end [s].

    `kept` is a folder for compiled loops; empty means the usual folder.
    """
    with TemporaryDirectory() as folder:
        return time_words(verb, str(COUPLED), "--out", str(Path(folder) / verb), *words, kept=kept)


def time_words(*words: str, kept: str = "") -> float:
    """Return the processor time of a command, from start to end [s].

    `kept` is explained in `time_command`.
    """
    began = children_time()
    command = [sys.executable, "-m", "studies.command.start", *words]
    where = os.environ | ({"NUMBA_CACHE_DIR": kept} if kept else {})
    subprocess.run(command, check=True, env=where, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    return children_time() - began


def children_time() -> float:
    """Return the processor time of the ended child processes [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
