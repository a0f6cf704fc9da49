"""Difference of a run from the same run in steps a quarter as long, at their ends."""

from copy import deepcopy
from typing import Any

import numpy as np

from studies.simulation.memory import OrganRun

PARTS = 4  # of a step


def with_shorter_steps(tables: dict[str, Any]) -> dict[str, Any]:
    """Return the tables of a scenario with steps a quarter as long."""
    out = deepcopy(tables)
    out["solve"]["dt"] /= PARTS
    return out


def forces_apart(one: OrganRun, other: OrganRun) -> float:
    """Return how far the forces of the same hole are apart at most, over the largest force of a hole [-]."""
    forces, others = (np.array([hole.force for hole in run.piercings]) for run in (one, other))
    largest = np.linalg.norm(others, axis=1).max()
    return float(np.linalg.norm(forces - others, axis=1).max() / max(largest, np.finfo(float).tiny))


def lengths_apart(one: OrganRun, other: OrganRun) -> float:
    """Return how far the lengths drawn through the same hole are apart at most, over the largest or the thread's
    diameter, the larger of both [-]."""
    lengths, others = (np.array([hole.slip for hole in run.piercings]) for run in (one, other))
    largest = max(np.abs(others).max(), one.system.thread.section.diameter)
    return float(np.abs(lengths - others).max() / largest)
