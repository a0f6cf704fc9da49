"""`suture bench many`: a small basis, many tensions on one organ, and the main job.

The main job is measured from the command to its picture. The small basis is compared with the whole
organ on the main job's block, and its estimated error with the real error. The comparison is
repeated for a soft block without damping, pulled within 2 ms, the most difficult case. The sweep
over tensions is compared with single runs. All times are processor times on one thread, in turn, so
other work on the machine has no effect.
"""

import os
import resource
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from time import process_time

import numpy as np

import tissue
from coupling.integrators import BDF2, BackwardEuler
from coupling.run import begin
from coupling.step.stepping import bdf2_step
from meshes.block import block
from studies.arrays import MEGA, MILLI, Array
from studies.bench.rows import EVERY_CASE, Numbers, keep, printed, steps_in_turn, time_call
from studies.bench.step import COMPILED, COUPLED, FIXED, SIZES, sized
from studies.scenario import load
from studies.simulation.assembly import assemble
from studies.simulation.sharing import Shared

Organ = tissue.DynamicOrgan | tissue.ReducedOrgan

MESHES = {"10k": SIZES["10k"], "100k": (1.5e-3, 0.5e-3)}  # cell size far from and at the holes [m]
NUMPY = '--set=solve.newton="numpy"'
SMALL = "tissue.reduction={ blocks = 2 }"
WHOLE = 'solve.organ="whole"'
STEPS = 60  # only the second half is timed
REPEATED = 10  # number of answers of an organ, and of calls for many steps
SOFT = tissue.Material(4.0e4, 0.45, 1070.0)
SIDES = (0.03, 0.02, 0.015)  # edges of the soft block [m]
SHORT, PULLED = 2.0e-4, 2.0e-3  # s: time step, and duration of the pull
SOFT_STEPS = 200
TENSIONS = 64
LEAST, MOST = 0.1, 0.2  # N
ALONG = np.array([0.832, 0.0, 0.555])  # direction of the pull at the end; the start is pulled in opposite x
AT_REST = ("--set=solve.kind=static", "--set=solve.load_steps=1")
CASES = EVERY_CASE["tensions"]


def main(
    json_path: Path | None = None, tensions: int = TENSIONS, meshes: Mapping[str, tuple[float, float]] = MESHES
) -> int:
    """Measure, print, and add to the JSON file if given; return the exit status."""
    rows = printed("reduced", measurements(meshes))
    job, size = measure_main_job(), measure_folder()
    print("\nby the command: " + ", ".join(f"{seconds:.2f} s {name}" for name, seconds in job.items()))
    print(f"its folder: {size:.1f} MB\n")
    many = printed("tensions", (measure_tensions(case, tensions) for case in CASES))
    found = {"reduced": rows, "tensions": many, "main_job_seconds": job, "main_job_megabytes": size}
    return keep(json_path, found)


def measurements(meshes: Mapping[str, tuple[float, float]]) -> Iterator[Numbers]:
    """Yield the measurements of the main job on each mesh, then of the soft block."""
    for size, mesh in meshes.items():
        yield measure_job(f"main job {size}", sized(mesh))
    yield measure_soft_block()


# -- a small basis ---------------------------------------------------------------------------------------------------


