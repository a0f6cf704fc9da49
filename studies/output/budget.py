"""Estimates of the disk, memory and time of a run, before its first step."""

import shutil
import sys
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from time import process_time
from timeit import repeat

import numpy as np

from studies.arrays import GIGA
from studies.output.fields import OrganTopology
from studies.scenario import Scenario, ScenarioError, Tissue, refusal
from tissue.elasticity import formulation

# Bytes, measured on runs with 20 to 60 control points, 2 piercings and 4000 to 12 000 nodes, P1 and
# P2. A node takes 25 on structured meshes and up to 49 on others (displacement and stress,
# compressed, with the mesh). A control point takes 90, or 140 with twist and tracts. A row of
# energy.csv and of steps.csv takes 200, a row of piercings.csv 250 to 500.
PER_NODE, PER_CONTROL_POINT, PER_HOLE_DRAWN = 49.0, 140.0, 1400.0
PER_STEP, PER_HOLE = 400.0, 500.0
# Seconds of one processor, measured on the shipped scenes and 70 scenes of the campaign. STEP…: a
# step by compiled loops, then the addition for each hole, and for an organ solved whole, also for
# each of its unknowns. …KRYLOV…: a step in a Krylov space, and once per unknown (about 40 vectors
# are made). CORRECTION…: a correction in numpy, then per control point, per hole, and per unknown
# at finite strain; CORRECTIONS is their number per step. CORRECTION_NODAL: per squared unknown if the
# dilatation is averaged at vertices, times (1 − 2ν)^(−1/3): nodes two cells apart are then joined, and
# a factor takes n² operations. A block of 7000 unknowns, sheared by 0.1 to 0.3 E, took 0.3 to 1 s a
# step at ν = 0.3 and 0.45, 3 (P1) to 11 s (P2) at 0.49, and 5 to 30 s at 0.499, where more corrections
# are needed. Blocks of 1000 to 14 000 unknowns gave the square. FRAME_BYTE: an estimated byte of a frame.
# BEGINNING: loading the program and its loops, and the picture. For 78 of 82 runs, steps and frames
# took 0.5 to 2 times the estimate, and whole runs 0.6 to 1.4 times.
STEP, STEP_HOLE, STEP_FACTORED, STEP_UNKNOWN = 6e-4, 7.5e-4, 3.4e-3, 1.1e-6
STEP_KRYLOV, KRYLOV_UNKNOWN = 1e-3, 3.3e-4
CORRECTION, CORRECTION_POINT, CORRECTION_HOLE, CORRECTION_FINITE = 5e-3, 5e-5, 1e-3, 4e-6
CORRECTION_NODAL = {"P1": 1e-9, "P2": 3e-9}
CORRECTIONS, FRAME_BYTE, BEGINNING = {"dynamic": 3, "static": 20}, 4e-7, 6.0
REFERENCE = 3.1e-3  # [s] the time of `pace` on the machine of these measurements
KIBI = 1024.0
UNITS = ((GIGA, "GB"), (1e6, "MB"), (1e3, "kB"))


def frame_bytes(scenario: Scenario, topology: OrganTopology | None) -> float:
    """Estimate the size of all frames of a run [byte]."""
    nodes = 0 if topology is None else len(topology.points)
    one = (
        PER_NODE * nodes + PER_CONTROL_POINT * scenario.thread.control_points + PER_HOLE_DRAWN * len(scenario.piercing)
    )
    return one * (scenario.solve.steps // scenario.output.every + 2)


def row_bytes(scenario: Scenario) -> float:
    """Estimate the size of the tables of a run [byte]."""
    return (PER_STEP + PER_HOLE * len(scenario.piercing)) * (scenario.solve.steps + 1)


def peak_memory() -> float | None:
    """Return the peak memory of this process [byte], None if the system does not report it.

    Preparation takes most of a run's memory.
    """
    if sys.platform == "win32":
        return None
    import resource

    unit = 1.0 if sys.platform == "darwin" else KIBI
    return unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def seconds_of(
    scenario: Scenario, topology: OrganTopology | None, unknowns: int, balls: int, by: Mapping[str, str | None]
) -> float:
    """Estimate the processor time of steps and frames [s], without preparation.

    `unknowns` is the number of an organ's unknowns, `balls` the number of balls of tracts. `by` are
    the methods from `Simulation.methods`.
    """
    solve, points, organ = scenario.solve, scenario.thread.control_points, scenario.tissue
    holes = len(scenario.piercing) + balls
    inertia = unknowns * (organ is not None and organ.inertia and solve.kind == "dynamic")
    once, step = 0.0, STEP + STEP_HOLE * holes + STEP_UNKNOWN * inertia + STEP_FACTORED * (inertia > 0)
    if by.get("organ") in ("krylov", "basis"):
        once, step = KRYLOV_UNKNOWN * inertia * (by.get("organ") == "krylov"), STEP_KRYLOV
    if by.get("newton") == "numpy":
        one = CORRECTION + CORRECTION_POINT * points + CORRECTION_HOLE * holes + finite_correction(organ, unknowns)
        step += CORRECTIONS[solve.kind] * one
    frames = FRAME_BYTE * frame_bytes(scenario, topology)
    return pace() * (BEGINNING + once + step * solve.steps + frames)


def finite_correction(organ: Tissue | None, unknowns: int) -> float:
    """Return the time by which finite strain lengthens a correction [s], zero for a linear organ."""
    if organ is None or organ.material == "linear":
        return 0.0
    nu = max([organ.poisson_ratio, *(part.poisson_ratio or 0.0 for part in organ.region)])
    squared = CORRECTION_NODAL[organ.element] * (formulation(organ.dilatation, organ.element, nu, True) == "nodal")
    return float(CORRECTION_FINITE * unknowns + squared * unknowns**2 / np.cbrt(1.0 - 2.0 * nu))


def pace() -> float:
    """Return the time for a sum on this machine over its time on the reference machine [-].

    The other times of this module were measured on the reference machine.
    """
    return min(repeat(partial(sum, range(200_000)), timer=process_time, repeat=5, number=1)) / REFERENCE


def size_text(size: float) -> str:
    """Return a size [byte] in words with two digits or more.

    The unit is the largest that does not exceed the size.
    """
    unit, name = next(((unit, name) for unit, name in UNITS if size >= unit), UNITS[-1])
    return f"{size / unit:{'.0f' if size >= 9.95 * unit else '.2g'}} {name}"


def check_disk(folder: Path | str, scenario: Scenario, topology: OrganTopology | None) -> None:
    """Refuse a run that would fill the disk of a folder. Raises `ScenarioError`."""
    frames, rows, free = frame_bytes(scenario, topology), row_bytes(scenario), shutil.disk_usage(folder).free
    if frames + rows <= free:
        return
    takes = f"about {(frames + rows) / GIGA:.3g} GB in {folder}, but only {free / GIGA:.3g} GB are free"
    if frames > rows:
        raise ScenarioError(
            refusal("output.every", scenario.output.every, f"the frames take {takes}; raise it, or free disk space")
        )
    key = "load_steps" if scenario.solve.kind == "static" else "dt"
    reason = f"{scenario.solve.steps} steps take {takes}; take fewer steps, or free disk space"
    raise ScenarioError(refusal(f"solve.{key}", getattr(scenario.solve, key), reason))
