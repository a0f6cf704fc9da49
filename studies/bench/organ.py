"""`suture bench organ`: times of each installed solver for an organ, from thousands to a million unknowns.

The organ is a uniform, quasi-static block, held at its bottom, with two holes in its top. For each solver the
table has the time until the first solve (ordering and factor, or the levels of multigrid), its memory, the time
of one solve, and of the columns of both holes. `floor` is the smallest possible time of a solve: the factor is
read twice (forwards and backwards) at the memory speed of one core, measured in the same run. `rough` are the
columns of a quasi-static organ by multigrid, and `left` is the remaining error of its compliance. Below the
table are the times to assemble each organ's matrices by the compiled loops and by scikit-fem's forms. All times
are processor times on one thread, so other work on the machine has no effect.
"""

import mmap
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from time import process_time

import numpy as np
from threadpoolctl import threadpool_limits

import tissue
from meshes.block import block
from studies.arrays import Array
from studies.bench.rows import keep, time_call
from tissue.elasticity import assembled_by_loops, assembled_by_scikit_fem
from tissue.organs.meshed import compliance
from tissue.solvers.choice import MULTIGRID, Solver, choose_solver, has_pyamg, solver
from tissue.solvers.direct import LIBRARIES, is_installed
from tissue.solvers.iterative import ConjugateGradients

SIDES = (0.06, 0.04, 0.02)  # edges of the block [m]
HOLES = ((-0.005, 0.0, 0.0), (0.005, 0.0, 0.0))
FOOTPRINT = 1.5e-3

SOLVES = 5
ASSEMBLED = 300_000  # unknowns of the organ for the assembly in `suture bench`
REPEATED = 3  # number of assemblies by compiled loops
LARGEST = {"superlu": 150_000, "cholmod": 500_000, "pardiso": 500_000}  # unknowns; a larger factor takes many minutes
WORDS = 30_000_000  # read to measure the speed of memory
MEGA, MILLI = 1e6, 1e-3


@dataclass(frozen=True)
class Row:
    """One solver on one organ: times [s] and memory [bytes]; None for an entry that does not apply.

    For an iterative solver, `rough_columns` are the columns of a quasi-static organ, and `left` is the error of
    their compliance.
    """

    unknowns: int
    element: str
    solver: str
    setup: float
    memory: float
    solve: float
    floor: float | None
    iterations: int | None
    columns: float
    rough_columns: float | None = None
    left: float | None = None


@dataclass(frozen=True)
class Assembly:
    """Assembly times of one organ's matrices by compiled loops and by scikit-fem's forms [s]."""

    unknowns: int
    element: str
    loops: float
    forms: float

    @property
    def ratio(self) -> float:
        """Time of the forms over the time of the loops."""
        return self.forms / self.loops


def main(sizes: Sequence[int], element: str = "P1", json_path: Path | None = None) -> int:
    """Measure every solver, print the table in Markdown, and write JSON if a file is given; return the exit status."""
    rows, assemblies = [], []
    methods = [method for method in LIBRARIES if is_installed(method)]  # loaded before their threads are limited
    methods += [MULTIGRID] if has_pyamg() else []
    print(HEAD)
    with threadpool_limits(limits=1, user_api="blas"):
        speed = bandwidth()
        for size in sizes:
            organ = organ_of(size, element)
            for row in measure_solvers(organ, element, methods, speed):
                rows.append(row)
                print(line(row), flush=True)
            assemblies.append(measure_assembly(organ.elasticity))
    print_assemblies(assemblies)
    print(f"\nmemory is read at {speed / 1e9:.1f} GB/s")
    made = [asdict(each) | {"ratio": each.ratio} for each in assemblies]
    return keep(json_path, {"rows": [asdict(row) for row in rows], "assembly": made, "bandwidth": speed})


def main_assembly(json_path: Path | None = None, size: int = ASSEMBLED) -> int:
    """Measure the assembly of a large organ, print it, and add it to the JSON file if given; return the exit status."""
    with threadpool_limits(limits=1, user_api="blas"):
        made = measure_assembly(organ_of(size, "P1").elasticity)
    print_assemblies([made])
    return keep(json_path, {"assembly": [asdict(made) | {"ratio": made.ratio}]})


def print_assemblies(assemblies: Sequence[Assembly]) -> None:
    """Print a line for each organ."""
    print("\nassembly of K and M:")
    for each in assemblies:
        times = f"loops {each.loops:.3f} s, forms {each.forms:.2f} s"
        print(f"{each.unknowns} unknowns: {times}, {each.ratio:.0f} times as fast")