def measure_job(case: str, mesh: Sequence[str]) -> Numbers:
    """Return the numbers of steps of the main job with both organs, in turn, by compiled loops.

    A step, a step of many made `at_once`, and the organ's part of a step are medians [ms].
    `times_as_fast` compares the step with the step of the whole organ. `steps_per_second` is of one
    core, with many steps at once.
    """
    store = Shared()
    keys = [*FIXED, *mesh, COMPILED]
    whole, began = assemble(load(COUPLED, [*keys, WHOLE]), store), process_time()
    small = assemble(load(COUPLED, [*keys, SMALL]), store)
    seconds, full, organ = process_time() - began, whole.organ, small.organ
    assert isinstance(full, tissue.DynamicOrgan) and isinstance(organ, tissue.ReducedOrgan)
    runs = [begin(assembly.system, assembly.start(), bdf2_step) for assembly in (whole, small)]
    dt = whole.scenario.solve.dt
    taken = list(steps_in_turn(runs, lambda run: run.step(dt), STEPS))
    runs, pairs = taken[-1][0], [(one.state.organ, other.state.organ) for (one, other), _ in taken]
    step, whole_step = (median(times[k] for _, times in taken[STEPS // 2 :]) / MILLI for k in (1, 0))
    at_once = median(time_call(lambda: runs[1].steps(dt, STEPS)) for _ in range(REPEATED)) / STEPS / MILLI
    parts = time_organ(organ, runs[1].state.organ, dt), time_organ(full, runs[0].state.organ, dt)
    sizes = {"case": case, "tissue_unknowns": full.size, "vectors": organ.reduction.size}
    found = {"basis_seconds": seconds, "step": step, "whole_step": whole_step, "at_once": at_once}
    found |= dict(zip(("organ", "whole_organ"), parts, strict=True)) | errors(full, organ, pairs)
    found |= {"times_as_fast": whole_step / step, "steps_per_second": 1.0 / (at_once * MILLI)}
    return sizes | found


def measure_soft_block() -> Numbers:
    """Return the numbers of a soft block without damping, with both organs.

    Its two sites are pulled in less than its longest period. Numbers of a thread's step are None,
    and `times_as_fast` compares the organs' parts.
    """
    body = tissue.elasticity(block(SIDES, 2.5e-3), SOFT, "P1", ("bottom",))
    holes = [tissue.Site((x, 0.0, 0.0), 2.0e-3, direction="normal") for x in (-0.005, 0.005)]
    full, began = tissue.DynamicOrgan(body, tissue.build_sites(body, holes)), process_time()
    organ = tissue.ReducedOrgan(full, tissue.reduce_organ(full, 2))
    seconds, pairs = process_time() - began, list(zip(pulled(full), pulled(organ), strict=True))
    parts = time_organ(organ, pairs[-1][1], SHORT), time_organ(full, pairs[-1][0], SHORT)
    found = {"case": "40 kPa in 2 ms", "tissue_unknowns": full.size, "vectors": organ.reduction.size}
    found |= {"basis_seconds": seconds, "step": None, "whole_step": None, "at_once": None}
    found |= dict(zip(("organ", "whole_organ"), parts, strict=True)) | errors(full, organ, pairs)
    return found | {"times_as_fast": parts[1] / parts[0], "steps_per_second": None}


def pulled(organ: Organ) -> list[tissue.OrganState]:
    """Return the states of the soft block under the pull."""
    states, force = [organ.start()], np.zeros(18)
    force[[0, 2, 11]] = 0.02, 0.05, 0.03  # N
    for n in range(SOFT_STEPS):
        scheme = BDF2(SHORT, SHORT) if n else BackwardEuler(SHORT)
        answer = organ.answer(scheme, states[::-1][: len(scheme.coefficients)])
        states.append(answer.accept(force * min((n + 1) * SHORT / PULLED, 1.0)))
    return states[1:]


def time_organ(organ: Organ, state: tissue.OrganState, dt: float) -> float:
    """Return the processor time of an organ's part of a step [ms]."""
    step = BDF2(dt, dt)
    return (
        median(time_call(lambda: organ.answer(step, [state, state]).accept(state.f_y)) for _ in range(REPEATED)) / MILLI
    )


def errors(
    full: tissue.DynamicOrgan, organ: tissue.ReducedOrgan, pairs: Sequence[tuple[tissue.OrganState, tissue.OrganState]]
) -> dict[str, float]:
    """Return the largest error, difference and bound of a hole, and the least bound over error.

    The first three are relative to the largest displacement of a hole.
    """

    def lengths(y: Array) -> Array:
        return np.asarray(np.linalg.norm(y.reshape(-1, 9)[:, :3], axis=1))

    way = max(lengths(full.site_variables(U) - full.y0).max() for U, _ in pairs)
    error = np.array([lengths(full.site_variables(U) - organ.site_variables(eta)) for U, eta in pairs])
    difference, bound = (np.array([estimate(eta) for _, eta in pairs]) for estimate in (organ.difference, organ.bound))
    least = float((bound / np.maximum(error, np.finfo(float).eps * way)).min())
    of_way = {"error": error, "difference": difference, "bound": bound}
    largest = {name: float(values.max() / way) for name, values in of_way.items()}
    return largest | {"bound_over_error": least}


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
    others = {"in numpy": time_command("run", NUMPY), "in a small basis": time_command("run", f"--set={SMALL}")}
    others |= {"with the organ solved whole": time_command("run", f"--set={WHOLE}")}
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
