"""`suture bench organ`: times of each installed solver, from thousands to a million unknowns.

The organ is a uniform, quasi-static block, held at its bottom, with two holes in its top. For each
solver the table has the time until the first solve, its memory, the time of one solve, and the time
of the columns of both holes. Before the first solve come ordering and factor, or the levels of
multigrid. `floor` is the smallest possible time of a solve. The factor is read twice, forwards and
backwards, at the memory speed of one core in the same run. `rough` are the columns of a
quasi-static organ by multigrid, and `left` is the remaining error of its compliance. All times are
processor times on one thread, so other work on the machine has no effect.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import median
from time import process_time

import numpy as np
import psutil
from threadpoolctl import threadpool_limits

import tissue
from meshes.block import block
from studies.arrays import Array
from studies.bench.rows import Numbers, keep, printed, time_call
from tissue.organs.meshed import compliance
from tissue.solvers.choice import MULTIGRID, Solver, choose_solver, has_pyamg, solver
from tissue.solvers.direct import LIBRARIES, is_installed
from tissue.solvers.iterative import ConjugateGradients

SIDES = (0.06, 0.04, 0.02)  # edges of the block [m]
HOLES = ((-0.005, 0.0, 0.0), (0.005, 0.0, 0.0))
FOOTPRINT = 1.5e-3

SOLVES = 5
LARGEST = {"superlu": 150_000, "cholmod": 500_000, "pardiso": 500_000}  # unknowns; a larger factor takes many minutes
WORDS = 30_000_000  # read to measure the speed of memory


def main(sizes: Sequence[int], element: str = "P1", json_path: Path | None = None) -> int:
    """Measure every solver and print the table; return the exit status.

    The numbers are written as JSON if a file is given.
    """
    methods = [method for method in LIBRARIES if is_installed(method)]  # loaded before their threads are limited
    methods += [MULTIGRID] if has_pyamg() else []
    with threadpool_limits(limits=1, user_api="blas"):
        speed = bandwidth()
    measured = (row for size in sizes for row in measure_solvers(organ_of(size, element), element, methods, speed))
    rows = printed("organ", measured)
    print(f"\nmemory is read at {speed / 1e9:.1f} GB/s")
    return keep(json_path, {"rows": rows, "bandwidth": speed})


def bandwidth() -> float:
    """Return the bytes per second that one core reads.

    It is the best of several sums over more data than any cache holds.
    """
    words = np.ones(WORDS)
    return words.nbytes / min(time_call(words.sum) for _ in range(SOLVES))


def measure_solvers(
    organ: tissue.QuasiStaticOrgan, element: str, methods: Sequence[str], speed: float
) -> Iterator[Numbers]:
    """Measure every solver on an organ.

    Solvers without enough memory or above their size limit are left out.
    """
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


def row_of(organ: tissue.QuasiStaticOrgan, element: str, method: str, speed: float) -> Numbers:
    """Return the measurement of one solver: times [s], and memory [bytes].

    `rough_columns` are the columns of a quasi-static organ by an iterative solver, and `left` is
    the error of their compliance; both are None for a direct solver.
    """
    memory = psutil.Process().memory_info
    before, began = memory().rss, process_time()
    chosen = solver(organ.K, organ.places, method)
    setup, kept = process_time() - began, memory().rss - before
    b = np.random.default_rng(0).standard_normal(organ.size)
    iterations = chosen.iterate(b)[1] if isinstance(chosen, ConjugateGradients) else None
    solve = median(time_call(lambda: chosen.solve(b)) for _ in range(SOLVES if iterations is None else 1))
    floor = 2.0 * kept / speed if iterations is None else None
    columns, C = time_compliance(organ, chosen, rough=False)
    rough, other = (None, C) if iterations is None else time_compliance(organ, chosen, rough=True)
    left = None if iterations is None else float(np.abs(other - C).max() / np.abs(C).max())
    found = {"unknowns": organ.size, "element": element, "solver": method, "setup": setup}
    found |= {"memory": kept, "solve": solve, "floor": floor, "iterations": iterations}
    return found | {"columns": columns, "rough_columns": rough, "left": left}


def time_compliance(organ: tissue.QuasiStaticOrgan, chosen: Solver, rough: bool) -> tuple[float, Array]:
    """Return the processor time of the columns of an organ's sites [s], and their compliance."""
    began = process_time()
    _, C = compliance(chosen, organ.Y, rough)
    return process_time() - began, C