def bandwidth() -> float:
    """Return the bytes per second that one core reads: the best of several sums over more data than any cache holds."""
    words = np.ones(WORDS)
    return words.nbytes / min(time_call(words.sum) for _ in range(SOLVES))


def measure_assembly(body: tissue.Elasticity) -> Assembly:
    """Measure both ways to assemble a body's matrices; the first call of the loops, with compilation, does not
    count."""
    material = body.material
    given = body.basis, material.lame_lambda, material.lame_mu, material.density, None
    loops = [time_call(lambda: assembled_by_loops(*given)) for _ in range(REPEATED)]
    return Assembly(body.N, body.element, min(loops), time_call(lambda: assembled_by_scikit_fem(*given)))


def measure_solvers(
    organ: tissue.QuasiStaticOrgan, element: str, methods: Sequence[str], speed: float
) -> Iterator[Row]:
    """Measure every solver on an organ, except those without enough memory or above their size limit."""
    for method in methods:
        if organ.size <= LARGEST.get(method, organ.size) and has_room(organ, method):
            yield row_of(organ, element, method, speed)


def organ_of(size: int, element: str) -> tissue.QuasiStaticOrgan:
    """Return a block of about `size` unknowns with two holes."""
    order = 1 if element == "P1" else 2
    h = order * float((3.0 * np.prod(SIDES) / size) ** (1.0 / 3.0))
    body = tissue.elasticity(block(SIDES, h), tissue.Material(1.0e5, 0.45, 1070.0), element, ("bottom",))
    sites = tissue.build_sites(body, [tissue.Site(hole, FOOTPRINT, direction="normal") for hole in HOLES])
    return tissue.QuasiStaticOrgan(body, sites, solver=MULTIGRID)


def has_room(organ: tissue.QuasiStaticOrgan, method: str) -> bool:
    """Return whether the memory suffices for a solver."""
    try:
        choose_solver(method, organ.K, organ.places, once=True)
    except tissue.TissueError:
        return False
    return True


def row_of(organ: tissue.QuasiStaticOrgan, element: str, method: str, speed: float) -> Row:
    """Return the measurement of one solver, which is freed afterwards."""
    before, began = resident_memory(), process_time()
    made = solver(organ.K, organ.places, method)
    setup, kept = process_time() - began, resident_memory() - before
    b = np.random.default_rng(0).standard_normal(organ.size)
    iterations = made.iterate(b)[1] if isinstance(made, ConjugateGradients) else None
    solve = median(time_call(lambda: made.solve(b)) for _ in range(SOLVES if iterations is None else 1))
    floor = 2.0 * kept / speed if iterations is None else None
    taken, C = time_compliance(organ, made, rough=False)
    rough, other = (None, C) if iterations is None else time_compliance(organ, made, rough=True)
    left = None if iterations is None else float(np.abs(other - C).max() / np.abs(C).max())
    return Row(organ.size, element, method, setup, kept, solve, floor, iterations, taken, rough, left)


def time_compliance(organ: tissue.QuasiStaticOrgan, made: Solver, rough: bool) -> tuple[float, Array]:
    """Return the processor time of the columns of an organ's sites [s], and their compliance."""
    began = process_time()
    _, C = compliance(made, organ.Y, rough)
    return process_time() - began, C


def resident_memory() -> float:
    """Return the memory of this process [bytes]; not a number if the system does not report it."""
    try:
        return float(Path("/proc/self/statm").read_text().split()[1]) * mmap.PAGESIZE
    except OSError:
        return float("nan")


HEAD = (
    "| unknowns | element | solver | set-up [s] | memory [MB] | solve [ms] | floor [ms] | iterations | columns [s] | "
    "rough [s] | left |\n"
    "|---|---|---|---|---|---|---|---|---|---|---|"
)


def line(row: Row) -> str:
    """Return a row of the table."""
    floor = "" if row.floor is None else f"{row.floor / MILLI:.1f}"
    rough = " | " if row.rough_columns is None else f"{row.rough_columns:.2f} | {row.left:.0e}"
    return (
        f"| {row.unknowns} | {row.element} | {row.solver} | {row.setup:.2f} | {row.memory / MEGA:.0f} | "
        f"{row.solve / MILLI:.1f} | {floor} | {row.iterations or ''} | {row.columns:.2f} | {rough} |"
    )
