"""Estimates of the disk and memory of a run, before its first step."""

import shutil
import sys
from pathlib import Path

from studies.arrays import GIGA
from studies.output.fields import OrganTopology
from studies.scenario import Scenario, refuse, refused

# Bytes, measured on runs with 20 to 60 control points, 2 piercings and 4000 to 12 000 nodes, P1 and
# P2. A node takes 25 on structured meshes and up to 49 on others (displacement and stress,
# compressed, with the mesh). A control point takes 90, or 140 with twist and tracts. A row of
# energy.csv and of steps.csv takes 200, a row of piercings.csv 250 to 500.
PER_NODE, PER_CONTROL_POINT, PER_HOLE_DRAWN = 49.0, 140.0, 1400.0
PER_STEP, PER_HOLE = 400.0, 500.0
KIBI = 1024.0
UNITS = ((GIGA, "GB"), (1e6, "MB"), (1e3, "kB"))


def frame_bytes(scenario: Scenario, topology: OrganTopology | None) -> float:
    """Estimate the size of all frames of a run [byte]."""
    nodes = 0 if topology is None else len(topology.points)
    holes = PER_HOLE_DRAWN * len(scenario.piercing)
    one = PER_NODE * nodes + PER_CONTROL_POINT * scenario.thread.control_points + holes
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
    refuse(frames > rows, "output.every", scenario.output.every, "disk-frames", takes=takes)
    key = "load_steps" if scenario.solve.kind == "static" else "dt"
    raise refused(f"solve.{key}", getattr(scenario.solve, key), "disk-steps", steps=scenario.solve.steps, takes=takes)
