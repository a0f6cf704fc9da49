"""A case of a sweep: its scenario, its digest, and its run."""

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from threading import Lock
from time import perf_counter
from typing import Any

from coupling.errors import CouplingError
from studies.output.provenance import ROOT, installed_version
from studies.output.records import Record, Snapshot, StepRecord
from studies.scenario import Scenario, changed, parsed, tables, with_mesh_copy
from studies.simulation.sharing import Shared, start_key
from studies.simulation.simulation import REFUSALS, Simulation, prepare
from studies.status import COMPLETED, FAILED, REFUSED
from tissue.errors import FactorError

SHORTAGES = (FactorError, OSError, MemoryError)  # of memory or disk, perhaps temporary
ROOMS = ("thread", "tissue", "coupling", "meshes", "studies/scenario", "studies/simulation", "studies/output")
# used by the code in those folders
MODULES = ("studies/arrays.py", "studies/extras.py", "studies/lists.py", "studies/verdicts.py")
# of the names, words and bounds of a summary
LISTS = ("studies/output/columns.toml", "studies/output/remarks.toml", "studies/simulation/plausible.toml")
PACKAGES = (  # packages that influence numbers
    "numpy", "scipy", "numba", "scikit-fem", "gmsh", "meshio", "pyamg", "cvxopt", "pypardiso", "mkl", "tensortrax",
)  # fmt: skip

KEPT = Shared()  # cache of this process for all its cases
ONE_AT_A_TIME = Lock()  # threads of one process must not change the cache at once


@dataclass(frozen=True)
class Result:
    """A case that was run.

    It has its exit status, like that of ``suture run``, its summary, the wall-clock `seconds`, and
    the number of `cells` of its organ, None without an organ. `lasting`: whether a repeated run
    would give the same result; false if memory or disk ran out. `failure`: the name of the error
    that ended the run, "refused" for a refused case, empty for a completed run.
    """

    exit_status: int
    summary: dict[str, Any]
    seconds: float
    lasting: bool = True
    cells: int | None = None
    failure: str = ""

    def record(self) -> dict[str, Any]:
        """Return the content of the case's file."""
        return {"exit_status": self.exit_status, "seconds": self.seconds, "cells": self.cells, "summary": self.summary}


def run_case(data: Mapping[str, Any]) -> Result:
    """Run a scenario given as tables; a failure is also a result."""
    began = perf_counter()
    with ONE_AT_A_TIME:
        try:
            scenario = parsed(data)
            simulation = prepare(scenario, KEPT)
        except REFUSALS as error:
            summary, name = {"status": "refused", "error": str(error)}, "refused"
            return Result(REFUSED, summary, perf_counter() - began, failure=name)
        except SHORTAGES as error:
            summary, name = {"status": "failed", "error": in_words(error)}, type(error).__name__
            return Result(FAILED, summary, perf_counter() - began, False, failure=name)
        summary, failure = simulate(simulation)
    cells = None if simulation.topology is None else len(simulation.topology.cells)
    seconds, lasting = perf_counter() - began, not isinstance(failure, SHORTAGES)
    if failure is None:
        return Result(COMPLETED, summary, seconds, cells=cells)
    return Result(FAILED, summary, seconds, lasting, cells, type(failure).__name__)


def run_start(data: Mapping[str, Any]) -> Result | None:
    """Return the result of a scenario at its start, None without a start.

    Its summary has all names of the final summary. The organ is cached for the first case.
    """
    began = perf_counter()
    with ONE_AT_A_TIME:
        try:
            simulation = prepare(parsed(data), KEPT)
            step, frame = next(simulation.advance())
        except (*REFUSALS, *SHORTAGES, CouplingError):
            return None
        tally = simulation.tally()
        tally.count(step)
        tally.see(drawn(simulation, step, frame))
    return Result(COMPLETED, tally.summary("completed"), perf_counter() - began)


def make_ready(data: Mapping[str, Any]) -> None:
    """Cache the organ of a scenario given as tables, and load its compiled loops.

    The loops of its time steps are loaded by two steps.
    """
    solve = parsed(data).solve
    if solve.kind == "static":
        run_start(data)
    else:
        run_case(changed(data, {"solve.duration": min(solve.duration, 2 * solve.dt)}))


def simulate(simulation: Simulation) -> tuple[dict[str, Any], Exception | None]:
    """Run a simulation without files; return the summary of `suture run`, and the error.

    The error is None for a completed run.
    """
    tally = simulation.tally()
    error: Exception | None = None
    last = None
    try:
        for step, frame in simulation.advance():
            tally.count(step)
            last = frame
            if step.step % simulation.scenario.output.every == 0:
                tally.see(drawn(simulation, step, frame))
                last = None
    except (*REFUSALS, *SHORTAGES, CouplingError) as raised:
        error = raised
    if last is not None:  # the last frame, as in a run with files
        tally.see(last().organ)
    return (tally.summary("completed") if error is None else tally.summary("failed", in_words(error))), error


def drawn(simulation: Simulation, step: StepRecord, frame: Callable[[], Snapshot]) -> Record | None:
    """Return the organ of a frame.

    The frame at the start is cached for cases with the same start.
    """
    if step.step:
        return frame().organ
    return KEPT.take("drawn", start_key(simulation.scenario), lambda: frame().organ)


def in_words(error: BaseException) -> str:
    """Return the message of an error, or the name of its type."""
    return str(error) or type(error).__name__


def case_digest(scenario: Scenario) -> str:
    """Return the SHA-256 of a scenario, of its mesh file, and of the code that runs it.

    The versions of the packages are included.
    """
    copied, mesh = with_mesh_copy(scenario)
    return hashlib.sha256(json.dumps([tables(copied), mesh, *code_version()], sort_keys=True).encode()).hexdigest()


@cache
def code_version() -> tuple[str, dict[str, str]]:
    """Return the digest of the source code of a run, and the versions of its packages."""
    text = hashlib.sha256()
    for path in [*source_files(), *(ROOT / name for name in LISTS)]:
        text.update(path.relative_to(ROOT).as_posix().encode() + b"\0" + path.read_bytes())
    return text.hexdigest(), {name: version for name in PACKAGES if (version := installed_version(name)) is not None}


def source_files() -> list[Path]:
    """Return the source files that influence a run."""
    in_rooms = (path for room in ROOMS for path in sorted((ROOT / room).rglob("*.py")))
    return [*in_rooms, *(ROOT / name for name in MODULES)]
